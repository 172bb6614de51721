// The backward pass of the 2D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// It also goes front to back. With q = v_out . (the splat's outputs), the gradient of alpha_i is
// T_i q_i - (sum over all splats behind i) / (1 - alpha_i). That sum is the pixel's total less a running sum, so it is
// one scalar for any number of outputs. A splat's footprint depends on nine numbers (centre, L, g, depth). Their
// gradients need nine sums over the pixels, since L enters only by its product with three second moments (record.h).
// With opacity, colour and normal, a pair has 16 sums.
#pragma once

#include "kernels/common/pairs.h"
#include "kernels/surfels/blending_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The gradient images at a sub-tile's pixels, prepared for the walk.
struct PixelGradients {
  struct Fields {
    float color[3][16], normal[3][16], depth[16], median[16], m1[16], m2[16];
    float behind[16];  // the pixel's totals: the sum over all splats, and the background behind the last one
  } f = {};

  PixelGradients(const SurfelInputs& in, const SurfelState& state, const SurfelImages& out, const SurfelImages& v, int x0,
                 int y0) {
    for_pixels(x0, y0, in.width, in.height, [&](int64_t i, int j) {
      const float T = state.transmittance[i], alpha = 1.0f - T;
      float total = v.alpha ? -T * v.alpha[i] : 0.0f;
      for (int k = 0; k < 3; ++k) {
        f.color[k][j] = v.color ? v.color[3 * i + k] : 0.0f;
        f.normal[k][j] = v.normal ? v.normal[3 * i + k] : 0.0f;
        total += f.color[k][j] * out.color[3 * i + k] + f.normal[k][j] * out.normal[3 * i + k];
      }
      if (v.depth && alpha > 0.5f * kMinAlpha) {
        // depth = sum / alpha: the sum's gradient is v / alpha, and alpha's loses v * depth / alpha.
        f.depth[j] = v.depth[i] / alpha;
        total += f.depth[j] * out.depth[i];
      }
      if (v.median_depth) f.median[j] = v.median_depth[i];
      if (v.distortion) {
        // distortion = alpha m2 - m1^2
        const float m1 = state.moments[2 * i], m2 = state.moments[2 * i + 1];
        f.m1[j] = -2.0f * m1 * v.distortion[i], f.m2[j] = alpha * v.distortion[i];
        total += f.m1[j] * m1 + f.m2[j] * m2 - T * m2 * v.distortion[i];
      }
      f.behind[j] = total;
    });
  }
};

// The result of the walk for one splat.
struct Step {
  vfloat opacity[kVectors], depth[kVectors];  // gradients of opacity and depth, times opacity and depth
  vfloat share[kVectors];                     // alpha T
};

template <bool Distortion>
inline void walk_vector(const Batch& batch, int v, const PixelGradients::Fields& g, const DepthUnit& unit, vfloat& behind_them,
                        Step* steps) {
  const int lane = v * kWidth;
  vfloat behind = behind_them;
  for (int e = 0; e < kBatch; ++e) {
    const SurfelRecord& s = *batch.splat[e];
    const vfloat alpha = batch.alpha[e][v], T = batch.T[e][v], w = alpha * T, z = batch.depth[e] * batch.r[e][v];
    const vfloat v_depth = load(g.depth + lane);
    vfloat q = load(g.color[0] + lane) * s.color[0] + load(g.color[1] + lane) * s.color[1] + load(g.color[2] + lane) * s.color[2];
    q += load(g.normal[0] + lane) * s.normal[0] + load(g.normal[1] + lane) * s.normal[1] + (load(g.normal[2] + lane) * s.normal[2] + v_depth * z);
    vfloat v_z = w * v_depth + keep((T >= 0.5f) & (T - w < 0.5f), load(g.median + lane));
    if (Distortion) {
      const vfloat m = unit.of(z), v_m1 = load(g.m1 + lane), v_m2 = load(g.m2 + lane);
      q += m * (v_m1 + m * v_m2);
      v_z += w * unit.scale * (v_m1 + 2.0f * m * v_m2);
    }
    behind -= w * q;
    const vfloat v_alpha = T * q - behind * reciprocal(1.0f - alpha);
    // The gradient is zero where alpha is clamped to its maximum, and where it is 0.
    steps[e].opacity[v] = keep(alpha < kMaxAlpha, v_alpha * alpha);
    steps[e].depth[v] = v_z * z;
    steps[e].share[v] = w;
  }
  behind_them = behind;
}

