// Blending the 3D branch's splats, front to back.
#pragma once

#include <algorithm>
#include <cstring>

#include "kernels/common/blending.h"
#include "kernels/common/subtiles.h"
#include "kernels/gaussians/gaussians.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The walk processes batches of splats, each in stages: first the footprints and alphas, which are independent; then
// the transmittance, which depends on the splats before; then the use of both. In a single loop the processor could not
// look far enough ahead to overlap them. A batch has one splat per lane of a vector, so that the backward pass can
// transpose it and sum over pixels.
constexpr int kBatch = kWidth;

// Returns the number of pixel vectors of a sub-tile, counted once, or once for each of the two layers.
constexpr int chains(bool dual) { return dual ? 2 * kVectors : kVectors; }

// A batch of splats on a sub-tile. The last batch of a list is padded with splats that count nowhere.
template <bool Dual>
struct Batch {
  const GaussianRecord* splat[kBatch];
  float dx[kBatch], dy[kBatch];          // from their centres to the sub-tile's corner
  vfloat alpha[kBatch][chains(Dual)];    // 0 where a splat does not count
  vfloat T[kBatch][chains(Dual)];        // the transmittance before the splat
};

inline vfloat alpha_of(float opacity, vfloat weight) {
  const vfloat raw = opacity * weight;
  return keep(raw >= kMinAlpha, min(raw, splat(kMaxAlpha)));
}

// Writes the exponents of a splat's weights to alpha.
template <bool Dual>
inline void meet(const GaussianRecord& r, const Pixels& pixels, int e, Batch<Dual>& batch) {
  const float x = float(pixels.x0 - r.x) - r.x_rest, y = float(pixels.y0 - r.y) - r.y_rest;
  batch.splat[e] = &r, batch.dx[e] = x, batch.dy[e] = y;
  const vfloat ux = r.root[0] * (pixels.x + x);
  for (int n = 0; n < kVectors; ++n) {
    const vfloat dy = pixels.y[n] + y, u = fma(splat(r.root[1]), dy, ux), v = r.root[2] * dy;
    batch.alpha[e][n] = max(fma(-u, u, -(v * v)), splat(-126.0f));
  }
}

// Replaces the exponents of the weights in alpha by the alphas.
template <bool Dual>
inline void raise_alphas(Batch<Dual>& batch) {
  constexpr int kAtOnce = 4 / kVectors > 0 ? 4 / kVectors : 1;
  for (int e = 0; e < kBatch; e += kAtOnce) {
    vfloat weight[kAtOnce * kVectors];
    for (int i = 0; i < kAtOnce; ++i)
      for (int v = 0; v < kVectors; ++v) weight[i * kVectors + v] = batch.alpha[e + i][v];
    exp2_in_range<kAtOnce * kVectors>(weight);
    for (int i = 0; i < kAtOnce; ++i)
      for (int v = 0; v < kVectors; ++v) {
        batch.alpha[e + i][v] = alpha_of(batch.splat[e + i]->opacity, weight[i * kVectors + v]);
        if (Dual) batch.alpha[e + i][kVectors + v] = alpha_of(batch.splat[e + i]->refl_opacity, weight[i * kVectors + v]);
      }
  }
}

// Composites up to kBatch splats of a sub-tile's list, and returns their number.
template <bool Dual>
inline int composite_splats(const GaussianState& state, const SubTileLists& sub, const uint32_t* list, int count, const Pixels& pixels,
                       vfloat transmittances[chains(Dual)], Batch<Dual>& batch) {
  const int n = std::min(count, kBatch);
  prefetch_records(state.records.data(), sub, list, kBatch, std::min(count, 2 * kBatch));
  for (int e = 0; e < kBatch; ++e) meet<Dual>(state.records[sub.splat(list[e < n ? e : 0])], pixels, e, batch);
  raise_alphas(batch);
  transmit_batch<kBatch, chains(Dual)>(n, transmittances, batch.alpha, batch.T);
  return n;
}

// The sums of blending at a sub-tile's pixels.
struct Blend {
  vfloat color[3][kVectors] = {}, depth[kVectors] = {}, weight[kVectors] = {}, refl_color[3][kVectors] = {};
};

