// The backward pass of the 3D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// It also goes front to back. With g = v_out . (the splat's colour and depth), the gradient of alpha_i is
// T_i g_i - (sum over all splats behind i) / (1 - alpha_i). That sum is the pixel's total less a running sum, so it is
// one scalar for any number of channels. The sums over a tile's pixels go to the pair's own slot.
#pragma once

#include "kernels/common/pairs.h"
#include "kernels/gaussians/blending_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The gradient images at a sub-tile's pixels, prepared for the walk.
template <bool Dual, bool Depth>
struct PixelGradients {
  float color[4][16] = {};  // the gradients of colour and, as the fourth, of depth
  float weight[16] = {}, refl_color[3][16] = {};
  // The pixel's totals: the sum over all splats, and the background behind the last one.
  float behind[16] = {}, refl_behind[16] = {};

  PixelGradients(const GaussianInputs& in, const GaussianState& state, const GaussianImages& out, const GaussianImages& v,
                 const Pixels& pixels) {
    for_pixels(pixels.x0, pixels.y0, in.width, in.height, [&](int64_t i, int j) {
      const float T = state.transmittance[i], alpha = 1.0f - T;
      float total = v.alpha ? -T * v.alpha[i] : 0.0f;
      for (int k = 0; k < 3; ++k) {
        color[k][j] = v.color ? v.color[3 * i + k] : 0.0f;
        total += color[k][j] * out.color[3 * i + k];
      }
      if (Depth && v.depth && out.depth[i] > 0) {
        // depth = D / alpha: v_D = v / alpha, and v_alpha loses v * depth / alpha.
        color[3][j] = v.depth[i] / alpha;
        total += color[3][j] * out.depth[i];
      }
      if (Dual) {
        weight[j] = v.weight ? v.weight[i] : 0.0f;
        total += weight[j] * out.weight[i];
        for (int k = 0; k < 3; ++k) {
          refl_color[k][j] = v.reflected ? v.reflected[3 * i + k] : 0.0f;
          refl_behind[j] += refl_color[k][j] * out.reflected[3 * i + k];
        }
      }
      behind[j] = total;
    });
  }
};

// The result of the walk for a batch: for each splat, its share and the gradient of its exponent at each pixel.
struct Steps {
  alignas(64) float share[kBatch][16], exponent[kBatch][16], refl_share[kBatch][16], refl_exponent[kBatch][16];
};

inline vfloat dot(const vfloat a[3], const float b[3]) { return fma(a[0], splat(b[0]), fma(a[1], splat(b[1]), a[2] * b[2])); }

// blend_vjp of one splat at a vector of pixels.
inline void step(vfloat alpha, vfloat T, vfloat gain, vfloat& behind, float* share, float* v_exponent) {
  const vfloat w = alpha * T;
  behind = fma(-w, gain, behind);
  const vfloat v_alpha = fma(T, gain, -(behind * reciprocal(1.0f - alpha)));
  store(share, w);
  // The gradient is zero where alpha is clamped to its maximum, and where it is 0.
  store(v_exponent, keep(alpha < kMaxAlpha, v_alpha * alpha));
}

template <bool Dual, bool Depth>
inline void walk_transmitted(const Batch<Dual>& batch, int v, const PixelGradients<Dual, Depth>& g, vfloat& behind, Steps& steps) {
  const int lane = v * kWidth;
  const vfloat v_color[3] = {load(g.color[0] + lane), load(g.color[1] + lane), load(g.color[2] + lane)};
  vfloat left = behind;
  for (int e = 0; e < kBatch; ++e) {
    const GaussianRecord& r = *batch.splat[e];
    vfloat gain = dot(v_color, r.color);
    if (Depth) gain = fma(load(g.color[3] + lane), splat(r.depth), gain);
    if (Dual) gain = fma(load(g.weight + lane), splat(r.weight), gain);
    step(batch.alpha[e][v], batch.T[e][v], gain, left, steps.share[e] + lane, steps.exponent[e] + lane);
  }
  behind = left;
}

template <bool Depth>
inline void walk_reflected(const Batch<true>& batch, int v, const PixelGradients<true, Depth>& g, vfloat& behind, Steps& steps) {
  const int lane = v * kWidth, c = kVectors + v;
  const vfloat v_color[3] = {load(g.refl_color[0] + lane), load(g.refl_color[1] + lane), load(g.refl_color[2] + lane)};
  vfloat left = behind;
  for (int e = 0; e < kBatch; ++e) {
    const vfloat gain = dot(v_color, batch.splat[e]->refl_color);
    step(batch.alpha[e][c], batch.T[e][c], gain, left, steps.refl_share[e] + lane, steps.refl_exponent[e] + lane);
  }
  behind = left;
}

// From here on, each lane of a vector is a splat.

// Transposes the steps' values at kWidth pixels from `pixel` on.
inline void turn(const float steps[kBatch][16], int pixel, vfloat by_pixel[kWidth]) {
  for (int e = 0; e < kBatch; ++e) by_pixel[e] = load(steps[e] + pixel);
  transpose(by_pixel);
}

// Moments over a sub-tile's pixels, with their offsets from its middle.
struct Moments {
  vfloat one = {}, x = {}, y = {}, xx = {}, xy = {}, yy = {};

