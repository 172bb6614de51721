// The walk back through the 3D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// With g = v_out . (what the splat adds), the gradient to alpha_i is T_i g_i - (everything behind i) / (1 - alpha_i), and
// "everything behind" is the pixel's total less a running sum: one scalar however many channels there are.
#pragma once

#include "kernels/common/buckets_cuda.h"
#include "kernels/volumes/blending_cuda.h"

namespace mgsr {

// What the walk needs of a pixel, [tiles, planes, 256]: the gradients of its images, and what the walk will have added up
// by its end, with what lies behind the last splat.
enum VolumePixelPlane { kVColor, kVDepth = kVColor + 3, kBehind, kSinglePixelPlanes, kVWeight = kSinglePixelPlanes, kVReflColor,
                        kReflBehind = kVReflColor + 3, kDualPixelPlanes };

// Images of the forward pass and gradients of images may be null: then they count as zero.
struct VolumePixelParams {
  Tiles tiles;
  const float *transmittance, *color, *depth, *reflected, *weight;
  const float *v_color, *v_alpha, *v_depth, *v_reflected, *v_weight;
  float* planes;
};

struct VolumeBackwardParams {
  Tiles tiles;
  const VolumeRecord* records;
  const float* states;   // of the forward pass
  const int* reached;
  const float* planes;   // of volumes_pixels
  float* pairs;          // [pairs, kPairFields] by slot
};

// A thread is a pixel of the tile that is its block.
template <bool Dual>
__device__ void prepare_pixel(const VolumePixelParams& p) {
  const TilePixel pixel(p.tiles, blockIdx.x, threadIdx.x);
  if (!pixel.inside(p.tiles)) return;
  const int64_t i = pixel.index(p.tiles);
  float* out = p.planes + int64_t(blockIdx.x) * (Dual ? kDualPixelPlanes : kSinglePixelPlanes) * kTilePixels + threadIdx.x;
  const float T = p.transmittance[i], alpha = 1.0f - T;
  float total = p.v_alpha ? -T * p.v_alpha[i] : 0.0f, v_depth = 0.0f;
  for (int k = 0; k < 3; ++k) {
    const float v = p.v_color ? p.v_color[3 * i + k] : 0.0f;
    out[(kVColor + k) * kTilePixels] = v;
    total += v * p.color[3 * i + k];
  }
  if (p.v_depth && p.depth[i] > 0) {
    // depth = D / alpha: v_D = v / alpha, and v_alpha loses v * depth / alpha.
    v_depth = p.v_depth[i] / alpha;
    total += v_depth * p.depth[i];
  }
  out[kVDepth * kTilePixels] = v_depth;
  if (Dual) {
    const float v_weight = p.v_weight ? p.v_weight[i] : 0.0f;
    out[kVWeight * kTilePixels] = v_weight;
    total += v_weight * p.weight[i];
    float refl_total = 0.0f;
    for (int k = 0; k < 3; ++k) {
      const float v = p.v_reflected ? p.v_reflected[3 * i + k] : 0.0f;
      out[(kVReflColor + k) * kTilePixels] = v;
      refl_total += v * p.reflected[3 * i + k];
    }
    out[kReflBehind * kTilePixels] = refl_total;
  }
  out[kBehind * kTilePixels] = total;
}

// A bucket's pixels in flight: their gradients, coordinates and states at its begin.
template <bool Dual>
struct VolumeRing {
  float v_color[3][kRing], v_depth[kRing], light[kRing], behind[kRing];
  float v_weight[Dual ? kRing : 1], v_refl_color[3][Dual ? kRing : 1], refl_light[Dual ? kRing : 1], refl_behind[Dual ? kRing : 1];
  int x[kRing], y[kRing];

