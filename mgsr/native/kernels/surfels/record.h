// A splat of the 2D branch on the image, and what the walk back through the blending finds for it.
#pragma once

#include "math/surfel.h"

namespace mgsr {

constexpr float kLn2 = 0.69314718056f;
// The square root of the exponent's scale, log2(e) / 2: times L, it leaves a plain square.
constexpr float kExponentScale = 0.72134752044f, kRootExponentScale = 0.84932180028f;
constexpr float kNever = 1e6f;  // L of an edge-on splat: its disk counts nowhere

// One splat as the blending loops read it: one cache line. With d = pixel - (x, y) and w = 1 + g . d the splat's plane
// is met at depth / w, where its weight is 2^-(|L d|^2 / w^2).
struct alignas(64) SurfelRecord {
  float x, y;
  float L[4], g[2];
  float signed_depth;  // of the centre; negative where the low-pass or the near plane may decide for a pixel
  float log2_opacity;
  float color[3], normal[3];

  MGSR_MEMBER bool plain() const { return signed_depth > 0; }
  MGSR_MEMBER float depth() const { return signed_depth > 0 ? signed_depth : -signed_depth; }
};

// Gradient of one (splat, tile) pair, as sums over pixels. kXX, kXY, kYY: second moments of the exponent's gradient /
// w^2, which give L's. kSlopeX, kSlopeY, kW: w's gradient times dx, dy, 1. kMeanX, kMeanY: first moments where the splat
// is plain, else the centre's gradient itself. kDepth, kOpacity: times the depth, times the opacity.
enum SurfelPairField { kXX, kXY, kYY, kSlopeX, kSlopeY, kMeanX, kMeanY, kW, kDepth, kOpacity, kColor, kNormal = kColor + 3 };

// The record of a projected splat, but for its colour; where the low-pass or the near plane decides, its depth is to be
// negated.
MGSR_HD SurfelRecord surfel_record(const ProjectedSurfel<float>& s, bool edge_on, float opacity) {
  SurfelRecord record = {s.x, s.y, {}, {s.g[0], s.g[1]}, s.depth, log2(opacity), {}, {s.normal[0], s.normal[1], s.normal[2]}};
  for (int k = 0; k < 4; ++k) record.L[k] = kRootExponentScale * s.L[k];
  if (edge_on) record.L[0] = record.L[3] = kNever;
  return record;
}

// From the sums over a splat's pairs to the gradients of its projection.
MGSR_HD ProjectedSurfel<float> surfel_gradients(const SurfelRecord& s, const float* total) {
  ProjectedSurfel<float> g = {};
  g.x = total[kMeanX], g.y = total[kMeanY];
  if (s.plain()) {
    // Moving the centre moves every d the other way.
    const float a = s.L[0] * g.x + s.L[1] * g.y, b = s.L[2] * g.x + s.L[3] * g.y;
    g.x = s.L[0] * a + s.L[2] * b - s.g[0] * total[kW];
    g.y = s.L[1] * a + s.L[3] * b - s.g[1] * total[kW];
  }
  g.depth = total[kDepth] / s.depth();
  for (int k = 0; k < 4; k += 2) {
    g.L[k] = -kRootExponentScale * (s.L[k] * total[kXX] + s.L[k + 1] * total[kXY]);
    g.L[k + 1] = -kRootExponentScale * (s.L[k] * total[kXY] + s.L[k + 1] * total[kYY]);
  }
  g.g[0] = total[kSlopeX], g.g[1] = total[kSlopeY];
  for (int k = 0; k < 3; ++k) g.normal[k] = total[kNormal + k];
  return g;
}

}  // namespace mgsr