  void add_row(const vfloat a[4], float row) {
    const vfloat outer = a[0] + a[3], inner = a[1] + a[2], sum = outer + inner;
    const vfloat sum_x = fma(splat(1.5f), a[3] - a[0], 0.5f * (a[2] - a[1]));
    one += sum, x += sum_x, xx += fma(splat(2.25f), outer, 0.25f * inner);
    y = fma(splat(row), sum, y), xy = fma(splat(row), sum_x, xy), yy = fma(splat(row * row), sum, yy);
  }

  // Writes the moments relative to the splat's centre, from which the middle is at (dx, dy).
  void write(vfloat dx, vfloat dy, vfloat fields[kPairFields]) const {
    const vfloat from_x = fma(dx, one, x), from_y = fma(dy, one, y);
    fields[kDx] = from_x, fields[kDy] = from_y;
    fields[kDxx] = fma(dx, x + from_x, xx), fields[kDyy] = fma(dy, y + from_y, yy);
    fields[kDxy] = fma(dx, from_y, fma(dy, x, xy));
  }
};

// Adds to fields[k] the product of the shares with gradient image k. The images' rows are given from the first pixel
// on.
template <int Images>
inline void add_products(const vfloat shares[kWidth], const float (*v_images)[16], int pixel, vfloat fields[Images]) {
  vfloat sums[Images];
  for (int k = 0; k < Images; ++k) sums[k] = fields[k];
  for (int p = 0; p < kWidth; ++p)
    for (int k = 0; k < Images; ++k) sums[k] = fma(shares[p], splat(v_images[k][pixel + p]), sums[k]);
  for (int k = 0; k < Images; ++k) fields[k] = sums[k];
}

template <bool Dual, bool Depth>
inline void gather(const Steps& steps, const PixelGradients<Dual, Depth>& g, vfloat dx, vfloat dy, vfloat fields[kPairFields]) {
  for (int k = 0; k < kPairFields; ++k) fields[k] = vfloat{};
  Moments moments;
  vfloat a[kWidth], b[kWidth];
  for (int pixel = 0; pixel < 16; pixel += kWidth) {
    turn(steps.share, pixel, a);
    add_products<Depth ? 4 : 3>(a, g.color, pixel, fields + kColor);
    if (Dual) add_products<1>(a, &g.weight, pixel, fields + kWeight);
    turn(steps.exponent, pixel, a);
    for (int p = 0; p < kWidth; ++p) fields[kOpacity] += a[p];
    if (Dual) {
      turn(steps.refl_exponent, pixel, b);
      for (int p = 0; p < kWidth; ++p) fields[kReflOpacity] += b[p], a[p] += b[p];
      turn(steps.refl_share, pixel, b);
      add_products<3>(b, g.refl_color, pixel, fields + kReflColor);
    }
    for (int p = 0; p < kWidth; p += kSubTile) moments.add_row(a + p, float((pixel + p) / kSubTile) - 1.5f);
  }
  moments.write(dx, dy, fields);
}

// Adds the sums of a batch's splats to pairs [tile's entries, kPairFields].
inline void add_to_pairs(vfloat fields[kPairFields], const uint32_t* list, int n, float* pairs) {
  for (int k = 0; k < kPairFields; k += kWidth) {
    transpose(fields + k);
    for (int e = 0; e < n; ++e) {
      float* pair = pairs + size_t(list[e]) * kPairFields + k;
      store(pair, load(pair) + fields[k + e]);
    }
  }
}

template <bool Dual, bool Depth>
void backward_subtile(const GaussianState& state, const PixelGradients<Dual, Depth>& g, const SubTileLists& sub, int s,
                      const Pixels& pixels, float* pairs) {
  vfloat transmittances[chains(Dual)], behind[chains(Dual)], fields[kPairFields];
  for (vfloat& transmittance : transmittances) transmittance = splat(1.0f);
  for (int v = 0; v < kVectors; ++v) {
    behind[v] = load(g.behind + v * kWidth);
    if (Dual) behind[kVectors + v] = load(g.refl_behind + v * kWidth);
  }
  Batch<Dual> batch;
  Steps steps;
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    const int n = composite_splats<Dual>(state, sub, list + e, count - e, pixels, transmittances, batch);
    for (int v = 0; v < kVectors; ++v) {
      walk_transmitted<Dual, Depth>(batch, v, g, behind[v], steps);
      if constexpr (Dual) walk_reflected<Depth>(batch, v, g, behind[kVectors + v], steps);
    }
    gather<Dual, Depth>(steps, g, load(batch.dx) + 0.5f * kSubTile, load(batch.dy) + 0.5f * kSubTile, fields);
    add_to_pairs(fields, list + e, n, pairs);
    if (!any_open<chains(Dual)>(transmittances)) break;
  }
}

template <bool Dual, bool Depth>
void blend_backward(const GaussianInputs& in, GaussianState& state, const GaussianImages& out, const GaussianImages& v_out) {
  const auto walk = [&](const SubTileLists& sub, int x0, int y0, float* pairs) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const Pixels pixels(x, y);
      const PixelGradients<Dual, Depth> g(in, state, out, v_out, pixels);
      backward_subtile<Dual, Depth>(state, g, sub, s, pixels, pairs);
    });
  };
  walk_tiles(state.lists, state.records.data(), state.pair_gradients, walk);
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
