// Blending the 3D branch's splats, front to back. A block is a tile, a thread a pixel.
//
// The block takes its list 256 splats at a time into shared memory. A warp's pixels are a block of 8x4: for each bucket of
// 32 splats its lanes test a splat each against that block, and only those that touch it are walked.
#pragma once

#include "kernels/common/tiles_cuda.h"
#include "kernels/volumes/record.h"
#include "math/blending.h"

namespace mgsr {

// A pixel's state at the begin of a bucket, [buckets, planes, 256]: its two lights, and what it has added up.
enum VolumePlane { kLightPlane, kColorPlane, kDepthPlane = kColorPlane + 3, kSinglePlanes, kWeightPlane = kSinglePlanes,
                   kReflLightPlane, kReflColorPlane, kDualPlanes = kReflColorPlane + 3 };

struct VolumeBlendParams {
  Tiles tiles;
  const VolumeRecord* records;
  const float* background;               // [3]
  float *color, *alpha, *depth;          // [H,W,3], [H,W], [H,W] or null
  float *reflected, *weight;             // [H,W,3], [H,W]; null for single opacity
  float* transmittance;                  // [H,W]
  float* states;                         // or null, when there will be no backward pass
  int* reached;                          // [tiles] how many splats of its list were looked at
};

// 2^this, at most 1, is the splat's weight at (dx, dy) pixels from its centre. Products and fused operations only, so that
// forward and backward round alike.
__device__ inline float volume_exponent(const VolumeRecord& r, float dx, float dy) {
  const float u = fmaf(r.root[1], dy, __fmul_rn(r.root[0], dx)), v = __fmul_rn(r.root[2], dy);
  return fmaxf(fmaf(-u, u, -__fmul_rn(v, v)), -126.0f);
}

__device__ inline float offset(int pixel, int16_t whole, float rest) { return (float(pixel - whole) + 0.5f) - rest; }

// Whether a splat can count anywhere in the block of pixel centres from (x, y) on.
__device__ inline bool touches_patch(const VolumeRecord& r, int x, int y) {
  const float x0 = offset(x, r.x, r.x_rest), x1 = x0 + (kPatchWidth - 1), y0 = offset(y, r.y, r.y_rest), y1 = y0 + (kPatchHeight - 1);
  if (x0 <= 0.0f && x1 >= 0.0f && y0 <= 0.0f && y1 >= 0.0f) return true;
  const float a = r.root[0], b = r.root[1], c = r.root[2], bc2 = b * b + c * c;
  // The exponent is largest on the border; on each side, at the point nearest to that of the whole line.
  float best = -1e30f;
  for (int side = 0; side < 2; ++side) {
    const float dy = side ? y1 : y0, dx = side ? x1 : x0;
    best = fmaxf(best, volume_exponent(r, held_between(-b * dy / a, x0, x1), dy));
    best = fmaxf(best, volume_exponent(r, dx, held_between(-a * b * dx / bc2, y0, y1)));
  }
  return exp2f(best) * fmaxf(r.opacity, r.refl_opacity) >= 0.99f * kMinAlpha;
}

template <bool Dual>
struct VolumePixel {
  float light = 1.0f, color[3] = {}, depth = 0.0f;
  float weight = 0.0f, refl_light = 1.0f, refl_color[3] = {};

  __device__ bool open() const { return light > 0.0f || (Dual && refl_light > 0.0f); }

  __device__ void add(const VolumeRecord& r, int x, int y) {
    const float exponent = volume_exponent(r, offset(x, r.x, r.x_rest), offset(y, r.y, r.y_rest));
    const float w = exp2f(exponent), T = light, share = pass_light(counted_alpha(r.opacity * w), light) * T;
    if (share > 0.0f) {
      for (int k = 0; k < 3; ++k) color[k] = fmaf(share, r.color[k], color[k]);
      depth = fmaf(share, r.depth, depth);
      if (Dual) weight = fmaf(share, r.weight, weight);
    }
    if (!Dual) return;
    const float T_r = refl_light, refl_share = pass_light(counted_alpha(r.refl_opacity * w), refl_light) * T_r;
    for (int k = 0; k < 3; ++k) refl_color[k] = fmaf(refl_share, r.refl_color[k], refl_color[k]);
  }

  __device__ void save(float* state, int pixel) const {
    state[kLightPlane * kTilePixels + pixel] = light;
    if (Dual) state[kReflLightPlane * kTilePixels + pixel] = refl_light;
    if (!open()) return;  // the backward pass looks no further
    for (int k = 0; k < 3; ++k) state[(kColorPlane + k) * kTilePixels + pixel] = color[k];
    state[kDepthPlane * kTilePixels + pixel] = depth;
    if (!Dual) return;
    state[kWeightPlane * kTilePixels + pixel] = weight;
    for (int k = 0; k < 3; ++k) state[(kReflColorPlane + k) * kTilePixels + pixel] = refl_color[k];
  }

  __device__ void write(const VolumeBlendParams& p, int64_t i) const {
    const float T = fabsf(light), covered = 1.0f - T;
    p.transmittance[i] = T, p.alpha[i] = covered;
    for (int k = 0; k < 3; ++k) p.color[3 * i + k] = fmaf(T, p.background[k], color[k]);
    if (p.depth) p.depth[i] = covered > kMinAlpha / 2 ? depth / covered : 0.0f;
    if (!Dual) return;
    p.weight[i] = weight;
    for (int k = 0; k < 3; ++k) p.reflected[3 * i + k] = refl_color[k];
  }
};

template <bool Dual>
__device__ void blend_volumes(const VolumeBlendParams& p) {
  __shared__ VolumeRecord batch[kTilePixels];
  const int tile = blockIdx.x, thread = threadIdx.x, lane = thread % kWarp;
  const TilePixel pixel(p.tiles, tile, thread), corner(p.tiles, tile, thread - lane);
  const int2 range = p.tiles.ranges[tile];
  float* states = p.states ? p.states + int64_t(first_bucket(p.tiles, tile)) * (Dual ? kDualPlanes : kSinglePlanes) * kTilePixels : nullptr;
  VolumePixel<Dual> sums;
  if (!pixel.inside(p.tiles)) sums.light = sums.refl_light = -1.0f;
  int begin = range.x;
  for (; begin < range.y; begin += kTilePixels) {
    if (__syncthreads_count(sums.open()) == 0) break;
    const int count = range.y - begin < kTilePixels ? range.y - begin : kTilePixels;
    if (thread < count) batch[thread] = p.records[p.tiles.entries[begin + thread].x];
    __syncthreads();
    for (int bucket = 0; bucket < count; bucket += kBucket) {
      if (states) {
        sums.save(states, thread);
        states += (Dual ? kDualPlanes : kSinglePlanes) * kTilePixels;
      }
      const int e = bucket + lane;
      const bool open = __any_sync(kFullWarp, sums.open());
      unsigned touching = __ballot_sync(kFullWarp, open && e < count && touches_patch(batch[e], corner.x, corner.y));
      for (; touching; touching &= touching - 1) sums.add(batch[bucket + __ffs(touching) - 1], pixel.x, pixel.y);
    }
  }
  if (thread == 0) p.reached[tile] = (begin < range.y ? begin : range.y) - range.x;
  if (pixel.inside(p.tiles)) sums.write(p, pixel.index(p.tiles));
}

}  // namespace mgsr