// Writes the sums [kPairFields] over the sub-tile's pixels, lane by lane. Needle: whether the splat is a needle
// (record.h); needles are never plain.
template <bool Plain, bool Needle>
inline void gather(const Batch& batch, int e, const Step& step, const Pixels& pixels, const PixelGradients::Fields& g,
                   float low_pass, vfloat sums[kPairFields]) {
  const SurfelRecord& s = *batch.splat[e];
  const vfloat dx = pixels.x + (pixels.x0 - s.x), ax = s.L[0] * dx, bx = s.L[2] * dx;
  vfloat second = {}, second_y = {}, yy = {}, w = {}, w_y = {}, blur = {}, blur_y = {}, second_a = {}, second_b = {};
  for (int k = 0; k < kPairFields; ++k) sums[k] = vfloat{};
  for (int n = 0; n < kVectors; ++n) {
    const vfloat dy = pixels.y[n] + (pixels.y0 - s.y), scaled = (2.0f * kLn2) * step.opacity[n], r = batch.r[e][n];
    // The gradients of w, and of the disk's exponent times 1/w^2; the moments of the latter give L's gradient.
    vfloat v_w = (scaled * batch.exponent[e][n] - step.depth[n]) * r, v_second = scaled * (r * r);
    if (!Plain) {
      v_second = keep(batch.on_disk[e][n], v_second), v_w = keep(batch.on_disk[e][n], v_w);
      const vfloat v_blur = keep(~batch.on_disk[e][n], step.opacity[n] / low_pass);
      blur += v_blur, blur_y += v_blur * dy;
    }
    if (Needle) {
      const vfloat a = fma(splat(s.L[1]), dy, ax), b = fma(splat(s.L[3]), dy, bx), a2 = v_second * a, b2 = v_second * b;
      second_a += a2, second_b += b2, sums[kXX] += a2 * a, sums[kXY] += a2 * b, sums[kYY] += b2 * b;
      sums[kSlopeX] += v_w * a, sums[kSlopeY] += v_w * b;
    } else {
      const vfloat y = v_second * dy;
      second += v_second, second_y += y, yy += y * dy, w_y += v_w * dy;
    }
    w += v_w;
    sums[kDepth] += step.depth[n], sums[kOpacity] += step.opacity[n];
    for (int k = 0; k < 3; ++k) sums[kColor + k] += step.share[n] * load(g.color[k] + n * kWidth);
    for (int k = 0; k < 3; ++k) sums[kNormal + k] += step.share[n] * load(g.normal[k] + n * kWidth);
  }
  const vfloat second_x = second * dx;
  if (!Needle) {
    sums[kXX] = second_x * dx, sums[kXY] = second_y * dx, sums[kYY] = yy;
    sums[kSlopeX] = w * dx, sums[kSlopeY] = w_y;
    second_a = s.L[0] * second_x + s.L[1] * second_y, second_b = s.L[2] * second_x + s.L[3] * second_y;
  }
  if (Plain) {
    sums[kMeanX] = second_x, sums[kMeanY] = second_y, sums[kW] = w;
  } else {
    // A shift of the centre shifts every d in the opposite direction.
    sums[kMeanX] = blur * dx + s.L[0] * second_a + s.L[2] * second_b - s.g[0] * w;
    sums[kMeanY] = blur_y + s.L[1] * second_a + s.L[3] * second_b - s.g[1] * w;
  }
}

// Adds each pair's sums to pairs [tile's entries, kPairFields].
template <bool Distortion>
void backward_subtile(const SurfelInputs& in, const SurfelState& state, const PixelGradients::Fields& g,
                      const SubTileLists& sub, int s, const Pixels& pixels, float* pairs) {
  const DepthUnit unit = depth_unit(in, state, sub, s);
  vfloat transmittances[kVectors], behind[kVectors];
  for (int v = 0; v < kVectors; ++v) transmittances[v] = splat(1.0f), behind[v] = load(g.behind + v * kWidth);
  Batch batch;
  Step steps[kBatch];
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    const int n = composite_splats(in, state, sub, list + e, count - e, pixels, transmittances, batch);
    for (int v = 0; v < kVectors; ++v) walk_vector<Distortion>(batch, v, g, unit, behind[v], steps);
    for (int i = 0; i < n; ++i) {
      vfloat sums[kPairFields];
      const SurfelRecord& splat = *batch.splat[i];
      if (splat.plain())
        gather<true, false>(batch, i, steps[i], pixels, g, in.low_pass, sums);
      else if (splat.needle())
        gather<false, true>(batch, i, steps[i], pixels, g, in.low_pass, sums);
      else
        gather<false, false>(batch, i, steps[i], pixels, g, in.low_pass, sums);
      add_sums<kPairFields>(sums, pairs + size_t(list[e + i]) * kPairFields);
    }
    if (!any_open<kVectors>(transmittances)) break;
  }
}

template <bool Distortion>
void blend_backward(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, const SurfelImages& v_out) {
  const auto walk = [&](const SubTileLists& sub, int x0, int y0, float* pairs) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const PixelGradients g(in, state, out, v_out, x, y);
      backward_subtile<Distortion>(in, state, g.f, sub, s, Pixels(x, y), pairs);
    });
  };
  walk_tiles(state.lists, state.records.data(), state.pair_gradients, walk);
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
