// From the 3D branch's parameters to its splats on the image and into the tiles' lists.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/common/blending.h"
#include "kernels/volumes/volumes.h"
#include "math/gaussian.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr double kLog2E = 1.4426950408889634;

bool finite(const float* p, int n) {
  float zero = 0;
  for (int i = 0; i < n; ++i) zero += p[i] * 0.0f;
  return zero == 0.0f;
}

// In float64: a splat counts for a pixel or not by a threshold, and an error of 1e-5 in the exponent, which is what float
// leaves of a centre 256 pixels out, flips some thousands of those decisions in a view.
ProjectedGaussian<double> project_exactly(const VolumeInputs& in, int64_t i) {
  Camera<double> camera;
  for (int k = 0; k < 9; ++k) camera.R[k] = in.camera.R[k];
  for (int k = 0; k < 3; ++k) camera.t[k] = in.camera.t[k];
  camera.fx = in.camera.fx, camera.fy = in.camera.fy, camera.cx = in.camera.cx, camera.cy = in.camera.cy;
  camera.width = in.width, camera.height = in.height;
  double mean[3], quat[4], scale[3];
  for (int k = 0; k < 3; ++k) mean[k] = in.means[3 * i + k], scale[k] = in.scales[3 * i + k];
  for (int k = 0; k < 4; ++k) quat[k] = in.quats[4 * i + k];
  return project_gaussian(camera, mean, quat, scale, double(in.low_pass));
}

// Fills the record and outline of splat i; false when it can't be seen or isn't finite.
bool project_one(const VolumeInputs& in, int64_t i, VolumeRecord& record, Ellipse& outline) {
  const ProjectedGaussian<double> g = project_exactly(in, i);
  const double det = g.cxx * g.cyy - g.cxy * g.cxy;
  if (!(g.depth > in.near) || !(det > 0) || !(g.cxx + g.cyy < 1e12f)) return false;
  const float factor = in.compensate ? float(g.compensation) : 1.0f;
  const float opacity = in.opacities[i] * factor;
  const float refl_opacity = in.refl_opacities ? in.refl_opacities[i] * factor : 0.0f;
  const float strongest = std::max(opacity, refl_opacity);
  if (!(strongest >= kMinAlpha) || !(strongest <= 1e6f) || !(opacity >= 0) || !(refl_opacity >= 0)) return false;
  if (!finite(in.colors + 3 * i, 3) || (in.refl_colors && !(finite(in.refl_colors + 3 * i, 3) && finite(in.weights + i, 1))))
    return false;
  const float r2 = 2.0f * std::log(strongest / kMinAlpha);
  outline = Ellipse::make(g.x, g.y, g.cxx, g.cxy, g.cyy, r2);
  const PixelBox box = outline.box();
  if (!(box.x1 >= 0 && box.x0 <= in.width && box.y1 >= 0 && box.y0 <= in.height)) return false;
  record = {};
  record.x = int16_t(std::min(std::max(std::floor(g.x), -32768.0), 32767.0));
  record.y = int16_t(std::min(std::max(std::floor(g.y), -32768.0), 32767.0));
  record.x_rest = float(g.x - record.x), record.y_rest = float(g.y - record.y);
  const double k = std::sqrt(0.5 * kLog2E), inverse = k / std::sqrt(det * g.cyy);
  record.root[0] = float(inverse * g.cyy), record.root[1] = float(-inverse * g.cxy), record.root[2] = float(k / std::sqrt(g.cyy));
  record.opacity = opacity, record.depth = g.depth;
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (in.refl_opacities) {
    record.refl_opacity = refl_opacity, record.weight = in.weights[i];
    std::memcpy(record.refl_color, in.refl_colors + 3 * i, sizeof(record.refl_color));
  }
  return true;
}

// Projects and culls all splats, and notes the tiles that the visible ones touch. radii: [N] pixels, 0 where culled.
void project_all(const VolumeInputs& in, VolumeState& state, float* radii) {
  state.records.resize(in.count), state.depths.resize(in.count);
  start_lists(state.lists, in.count, in.width, in.height);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    state.lists.found[begin / kSplatChunk].count = 0;
    for (int64_t i = begin; i < end; ++i) {
      Ellipse outline;
      const bool seen = project_one(in, i, state.records[i], outline);
      radii[i] = seen ? std::max(outline.hx, outline.hy) : 0.0f;
      state.depths[i] = seen ? state.records[i].depth : -1.0f;
      state.lists.spans[i] = {};
      if (seen) find_tiles(state.lists, i, outline);
    }
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
