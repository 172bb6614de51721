// Blending the 3D branch's splats, front to back.
#pragma once

#include "kernels/common/blending.h"
#include "kernels/common/subtiles.h"
#include "kernels/volumes/volumes.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The walk goes in batches: first the footprints of a batch's splats, which do not wait for one another, then their
// blending, which does. In one loop the processor would not see far enough ahead to overlap them. A batch has a splat
// for each lane of a vector, so that the backward pass can turn it over and sum over pixels.
constexpr int kBatch = kWidth;

// A splat met by the pixels of a sub-tile, whatever lies before it: alphas, 0 where it does not count.
struct Hit {
  const VolumeRecord* splat;
  float dx, dy;  // from its centre to the sub-tile's corner
  vfloat alpha[kVectors], refl_alpha[kVectors];
};

inline vfloat alpha_of(float opacity, vfloat weight) {
  const vfloat raw = opacity * weight;
  return keep(raw >= kMinAlpha, min(raw, splat(kMaxAlpha)));
}

template <bool Dual>
inline void meet(const VolumeRecord& r, const Pixels& pixels, Hit& hit) {
  hit.splat = &r;
  hit.dx = float(pixels.x0 - r.x) - r.x_rest, hit.dy = float(pixels.y0 - r.y) - r.y_rest;
  const vfloat ux = r.root[0] * (pixels.x + hit.dx);
  for (int n = 0; n < kVectors; ++n) {
    const vfloat dy = pixels.y[n] + hit.dy, u = fma(splat(r.root[1]), dy, ux), v = r.root[2] * dy;
    const vfloat weight = exp2_in_range(max(fma(-u, u, -(v * v)), splat(-126.0f)));
    hit.alpha[n] = alpha_of(r.opacity, weight);
    if (Dual) hit.refl_alpha[n] = alpha_of(r.refl_opacity, weight);
  }
}

template <bool Dual>
inline int meet_batch(const VolumeState& state, const SubTileLists& sub, const uint32_t* list, int count, const Pixels& pixels, Hit* hits) {
  const int n = count < kBatch ? count : kBatch;
  const int ahead = count < 2 * kBatch ? count : 2 * kBatch;
  for (int e = kBatch; e < ahead; ++e) __builtin_prefetch(&state.records[sub.splat(list[e])]);
  for (int e = 0; e < n; ++e) meet<Dual>(state.records[sub.splat(list[e])], pixels, hits[e]);
  return n;
}

// What blending adds up at a vector of pixels.
struct Blend {
  Light light, refl_light;
  vfloat color[3], depth, weight, refl_color[3];
};

template <bool Dual, bool Depth>
inline void blend_vector(const Hit* hits, int n, int v, Blend& sums) {
  // Copied out one by one, so that the loop has them in registers.
  Light light = sums.light, refl_light = sums.refl_light;
  vfloat red = sums.color[0], green = sums.color[1], blue = sums.color[2], depth = sums.depth, weight = sums.weight;
  vfloat refl_red = sums.refl_color[0], refl_green = sums.refl_color[1], refl_blue = sums.refl_color[2];
  for (int e = 0; e < n; ++e) {
    const VolumeRecord& r = *hits[e].splat;
    const vfloat alpha = light.admit(hits[e].alpha[v]), share = alpha * light.T;
    light.pass(alpha);
    red = fma(share, splat(r.color[0]), red), green = fma(share, splat(r.color[1]), green);
    blue = fma(share, splat(r.color[2]), blue);
    if (Depth) depth = fma(share, splat(r.depth), depth);
    if (!Dual) continue;
    weight = fma(share, splat(r.weight), weight);
    const vfloat refl_alpha = refl_light.admit(hits[e].refl_alpha[v]), refl_share = refl_alpha * refl_light.T;
    refl_light.pass(refl_alpha);
    refl_red = fma(refl_share, splat(r.refl_color[0]), refl_red);
    refl_green = fma(refl_share, splat(r.refl_color[1]), refl_green);
    refl_blue = fma(refl_share, splat(r.refl_color[2]), refl_blue);
  }
  sums.light = light, sums.color[0] = red, sums.color[1] = green, sums.color[2] = blue;
  if (Depth) sums.depth = depth;
  if (!Dual) return;
  sums.refl_light = refl_light, sums.weight = weight;
  sums.refl_color[0] = refl_red, sums.refl_color[1] = refl_green, sums.refl_color[2] = refl_blue;
}

template <bool Dual, bool Depth>
inline void blend_subtile(const VolumeState& state, const SubTileLists& sub, int s, const Pixels& pixels,
                          Blend p[kVectors]) {
  Hit hits[kBatch];
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    const int n = meet_batch<Dual>(state, sub, list + e, count - e, pixels, hits);
    vint open = {};
    for (int v = 0; v < kVectors; ++v) {
      blend_vector<Dual, Depth>(hits, n, v, p[v]);
      open |= p[v].light.open;
      if (Dual) open |= p[v].refl_light.open;
    }
    if (!any(open)) break;
  }
}

template <bool Dual, bool Depth>
void write_pixels(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, const Blend p[kVectors],
                  const Pixels& pixels) {
  float T[16], color[3][16], depth[16], weight[16], refl_color[3][16];
  for (int v = 0; v < kVectors; ++v) {
    const int lane = v * kWidth;
    store(T + lane, p[v].light.T);
    for (int k = 0; k < 3; ++k) store(color[k] + lane, p[v].color[k]);
    if (Depth) store(depth + lane, p[v].depth);
    if (!Dual) continue;
    store(weight + lane, p[v].weight);
    for (int k = 0; k < 3; ++k) store(refl_color[k] + lane, p[v].refl_color[k]);
  }
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
void blend(const VolumeInputs& in, VolumeState& state, const VolumeImages& out) {
  for_tiles(state.lists, state.records.data(), [&](int, const SubTileLists& sub, int x0, int y0) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const Pixels pixels(x, y);
      Blend p[kVectors] = {};
      blend_subtile<Dual, Depth>(state, sub, s, pixels, p);
      write_pixels<Dual, Depth>(in, state, out, p, pixels);
    });
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
