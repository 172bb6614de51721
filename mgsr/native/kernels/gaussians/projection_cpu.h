// The projection of the 3D branch's splats to the image and to the tiles, and its derivative. It processes a few splats
// at once, one per lane of a vector.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/common/blending.h"
#include "kernels/common/lanes.h"
#include "kernels/gaussians/backward_cpu.h"
#include "kernels/gaussians/needle.h"
#include "kernels/gaussians/gaussians.h"
#include "math/footprint.h"
#include "math/gaussian.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The geometry of a few splats, in the form that the maths takes.
template <class L>
struct Geometry {
  L mean[3], quat[4], scale[3];

  Geometry(const GaussianInputs& in, const int64_t splats[L::kCount]) {
    for (int k = 0; k < 3; ++k) mean[k] = each_lane<L>([&](int lane) { return in.means[3 * splats[lane] + k]; });
    for (int k = 0; k < 4; ++k) quat[k] = each_lane<L>([&](int lane) { return in.quats[4 * splats[lane] + k]; });
    for (int k = 0; k < 3; ++k) scale[k] = each_lane<L>([&](int lane) { return in.scales[3 * splats[lane] + k]; });
  }
};

// A splat's opacities after the compensation.
struct Opacities {
  float main, refl;

  Opacities(const GaussianInputs& in, int64_t i, float compensation)
      : main(in.opacities[i] * compensation), refl(in.refl_opacities ? in.refl_opacities[i] * compensation : 0.0f) {}
  float strongest() const { return std::max(main, refl); }
  // In this form, NaN also gives false.
  bool visible() const { return strongest() >= kMinAlpha && strongest() <= 1e6f && main >= 0 && refl >= 0; }
};

bool finite_colors(const GaussianInputs& in, int64_t i) {
  if (!all_finite(in.colors + 3 * i, 3)) return false;
  return !in.refl_colors || (all_finite(in.refl_colors + 3 * i, 3) && all_finite(in.weights + i, 1));
}

// Splats on the image, in float64, because a threshold decides whether a splat counts at a pixel. For a centre 256
// pixels from the origin, rounding to float32 causes an error of 1e-5 in the exponent. That flips thousands of these
// decisions in a view.
struct Footprints {
  ProjectedGaussian<Doubles> g;
  Doubles root[3];
  Doubles::Test visible;

  Footprints(const GaussianInputs& in, const Camera<Doubles>& camera, const int64_t splats[Doubles::kCount]) {
    const Geometry<Doubles> geometry(in, splats);
    g = project_gaussian(camera, geometry.mean, geometry.quat, geometry.scale, Doubles(double(in.low_pass)));
    const Doubles det = footprint_root(g, root);
    visible = (g.depth > double(in.near)) & (det > 0.0) & (g.cxx + g.cyy < 1e12);
  }

  void write(int lane, GaussianRecord& record) const {
    const double x = std::min(std::max(std::floor(g.x[lane]), -32768.0), 32767.0);
    const double y = std::min(std::max(std::floor(g.y[lane]), -32768.0), 32767.0);
    record.x = int16_t(x), record.y = int16_t(y);
    record.x_rest = float(g.x[lane] - x), record.y_rest = float(g.y[lane] - y);
    for (int k = 0; k < 3; ++k) record.root[k] = float(root[k][lane]);
    record.depth = float(g.depth[lane]);
  }
};

void write_light(const GaussianInputs& in, int64_t i, const Opacities& opacities, GaussianRecord& record) {
  record.opacity = opacities.main, record.refl_opacity = opacities.refl;
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (!in.refl_opacities) return;
  record.weight = in.weights[i];
  std::memcpy(record.refl_color, in.refl_colors + 3 * i, sizeof(record.refl_color));
}

Ellipse lane_of(const EllipseForm<Doubles>& e, int lane) {
  return {{float(e.x[lane]), float(e.y[lane]), float(e.hx[lane]), float(e.hy[lane]), float(e.at_right[lane]),
           float(e.slope[lane]), float(e.w2[lane]), float(e.k[lane])}};
}

