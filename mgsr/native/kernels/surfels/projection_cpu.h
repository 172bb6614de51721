// The projection of the 2D branch's surfels to the image and to the tiles, and its derivative.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/surfels/backward_cpu.h"
#include "kernels/surfels/precise.h"
#include "kernels/surfels/surfels.h"
#include "math/surfel_bounds.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// A splat's bounds (math/surfel_bounds.h), in the form that the search for tiles takes.
struct Outline {
  Ellipse disk;
  float x, y, radius;

  explicit Outline(const SurfelBounds& b) : disk{b.disk}, x(b.x), y(b.y), radius(b.radius) {}

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

// Fills the record and the bounds of splat i. Returns false if it is invisible or not finite.
bool project_one(const SurfelInputs& in, int64_t i, SurfelRecord& record, SurfelBounds& bounds) {
  const float opacity = in.opacities[i], *scale = in.scales + 2 * i;
  SurfelFrame<float> f;
  surfel_frame(in.camera, in.means + 3 * i, in.quats + 4 * i, scale, f);
  if (!(f.p[2] > in.near) || !(opacity >= kMinAlpha) || !(scale[0] > 0) || !(scale[1] > 0)) return false;
  ProjectedSurfel<float> s = project_surfel(in.camera, f);
  if (is_needle(s.L)) s = project_needle(in.camera, in.means + 3 * i, in.quats + 4 * i, scale, f.edge_on);
  record = surfel_record(s, f.edge_on, opacity);
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (!all_finite(&record.x, 16) || !all_finite(scale, 2)) return false;
  const SurfelImage image = {in.near, in.low_pass, float(in.width), float(in.height)};
  bounds = surfel_bounds(in.camera, image, f, s, scale, opacity);
  if (bounds.radius > 0 || bounds.clipped || record.needle()) record.signed_depth = -s.depth;
  const PixelBox box = Outline(bounds).box();
  return box.x1 >= 0 && box.x0 <= in.width && box.y1 >= 0 && box.y0 <= in.height;
}

// Projects and culls all splats, and records the tiles that the visible ones touch. radii: [N] pixels, 0 for culled
// splats.
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
      if (seen) find_tiles(state.lists, i, Outline(bounds));
    }
  });
}

// Converts the sums over the pairs of splat i, whose record is s, to its gradients.
template <class T>
void splat_backward(const Camera<T>& cam, const SurfelInputs& in, int64_t i, const SurfelRecord& s, const float* total,
                    const SurfelGradients& v) {
  const auto g = surfel_geometry_gradients(cam, in.means + 3 * i, in.quats + 4 * i, in.scales + 2 * i, s, total);
  std::copy_n(g.mean, 3, v.means + 3 * i), std::copy_n(g.quat, 4, v.quats + 4 * i), std::copy_n(g.scale, 2, v.scales + 2 * i);
  std::copy_n(g.center, 2, v.means2d + 2 * i), std::copy_n(total + kColor, 3, v.colors + 3 * i);
  v.opacities[i] = total[kOpacity] / in.opacities[i];
}

void reduce_pairs(const SurfelInputs& in, const SurfelState& state, const SurfelGradients& v) {
  const Camera<double> precise = camera_as<double>(in.camera);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    float total[kPairFields];
    for (int64_t i = begin; i < end; ++i) {
      if (state.depths[i] < 0) continue;
      sum_pairs(state.lists, state.pair_gradients, i, total);
      const SurfelRecord& s = state.records[i];
      s.plain() ? splat_backward(in.camera, in, i, s, total, v) : splat_backward(precise, in, i, s, total, v);
    }
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
