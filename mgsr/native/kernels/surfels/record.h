// A projected splat of the 2D branch, and the gradient of a (splat, tile) pair.
#pragma once

#include "math/surfel.h"

namespace mgsr {

constexpr float kLn2 = 0.69314718056f;
// The scale of the exponent, log2(e) / 2, and its square root. L is multiplied by the root, so the exponent is a
// square.
constexpr float kExponentScale = 0.72134752044f, kRootExponentScale = 0.84932180028f;
constexpr float kNever = 1e6f;  // L of an edge-on splat: its disk counts nowhere

// Whether a splat's image, by its L, is over 30 times as long as wide. Moments over pixels then lose its width.
MGSR_HD bool is_needle(const float L[4]) {
  const float trace = L[0] * L[0] + L[1] * L[1] + L[2] * L[2] + L[3] * L[3], det = L[0] * L[3] - L[1] * L[2];
  return !(trace * trace < 1e3f * det * det);
}

// A splat in the form that the blending loops read: one cache line. With d = pixel - (x, y) and w = 1 + g . d, the
// pixel's ray meets the splat's plane at depth / w, and the weight there is 2^-(|L d|^2 / w^2).
struct alignas(64) SurfelRecord {
  float x, y;
  float L[4], g[2];
  float signed_depth;  // of the centre; negative unless plain
  float log2_opacity;
  float color[3], normal[3];

  // Whether neither the low-pass nor the near plane affects any pixel, and the splat is no needle.
  MGSR_MEMBER bool plain() const { return signed_depth > 0; }
  MGSR_MEMBER bool needle() const { return is_needle(L); }
  MGSR_MEMBER float depth() const { return signed_depth > 0 ? signed_depth : -signed_depth; }
};

// The gradient of a (splat, tile) pair, as sums over pixels. kXX, kXY, kYY: second moments of the exponent's gradient /
// w^2.
// kSlopeX, kSlopeY: first moments of w's gradient. Both are moments over d; for a needle, they are moments over L d,
// which keep their precision however thin it is. kW: the gradient of w. kMeanX, kMeanY: first moments for a plain
// splat, else the centre's gradient itself. kDepth: times the depth. kOpacity: times the opacity.
enum SurfelPairField { kXX, kXY, kYY, kSlopeX, kSlopeY, kMeanX, kMeanY, kW, kDepth, kOpacity, kColor, kNormal = kColor + 3 };

// Returns the record of a projected splat without its colour. If the splat is not plain, the caller negates the depth.
MGSR_HD SurfelRecord surfel_record(const ProjectedSurfel<float>& s, bool edge_on, float opacity) {
  SurfelRecord record = {s.x, s.y, {}, {s.g[0], s.g[1]}, s.depth, log2(opacity), {}, {s.normal[0], s.normal[1], s.normal[2]}};
  for (int k = 0; k < 4; ++k) record.L[k] = kRootExponentScale * s.L[k];
  if (edge_on) record.L[0] = record.L[3] = kNever;
  return record;
}

// Converts the sums over a splat's pairs to the gradients of its projection. slope: see math/surfel.h.
template <class T>
MGSR_HD SurfelPull<T> surfel_gradients(const SurfelRecord& s, const T slope[2], const float* total) {
  T uu = total[kXX], uv = total[kXY], vv = total[kYY], u = total[kSlopeX], v = total[kSlopeY];
  SurfelPull<T> g = {total[kMeanX], total[kMeanY], total[kDepth] / T(s.depth()), {}, {}};
  const T L[4] = {s.L[0], s.L[1], s.L[2], s.L[3]};
  if (s.plain()) {
    // A shift of the centre shifts every d in the opposite direction.
    const T a = L[0] * g.x + L[1] * g.y, b = L[2] * g.x + L[3] * g.y, v_w = total[kW];
    g.x = L[0] * a + L[2] * b - s.g[0] * v_w;
    g.y = L[1] * a + L[3] * b - s.g[1] * v_w;
  }
  if (!s.needle()) {
    const T ux = L[0] * uu + L[1] * uv, uy = L[0] * uv + L[1] * vv, vx = L[2] * uu + L[3] * uv, vy = L[2] * uv + L[3] * vv;
    const T along[2] = {L[0] * u + L[1] * v, L[2] * u + L[3] * v};
    uu = ux * L[0] + uy * L[1], uv = ux * L[2] + uy * L[3], vv = vx * L[2] + vy * L[3], u = along[0], v = along[1];
  }
  // The exponent's scale cancels in the second moments. The first moments are in units of its root.
  u *= T(1 / kRootExponentScale), v *= T(1 / kRootExponentScale);
  const T W[9] = {-uu, -uv, -(uu * slope[0] + uv * slope[1]),
                  -uv, -vv, -(uv * slope[0] + vv * slope[1]),
                  u,   v,   u * slope[0] + v * slope[1]};
  for (int i = 0; i < 9; ++i) g.W[i] = W[i];
  for (int k = 0; k < 3; ++k) g.normal[k] = total[kNormal + k];
  return g;
}

}  // namespace mgsr