  // planes, state: at the pixel's first number of each.
  __device__ void load(const TilePixel& pixel, const float* planes, const float* state, int at) {
    x[at] = pixel.x, y[at] = pixel.y;
    light[at] = state[kLightPlane * kTilePixels];
    float left = planes[kBehind * kTilePixels];
    const bool open = light[at] > 0.0f || (Dual && state[kReflLightPlane * kTilePixels] > 0.0f);
    for (int k = 0; k < 3; ++k) {
      v_color[k][at] = planes[(kVColor + k) * kTilePixels];
      if (open) left -= v_color[k][at] * state[(kColorPlane + k) * kTilePixels];
    }
    v_depth[at] = planes[kVDepth * kTilePixels];
    if (open) left -= v_depth[at] * state[kDepthPlane * kTilePixels];
    if (Dual) {
      v_weight[at] = planes[kVWeight * kTilePixels];
      if (open) left -= v_weight[at] * state[kWeightPlane * kTilePixels];
      refl_light[at] = state[kReflLightPlane * kTilePixels];
      float refl_left = planes[kReflBehind * kTilePixels];
      for (int k = 0; k < 3; ++k) {
        v_refl_color[k][at] = planes[(kVReflColor + k) * kTilePixels];
        if (open) refl_left -= v_refl_color[k][at] * state[(kReflColorPlane + k) * kTilePixels];
      }
      refl_behind[at] = refl_left;
    }
    behind[at] = left;
  }
};

// A pixel's state between two splats.
struct VolumeWalk {
  float light = 0.0f, behind = 0.0f, refl_light = 0.0f, refl_behind = 0.0f;
};

// One splat meets one pixel: fields [kPairFields] gets its gradient added.
template <bool Dual>
__device__ inline void meet_pixel(const VolumeRecord& r, const VolumeRing<Dual>& ring, int at, VolumeWalk& walk, float* fields) {
  const float dx = offset(ring.x[at], r.x, r.x_rest), dy = offset(ring.y[at], r.y, r.y_rest);
  const float w = exp2f(volume_exponent(r, dx, dy)), T = walk.light;
  const float alpha = pass_light(counted_alpha(r.opacity * w), walk.light);
  float v_exponent = 0.0f;
  if (alpha > 0.0f) {
    float gain = ring.v_depth[at] * r.depth;
    for (int k = 0; k < 3; ++k) gain = fmaf(ring.v_color[k][at], r.color[k], gain);
    if (Dual) gain = fmaf(ring.v_weight[at], r.weight, gain);
    const BlendStep step = blend_vjp(alpha, T, gain, walk.behind);
    v_exponent = step.v_exponent;
    fields[kOpacity] += step.v_exponent;
    for (int k = 0; k < 3; ++k) fields[kColor + k] = fmaf(step.share, ring.v_color[k][at], fields[kColor + k]);
    fields[kDepth] = fmaf(step.share, ring.v_depth[at], fields[kDepth]);
    if (Dual) fields[kWeight] = fmaf(step.share, ring.v_weight[at], fields[kWeight]);
  }
  if (Dual) {
    const float T_r = walk.refl_light, refl_alpha = pass_light(counted_alpha(r.refl_opacity * w), walk.refl_light);
    if (refl_alpha > 0.0f) {
      float gain = 0.0f;
      for (int k = 0; k < 3; ++k) gain = fmaf(ring.v_refl_color[k][at], r.refl_color[k], gain);
      const BlendStep step = blend_vjp(refl_alpha, T_r, gain, walk.refl_behind);
      v_exponent += step.v_exponent;
      fields[kReflOpacity] += step.v_exponent;
      for (int k = 0; k < 3; ++k) fields[kReflColor + k] = fmaf(step.share, ring.v_refl_color[k][at], fields[kReflColor + k]);
    }
  }
  const float vx = v_exponent * dx, vy = v_exponent * dy;
  fields[kDx] += vx, fields[kDy] += vy;
  fields[kDxx] = fmaf(vx, dx, fields[kDxx]), fields[kDxy] = fmaf(vx, dy, fields[kDxy]), fields[kDyy] = fmaf(vy, dy, fields[kDyy]);
}

template <bool Dual>
__device__ void walk_bucket(const VolumeBackwardParams& p) {
  __shared__ VolumeRing<Dual> rings[kBucketWarps];
  __shared__ unsigned char lists[kBucketWarps][kTilePixels];
  const int warp = threadIdx.x / kWarp, lane = threadIdx.x % kWarp, number = blockIdx.x * kBucketWarps + warp;
  const Bucket bucket(p.tiles, number);
  if (!bucket.exists) return;
  const bool mine = lane < bucket.count;
  const int2 entry = mine ? p.tiles.entries[bucket.first + lane] : make_int2(0, 0);
  float fields[kPairFields] = {};
  if (bucket.index * kBucket < p.reached[bucket.tile]) {
    VolumeRing<Dual>& ring = rings[warp];
    unsigned char* list = lists[warp];
    VolumeRecord r = {};
    if (mine) r = p.records[entry.x];
    VolumeWalk walk;
    const float* state = p.states + int64_t(number) * (Dual ? kDualPlanes : kSinglePlanes) * kTilePixels;
    const float* planes = p.planes + int64_t(bucket.tile) * (Dual ? kDualPixelPlanes : kSinglePixelPlanes) * kTilePixels;
    const int open = list_open_pixels(list, [&](int pixel) {
      return state[kLightPlane * kTilePixels + pixel] > 0.0f || (Dual && state[kReflLightPlane * kTilePixels + pixel] > 0.0f);
    });
    hand_through(
        open,
        [&](int i, int at) { ring.load(TilePixel(p.tiles, bucket.tile, list[i]), planes + list[i], state + list[i], at); },
        [&](int at) {
          walk.light = ring.light[at], walk.behind = ring.behind[at];
          if (Dual) walk.refl_light = ring.refl_light[at], walk.refl_behind = ring.refl_behind[at];
        },
        [&] {
          walk.light = __shfl_up_sync(kFullWarp, walk.light, 1), walk.behind = __shfl_up_sync(kFullWarp, walk.behind, 1);
          if (!Dual) return;
          walk.refl_light = __shfl_up_sync(kFullWarp, walk.refl_light, 1);
          walk.refl_behind = __shfl_up_sync(kFullWarp, walk.refl_behind, 1);
        },
        [&](int at) {
          if (mine) meet_pixel<Dual>(r, ring, at, walk, fields);
        });
  }
  if (mine) write_pair(p.pairs, entry.y, fields);
}

}  // namespace mgsr
