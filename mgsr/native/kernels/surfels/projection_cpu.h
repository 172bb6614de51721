// From the 2D branch's parameters to its surfels on the image and into the tiles' lists, and back to gradients of the
// parameters.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/surfels/backward_cpu.h"
#include "kernels/surfels/surfels.h"
#include "math/surfel.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The square root of the exponent's scale: times L, it leaves a plain square.
constexpr float kRootExponentScale = 0.84932180028f;
constexpr float kNever = 1e6f;  // L of an edge-on splat: its disk counts nowhere

// A splat's footprint on the image: where its disk is strong enough to count, and the circle of its low-pass.
struct SurfelBounds {
  Ellipse disk;
  float x, y, radius;  // radius 0 where the disk is stronger than the low-pass everywhere
  bool clipped;        // the disk reaches behind the near plane

  PixelBox box() const {
    const PixelBox b = disk.box();
    return {std::min(b.x0, x - radius), std::max(b.x1, x + radius), std::min(b.y0, y - radius), std::max(b.y1, y + radius)};
  }

  Intervals cut(vfloat y0, vfloat y1) const {
    Intervals c = disk.cut(y0, y1);
    if (radius == 0.0f) return c;
    const vfloat dy = max(max(y0 - y, y - y1), vfloat{}), half2 = radius * radius - dy * dy;
    const vfloat half = sqrt(max(half2, vfloat{}));
    const vint on_circle = half2 > 0.0f;
    c.x0 = select(on_circle, select(c.any, min(c.x0, x - half), x - half), c.x0);
    c.x1 = select(on_circle, select(c.any, max(c.x1, x + half), x + half), c.x1);
    c.any |= on_circle;
    return c;
  }
};

Ellipse ellipse_of_box(const PixelBox& b) {
  const float hx = 0.5f * (b.x1 - b.x0), hy = 0.5f * (b.y1 - b.y0);
  return {{b.x0 + hx, b.y0 + hy, hx, hy, 0.0f, 0.0f, hx * hx, 0.0f}};
}

// The image of that part of the disk's bounding square (half side r in u and v) that lies beyond `near`.
PixelBox clipped_square(const Camera<float>& cam, const SurfelFrame<float>& f, const float scale[2], float r, float near) {
  PixelBox box = {1e9f, -1e9f, 1e9f, -1e9f};
  const auto add = [&](const float p[3]) {
    const float x = cam.fx * p[0] / p[2] + cam.cx, y = cam.fy * p[1] / p[2] + cam.cy;
    box = {std::min(box.x0, x), std::max(box.x1, x), std::min(box.y0, y), std::max(box.y1, y)};
  };
  constexpr float kU[5] = {-1, 1, 1, -1, -1}, kV[5] = {-1, -1, 1, 1, -1};
  float last[3];
  for (int corner = 0; corner < 5; ++corner) {
    float p[3];
    for (int i = 0; i < 3; ++i) p[i] = f.p[i] + r * (kU[corner] * scale[0] * f.tu[i] + kV[corner] * scale[1] * f.tv[i]);
    if (corner > 0 && (p[2] > near) != (last[2] > near)) {
      const float t = (near - last[2]) / (p[2] - last[2]);
      const float cut[3] = {last[0] + t * (p[0] - last[0]), last[1] + t * (p[1] - last[1]), near};
      add(cut);
    }
    if (p[2] > near) add(p);
    std::memcpy(last, p, sizeof(p));
  }
  return box;
}

// The radius of the low-pass circle; 0 when within it the disk's weight is nowhere less than the low-pass's.
float low_pass_radius(const ProjectedSurfel<float>& s, bool edge_on, float log_strength, float low_pass) {
  const float radius = std::sqrt(2.0f * low_pass * log_strength);
  const float trace = s.L[0] * s.L[0] + s.L[1] * s.L[1] + s.L[2] * s.L[2] + s.L[3] * s.L[3];
  const float det = s.L[0] * s.L[3] - s.L[1] * s.L[2];
  const float largest = 0.5f * (trace + std::sqrt(std::max(trace * trace - 4 * det * det, 0.0f)));
  const float w = 1.0f - radius * std::sqrt(s.g[0] * s.g[0] + s.g[1] * s.g[1]);
  return !edge_on && w > 0 && largest * low_pass < w * w ? 0.0f : radius;
}