// The sums of a few images at a vector of pixels, kept in registers while a batch is added.
template <int Count>
struct Sums {
  vfloat value[Count];

  Sums(const vfloat images[][kVectors], int v) {
    for (int k = 0; k < Count; ++k) value[k] = images[k][v];
  }
  void write(vfloat images[][kVectors], int v) const {
    for (int k = 0; k < Count; ++k) images[k][v] = value[k];
  }
  void add(vfloat share, const float color[Count]) {
    for (int k = 0; k < Count; ++k) value[k] = fma(share, splat(color[k]), value[k]);
  }
};

template <bool Dual, bool Depth>
inline void add_transmitted(const Batch<Dual>& batch, int v, Blend& out) {
  Sums<3> color(out.color, v);
  vfloat depth = out.depth[v], weight = out.weight[v];
  for (int e = 0; e < kBatch; ++e) {
    const GaussianRecord& r = *batch.splat[e];
    const vfloat share = batch.alpha[e][v] * batch.T[e][v];
    color.add(share, r.color);
    if (Depth) depth = fma(share, splat(r.depth), depth);
    if (Dual) weight = fma(share, splat(r.weight), weight);
  }
  color.write(out.color, v), out.depth[v] = depth, out.weight[v] = weight;
}

inline void add_reflected(const Batch<true>& batch, int v, Blend& out) {
  Sums<3> color(out.refl_color, v);
  for (int e = 0; e < kBatch; ++e)
    color.add(batch.alpha[e][kVectors + v] * batch.T[e][kVectors + v], batch.splat[e]->refl_color);
  color.write(out.refl_color, v);
}

template <bool Dual, bool Depth>
inline void blend_subtile(const GaussianState& state, const SubTileLists& sub, int s, const Pixels& pixels,
                          vfloat transmittances[chains(Dual)], Blend& out) {
  Batch<Dual> batch;
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    composite_splats<Dual>(state, sub, list + e, count - e, pixels, transmittances, batch);
    for (int v = 0; v < kVectors; ++v) {
      add_transmitted<Dual, Depth>(batch, v, out);
      if constexpr (Dual) add_reflected(batch, v, out);
    }
    if (!any_open<chains(Dual)>(transmittances)) break;
  }
}

template <bool Dual, bool Depth>
void write_pixels(const GaussianInputs& in, GaussianState& state, const GaussianImages& out, const vfloat transmittances[kVectors],
                  const Blend& sums, const Pixels& pixels) {
  float T[16], color[3][16], depth[16], weight[16], refl_color[3][16];
  for (int v = 0; v < kVectors; ++v) store(T + v * kWidth, abs(transmittances[v]));
  std::memcpy(color, sums.color, sizeof(color)), std::memcpy(depth, sums.depth, sizeof(depth));
  std::memcpy(weight, sums.weight, sizeof(weight)), std::memcpy(refl_color, sums.refl_color, sizeof(refl_color));
  for_pixels(pixels.x0, pixels.y0, in.width, in.height, [&](int64_t i, int j) {
    const float alpha = 1.0f - T[j];
    state.transmittance[i] = T[j], out.alpha[i] = alpha;
    for (int k = 0; k < 3; ++k) out.color[3 * i + k] = color[k][j] + T[j] * in.background[k];
    if (Depth) out.depth[i] = alpha > kMinAlpha / 2 ? depth[j] / alpha : 0.0f;
    if (!Dual) return;
    out.weight[i] = weight[j];
    for (int k = 0; k < 3; ++k) out.reflected[3 * i + k] = refl_color[k][j];
  });
}

template <bool Dual, bool Depth>
void blend(const GaussianInputs& in, GaussianState& state, const GaussianImages& out) {
  for_tiles(state.lists, state.records.data(), [&](int, const SubTileLists& sub, int x0, int y0) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const Pixels pixels(x, y);
      vfloat transmittances[chains(Dual)];
      for (vfloat& transmittance : transmittances) transmittance = splat(1.0f);
      Blend sums;
      blend_subtile<Dual, Depth>(state, sub, s, pixels, transmittances, sums);
      write_pixels<Dual, Depth>(in, state, out, transmittances, sums, pixels);
    });
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