// Projects the splats [begin, end), at most one per lane. radii: [N] pixels, 0 for culled splats.
void project_few(const GaussianInputs& in, const Camera<Doubles>& camera, int64_t begin, int64_t end, GaussianState& state,
                 float* radii) {
  int64_t splats[Doubles::kCount];
  for (int lane = 0; lane < Doubles::kCount; ++lane) splats[lane] = std::min(begin + lane, end - 1);
  const Footprints footprints(in, camera, splats);
  Doubles r2 = 1.0;
  for (int64_t i = begin; i < end; ++i) {
    const int lane = int(i - begin);
    const Opacities opacities(in, i, in.compensate ? float(footprints.g.compensation[lane]) : 1.0f);
    const bool visible = footprints.visible[lane] && opacities.visible() && finite_colors(in, i);
    state.depths[i] = visible ? float(footprints.g.depth[lane]) : -1.0f;
    if (!visible) continue;
    r2.v[lane] = 2.0f * std::log(opacities.strongest() / kMinAlpha);
    footprints.write(lane, state.records[i]);
    write_light(in, i, opacities, state.records[i]);
  }
  const auto& g = footprints.g;
  const auto outlines = make_ellipse(g.x, g.y, g.cxx, g.cxy, g.cyy, r2);
  for (int64_t i = begin; i < end; ++i) {
    const Ellipse outline = lane_of(outlines, int(i - begin));
    const PixelBox box = outline.box();
    const bool seen = state.depths[i] >= 0 && box.x1 >= 0 && box.x0 <= in.width && box.y1 >= 0 && box.y0 <= in.height;
    radii[i] = seen ? std::max(outline.hx, outline.hy) : 0.0f;
    state.lists.spans[i] = {};
    if (seen) find_tiles(state.lists, i, outline);
    else state.depths[i] = -1.0f;
  }
}

// Projects and culls all splats, and records the tiles that the visible ones touch.
void project_all(const GaussianInputs& in, GaussianState& state, float* radii) {
  state.records.resize(in.count), state.depths.resize(in.count);
  start_lists(state.lists, in.count, in.width, in.height);
  const Camera<Doubles> camera = camera_as<Doubles>(in.camera);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    state.lists.found[begin / kSplatChunk].count = 0;
    for (int64_t i = begin; i < end; i += Doubles::kCount)
      project_few(in, camera, i, std::min(i + Doubles::kCount, end), state, radii);
  });
}

// Returns the gradients of projected splats, given the moments of their exponents' gradients.
ProjectedGaussian<Floats> projected_gradients(const GaussianState& state, const int64_t splats[Floats::kCount],
                                              const Floats total[kPairFields]) {
  Floats root[3];
  for (int k = 0; k < 3; ++k) root[k] = each_lane<Floats>([&](int lane) { return state.records[splats[lane]].root[k]; });
  return footprint_vjp(root, total[kDx], total[kDy], total[kDxx], total[kDxy], total[kDyy], total[kDepth]);
}

// Writes the gradients that need no projection. Returns the gradient of the compensation, 0 without compensation.
float light_backward(const GaussianInputs& in, const GaussianRecord& r, int64_t i, const float total[kPairFields],
                     const GaussianGradients& v) {
  // The exponent's and the opacity's gradients differ by the factor o; alpha = (o * compensation) * G.
  const float o = in.opacities[i], o_r = in.refl_opacities ? in.refl_opacities[i] : 0.0f;
  v.opacities[i] = o > 0 ? total[kOpacity] / o : 0.0f;
  for (int k = 0; k < 3; ++k) v.colors[3 * i + k] = total[kColor + k];
  if (in.refl_opacities) {
    v.refl_opacities[i] = o_r > 0 ? total[kReflOpacity] / o_r : 0.0f;
    v.weights[i] = total[kWeight];
    for (int k = 0; k < 3; ++k) v.refl_colors[3 * i + k] = total[kReflColor + k];
  }
  if (!in.compensate) return 0.0f;
  const float factor = o > 0 ? r.opacity / o : r.refl_opacity / o_r;
  return factor > 0 ? (total[kOpacity] + total[kReflOpacity]) / factor : 0.0f;
}