SurfelBounds surfel_bounds(const SurfelInputs& in, const SurfelFrame<float>& f, const ProjectedSurfel<float>& s,
                           const float scale[2], float opacity) {
  const float log_strength = std::log(opacity / kMinAlpha), r2 = 2.0f * log_strength;
  SurfelBounds b = {{}, s.x, s.y, low_pass_radius(s, f.edge_on, log_strength, in.low_pass), false};
  SurfelOutline<float> o;
  if (surfel_outline(in.camera, f, scale, r2, in.near, o)) {
    b.disk = {EllipseForm<float>::make(s.x + o.x, s.y + o.y, o.cxx, o.cxy, o.cyy, 1.0f)};
    b.disk.w2 += 1e-6f * o.cxx;  // the rounding of a thin ellipse's determinant
  } else {
    b.clipped = true;
    const float w = float(in.width), h = float(in.height);
    const PixelBox box = clipped_square(in.camera, f, scale, std::sqrt(r2), in.near);
    // In this order a NaN, from an overflow, gives the bound.
    b.disk = ellipse_of_box({std::max(-w, box.x0), std::min(2 * w, box.x1), std::max(-h, box.y0), std::min(2 * h, box.y1)});
  }
  return b;
}

// Fills the record and bounds of splat i; false when it can't be seen or isn't finite.
bool project_one(const SurfelInputs& in, int64_t i, SurfelRecord& record, SurfelBounds& bounds) {
  const float opacity = in.opacities[i], *scale = in.scales + 2 * i;
  SurfelFrame<float> f;
  surfel_frame(in.camera, in.means + 3 * i, in.quats + 4 * i, scale, f);
  if (!(f.p[2] > in.near) || !(opacity >= kMinAlpha) || !(scale[0] > 0) || !(scale[1] > 0)) return false;
  const ProjectedSurfel<float> s = project_surfel(in.camera, f);
  record = {s.x, s.y, {}, {s.g[0], s.g[1]}, s.depth, std::log2(opacity), {}, {s.normal[0], s.normal[1], s.normal[2]}};
  for (int k = 0; k < 4; ++k) record.L[k] = kRootExponentScale * s.L[k];
  if (f.edge_on) record.L[0] = record.L[3] = kNever;
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (!all_finite(&record.x, 16) || !all_finite(scale, 2)) return false;
  bounds = surfel_bounds(in, f, s, scale, opacity);
  if (bounds.radius > 0 || bounds.clipped) record.signed_depth = -s.depth;
  const PixelBox box = bounds.box();
  return box.x1 >= 0 && box.x0 <= in.width && box.y1 >= 0 && box.y0 <= in.height;
}

// Projects and culls all splats, and notes the tiles that the visible ones touch. radii: [N] pixels, 0 where culled.
void project_all(const SurfelInputs& in, SurfelState& state, float* radii) {
  state.records.resize(in.count), state.depths.resize(in.count);
  start_lists(state.lists, in.count, in.width, in.height);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    state.lists.found[begin / kSplatChunk].count = 0;
    for (int64_t i = begin; i < end; ++i) {
      SurfelBounds bounds;
      const bool seen = project_one(in, i, state.records[i], bounds);
      radii[i] = seen ? std::max({bounds.disk.hx, bounds.disk.hy, bounds.radius}) : 0.0f;
      state.depths[i] = seen ? state.records[i].depth() : -1.0f;
      state.lists.spans[i] = {};
      if (seen) find_tiles(state.lists, i, bounds);
    }
  });
}

// From the pairs' sums to the gradients of splat i, whose record is s.
void splat_backward(const SurfelInputs& in, int64_t i, const SurfelRecord& s, const float* total, const SurfelGradients& v) {
  const float *scale = in.scales + 2 * i, *quat = in.quats + 4 * i;
  SurfelFrame<float> f;
  surfel_frame(in.camera, in.means + 3 * i, quat, scale, f);
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
  for (int k = 0; k < 3; ++k) v.colors[3 * i + k] = total[kColor + k];
  v.opacities[i] = total[kOpacity] / in.opacities[i];
  v.means2d[2 * i] = g.x, v.means2d[2 * i + 1] = g.y;
  project_surfel_vjp(in.camera, quat, scale, f, g, v.means + 3 * i, v.quats + 4 * i, v.scales + 2 * i);
}

void reduce_pairs(const SurfelInputs& in, const SurfelState& state, const SurfelGradients& v) {
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    float total[kPairFields];
    for (int64_t i = begin; i < end; ++i) {
      if (state.depths[i] < 0) continue;
      sum_pairs(state.lists, state.pair_gradients, i, total);
      splat_backward(in, i, state.records[i], total, v);
    }
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
