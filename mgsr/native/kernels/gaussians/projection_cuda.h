// The projection of the 3D branch's splats to the image, and the gradients of the parameters, given the sums over the
// tiles.
// One thread per splat.
#pragma once

#include "kernels/common/tiles_cuda.h"
#include "kernels/gaussians/needle.h"
#include "kernels/gaussians/record.h"
#include "math/blending.h"
#include "math/footprint.h"
#include "math/two_floats.h"

namespace mgsr {

constexpr int kSplatThreads = 128;

// The 3D branch's parameters and the view of them.
struct GaussianSplats {
  int64_t count;
  const float *means, *quats, *scales;        // [N,3], [N,4] wxyz, [N,3]
  const float *opacities, *colors;            // [N], [N,3]: the transmitted part
  const float *refl_opacities, *refl_colors;  // [N], [N,3]: the reflected part, or null
  const float* weights;                       // [N], or null
  Camera<float> camera;
  int width, height;
  float near, low_pass;                       // camera units; px^2
  int compensate;                             // whether to undo the energy that the low-pass adds
};

struct GaussianProjectParams {
  GaussianSplats in;
  GaussianRecord* records;    // [N], set only for visible splats
  SplatOutline* outlines;   // [N], likewise
  float* depths;            // [N] of the centres, kCulledDepth for culled splats
  int* tile_counts;         // [N]
  float* radii;             // [N] pixels, 0 for culled splats
};

struct GaussianGradientParams {
  GaussianSplats in;
  const GaussianRecord* records;
  const float* radii;
  const float* sums;        // [N, kPairFields], set only for splats that touch a tile
  const int* tile_counts;
  float *means, *quats, *scales, *opacities, *colors, *refl_opacities, *refl_colors, *weights, *means2d;  // outputs
};

__device__ inline bool finite_light(const GaussianSplats& in, int64_t i) {
  if (!finite(in.colors + 3 * i, 3)) return false;
  return !in.refl_colors || (finite(in.refl_colors + 3 * i, 3) && finite(in.weights + i, 1));
}

// Splits a centre's coordinate into its whole and its fractional part.
__device__ inline void split(double x, int16_t& whole, float& rest) {
  const double low = floor(x), held = low < -32768.0 ? -32768.0 : low > 32767.0 ? 32767.0 : low;
  whole = int16_t(held), rest = float(x - held);
}

__device__ inline void split(TwoFloats x, int16_t& whole, float& rest) {
  float low = floorf(x.high);
  if ((x.high - low) + x.low < 0.0f) low -= 1.0f;
  const float held = held_between(low, -32768.0f, 32767.0f);
  whole = int16_t(held), rest = (x.high - held) + x.low;
}

// Whether a splat is visible, invisible, or must be projected again in float64.
enum class Sight { kSeen, kUnseen, kUnsure };

// Whether a projection in two floats is precise enough: the record then has the precision of float, and decisions are
// those of float64. This excludes numbers near the end of the range, splats thousands of times longer than wide, and
// splats at a threshold.
__device__ inline bool sure(const GaussianSplats& in, int64_t i, const ProjectedGaussian<TwoFloats>& g, float det) {
  const float cxx = g.cxx.high, cyy = g.cyy.high, near_gap = g.depth.high - in.near;
  if (!(cxx > 1e-6f && cyy > 1e-6f && cxx + cyy < 0.999e12f)) return false;
  const float reach = fabsf(g.x.high) + fabsf(g.y.high) + fabsf(g.depth.high);
  if (!(det > 2e-6f * cxx * cyy && reach < 1e9f)) return false;
  if (!(fabsf(near_gap) > 1e-6f * (fabsf(in.near) + fabsf(g.depth.high)))) return false;
  if (!in.compensate) return true;
  // The compensation's square is the ratio of the determinant without the low-pass, which may be even smaller, to this
  // one.
  const float opacity = fmaxf(in.opacities[i], in.refl_opacities ? in.refl_opacities[i] : 0.0f);
  const float kept2 = g.compensation.high * g.compensation.high, spread = cxx * cyy / det;
  if (sqrtf(kept2 + 1e-12f * spread) * opacity < 0.999f * kMinAlpha) return true;
  return kept2 > 2e-6f * spread && fabsf(g.compensation.high * opacity - kMinAlpha) > 1e-5f * kMinAlpha;
}
__device__ inline bool sure(const GaussianSplats&, int64_t, const ProjectedGaussian<double>&, float) { return true; }

// Fills the record and the outline of a splat if it is visible and finite.
template <class T>
__device__ inline Sight project_as(const GaussianSplats& in, int64_t i, GaussianRecord& record, SplatOutline& outline) {
  T mean[3], quat[4], scale[3], root[3];
  for (int k = 0; k < 3; ++k) mean[k] = in.means[3 * i + k], scale[k] = in.scales[3 * i + k];
  for (int k = 0; k < 4; ++k) quat[k] = in.quats[4 * i + k];
  const ProjectedGaussian<T> g = project_gaussian(camera_as<T>(in.camera), mean, quat, scale, T(in.low_pass));
  const T det = footprint_root(g, root);
  if (!sure(in, i, g, float(det))) return Sight::kUnsure;
  if (!(g.depth > T(in.near) && det > T(0) && g.cxx + g.cyy < T(1e12))) return Sight::kUnseen;
  const float left = in.compensate ? float(g.compensation) : 1.0f;
  record.opacity = in.opacities[i] * left;
  record.refl_opacity = in.refl_opacities ? in.refl_opacities[i] * left : 0.0f;
  const float strongest = fmaxf(record.opacity, record.refl_opacity);
  // In this form, NaN also makes a splat invisible.
  if (!(strongest >= kMinAlpha && strongest <= 1e6f && record.opacity >= 0 && record.refl_opacity >= 0)) return Sight::kUnseen;
  if (!finite_light(in, i)) return Sight::kUnseen;
  split(g.x, record.x, record.x_rest), split(g.y, record.y, record.y_rest);
  for (int k = 0; k < 3; ++k) record.root[k] = float(root[k]), record.color[k] = in.colors[3 * i + k];
  record.depth = float(g.depth);
  record.weight = in.weights ? in.weights[i] : 0.0f;
  for (int k = 0; k < 3; ++k) record.refl_color[k] = in.refl_colors ? in.refl_colors[3 * i + k] : 0.0f;
  const auto e = make_ellipse(g.x, g.y, g.cxx, g.cxy, g.cyy, T(2.0f * logf(strongest / kMinAlpha)));
  outline.ellipse = {float(e.x), float(e.y), float(e.hx), float(e.hy), float(e.at_right), float(e.slope), float(e.w2), float(e.k)};
  outline.x = float(e.x), outline.y = float(e.y), outline.radius = 0.0f, outline.unused = 0.0f;
  return Sight::kSeen;
}

// Fills the record and the outline of a splat. Returns false if it is invisible or not finite. The CPU projects in
// float64, because the rounding error of float32 flips thousands of decisions (see projection_cpu.h). Float64 is slow
// on most GPUs, and two floats are precise enough for most splats. The few others are projected again in float64.
__device__ inline bool project_gaussian_splat(const GaussianSplats& in, int64_t i, GaussianRecord& record, SplatOutline& outline) {
  Sight sight = project_as<TwoFloats>(in, i, record, outline);
  if (sight == Sight::kUnsure) sight = project_as<double>(in, i, record, outline);
  return sight == Sight::kSeen;
}

// Writes the gradients that need no projection. Returns the gradient of the compensation, 0 without compensation.
__device__ inline float light_gradients(const GaussianGradientParams& p, int64_t i, const float* total) {
  const GaussianSplats& in = p.in;
  // The exponent's and the opacity's gradients differ by the factor o; alpha = (o * compensation) * G.
  const float o = in.opacities[i], o_r = in.refl_opacities ? in.refl_opacities[i] : 0.0f;
  p.opacities[i] = o > 0 ? total[kOpacity] / o : 0.0f;
  for (int k = 0; k < 3; ++k) p.colors[3 * i + k] = total[kColor + k];
  if (in.refl_opacities) {
    p.refl_opacities[i] = o_r > 0 ? total[kReflOpacity] / o_r : 0.0f;
    p.weights[i] = total[kWeight];
    for (int k = 0; k < 3; ++k) p.refl_colors[3 * i + k] = total[kReflColor + k];
  }
  if (!in.compensate || !(p.radii[i] > 0)) return 0.0f;
  const float factor = o > 0 ? p.records[i].opacity / o : p.records[i].refl_opacity / o_r;
  return factor > 0 ? (total[kOpacity] + total[kReflOpacity]) / factor : 0.0f;
}

__device__ inline void gaussian_gradients(const GaussianGradientParams& p, int64_t i) {
  const GaussianSplats& in = p.in;
  const bool touched = p.tile_counts[i] > 0;
  float total[kPairFields] = {}, mean[3] = {}, quat[4] = {}, scale[3] = {}, x = 0.0f, y = 0.0f;
  for (int k = 0; k < kPairFields && touched; ++k) total[k] = p.sums[i * kPairFields + k];
  const float v_compensation = light_gradients(p, i, total);
  if (touched && is_needle(p.records[i].root)) {
    double m[3], q[4], s[3], v_m[3] = {}, v_q[4] = {}, v_s[3] = {};
    for (int k = 0; k < 3; ++k) m[k] = in.means[3 * i + k], s[k] = in.scales[3 * i + k];
    for (int k = 0; k < 4; ++k) q[k] = in.quats[4 * i + k];
    const auto g = needle_gradients(camera_as<double>(in.camera), m, q, s, double(in.low_pass), total, v_compensation, v_m, v_q, v_s);
    x = float(g.x), y = float(g.y);
    for (int k = 0; k < 3; ++k) mean[k] = float(v_m[k]), scale[k] = float(v_s[k]);
    for (int k = 0; k < 4; ++k) quat[k] = float(v_q[k]);
  } else if (touched) {
    auto g = footprint_vjp(p.records[i].root, total[kDx], total[kDy], total[kDxx], total[kDxy], total[kDyy], total[kDepth]);
    g.compensation = v_compensation, x = g.x, y = g.y;
    project_gaussian_vjp(in.camera, in.means + 3 * i, in.quats + 4 * i, in.scales + 3 * i, in.low_pass, g, mean, quat, scale);
  }
  for (int k = 0; k < 3; ++k) p.means[3 * i + k] = mean[k], p.scales[3 * i + k] = scale[k];
  for (int k = 0; k < 4; ++k) p.quats[4 * i + k] = quat[k];
  p.means2d[2 * i] = x, p.means2d[2 * i + 1] = y;
}

}  // namespace mgsr