// Writes the gradients of one needle's geometry, which need the precision of float64.
void needle_backward(const GaussianInputs& in, int64_t i, const float total[kPairFields], float v_compensation,
                     const GaussianGradients& v) {
  double mean[3], quat[4], scale[3], v_mean[3] = {}, v_quat[4] = {}, v_scale[3] = {};
  for (int k = 0; k < 3; ++k) mean[k] = in.means[3 * i + k], scale[k] = in.scales[3 * i + k];
  for (int k = 0; k < 4; ++k) quat[k] = in.quats[4 * i + k];
  const auto g = needle_gradients(camera_as<double>(in.camera), mean, quat, scale, double(in.low_pass), total, v_compensation,
                                  v_mean, v_quat, v_scale);
  for (int k = 0; k < 3; ++k) v.means[3 * i + k] = float(v_mean[k]), v.scales[3 * i + k] = float(v_scale[k]);
  for (int k = 0; k < 4; ++k) v.quats[4 * i + k] = float(v_quat[k]);
  v.means2d[2 * i] = float(g.x), v.means2d[2 * i + 1] = float(g.y);
}

// Converts the sums over the pairs of `count` splats to their gradients. The other lanes repeat one of these splats.
// sums: [lanes, kPairFields], overwritten.
void splats_backward(const GaussianInputs& in, const GaussianState& state, const int64_t splats[Floats::kCount], int count,
                     float sums[Floats::kCount][kPairFields], const GaussianGradients& v) {
  float v_compensation[Floats::kCount] = {};
  for (int lane = 0; lane < count; ++lane)
    v_compensation[lane] = light_backward(in, state.records[splats[lane]], splats[lane], sums[lane], v);
  Floats total[kPairFields];
  for (int k = 0; k < kPairFields; k += kWidth) {
    vfloat rows[kWidth];
    for (int lane = 0; lane < kWidth; ++lane) rows[lane] = load(sums[lane] + k);
    transpose(rows);
    for (int j = 0; j < kWidth; ++j) total[k + j].v = rows[j];
  }
  ProjectedGaussian<Floats> g = projected_gradients(state, splats, total);
  g.compensation.v = load(v_compensation);
  const Geometry<Floats> geometry(in, splats);
  Floats v_mean[3] = {}, v_quat[4] = {}, v_scale[3] = {};
  project_gaussian_vjp(camera_as<Floats>(in.camera), geometry.mean, geometry.quat, geometry.scale, Floats(in.low_pass), g, v_mean,
                       v_quat, v_scale);
  for (int lane = 0; lane < count; ++lane) {
    const int64_t i = splats[lane];
    for (int k = 0; k < 3; ++k) v.means[3 * i + k] = v_mean[k][lane];
    for (int k = 0; k < 4; ++k) v.quats[4 * i + k] = v_quat[k][lane];
    for (int k = 0; k < 3; ++k) v.scales[3 * i + k] = v_scale[k][lane];
    v.means2d[2 * i] = g.x[lane], v.means2d[2 * i + 1] = g.y[lane];
    if (is_needle(state.records[i].root)) needle_backward(in, i, sums[lane], v_compensation[lane], v);
  }
}

// Sums the gradients of the pairs, and converts them to gradients of the splats.
void reduce_pairs(const GaussianInputs& in, const GaussianState& state, const GaussianGradients& v) {
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    int64_t splats[Floats::kCount];
    alignas(64) float sums[Floats::kCount][kPairFields] = {};
    int count = 0;
    for (int64_t i = begin; i < end; ++i) {
      if (state.depths[i] >= 0) {
        sum_pairs(state.lists, state.pair_gradients, i, sums[count]);
        splats[count++] = i;
      }
      if (count == Floats::kCount || (count > 0 && i + 1 == end)) {
        std::fill(splats + count, splats + Floats::kCount, splats[0]);
        splats_backward(in, state, splats, count, sums, v);
        count = 0;
      }
    }
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
