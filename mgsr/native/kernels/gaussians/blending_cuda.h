// Blending the 3D branch's splats, front to back. A block is a tile, a thread a pixel.
//
// The block loads its list into shared memory, 256 splats at a time and one per thread, and finds the patches of 8x4
// pixels that each splat touches. A warp has one patch. Of each bucket of 32 splats, it walks only those that touch its
// patch.
#pragma once

#include "kernels/common/tiles_cuda.h"
#include "kernels/gaussians/record.h"
#include "math/blending.h"

namespace mgsr {

// A pixel's state at the beginning of a bucket, [buckets, planes, 256]: its two transmittances, and its sums so far.
enum GaussianPlane { kTransmittancePlane, kColorPlane, kDepthPlane = kColorPlane + 3, kSinglePlanes, kWeightPlane = kSinglePlanes,
                   kReflLightPlane, kReflColorPlane, kDualPlanes = kReflColorPlane + 3 };

struct GaussianBlendParams {
  Tiles tiles;
  const GaussianRecord* records;
  const float* background;               // [3]
  float *color, *alpha, *depth;          // [H,W,3], [H,W], [H,W] or null
  float *reflected, *weight;             // [H,W,3], [H,W]; null for single opacity
  float* transmittance;                  // [H,W]
  float* states;                         // or null, if no backward pass follows
  int* reached;                          // [tiles] number of splats of each list that were processed
};

// A record in the form that the walks over a tile read.
struct alignas(16) GaussianInTile {
  float x, y;  // from the centre to the tile's first pixel's centre
  float root[3];
  float opacity, depth;
  float color[3];
  float refl_opacity, weight, refl_color[3];
  float unused;
};

__device__ inline float offset(int pixel, int16_t whole, float rest) { return (float(pixel - whole) + 0.5f) - rest; }

__device__ inline GaussianInTile in_tile(const GaussianRecord& r, const TilePixel& corner) {
  return {offset(corner.x, r.x, r.x_rest), offset(corner.y, r.y, r.y_rest), {r.root[0], r.root[1], r.root[2]},
          r.opacity, r.depth, {r.color[0], r.color[1], r.color[2]},
          r.refl_opacity, r.weight, {r.refl_color[0], r.refl_color[1], r.refl_color[2]}, 0.0f};
}

// Returns a splat's weight at (dx, dy) pixels from its centre. It uses only products and fused operations, so that
// forward and backward round alike.
__device__ inline float gaussian_weight(const GaussianInTile& r, float dx, float dy) {
  const float u = fmaf(r.root[1], dy, __fmul_rn(r.root[0], dx)), v = __fmul_rn(r.root[2], dy);
  return quick_exp2(fmaf(-u, u, -__fmul_rn(v, v)));
}

// Returns, as bits, the patches of a tile in which a splat can count.
__device__ inline unsigned touched_patches(const GaussianInTile& r) {
  const float a = r.root[0], b = r.root[1], c = r.root[2], slope = -b / a, k = c * c / (a * a);
  const float exponent = log2f(fmaxf(r.opacity, r.refl_opacity) / (0.99f * kMinAlpha)), reach = sqrtf(exponent) / c;
  const EllipseForm<float> e = {0.0f, 0.0f, 0.0f, reach, -b * reach / sqrtf(b * b + c * c), slope, exponent / (a * a), k};
  return touched_patches(r.x, r.y, [&](float y0, float y1) { return ellipse_columns(e, y0, y1); });
}

template <bool Dual>
struct GaussianPixel {
  float transmittance = 1.0f, color[3] = {}, depth = 0.0f;
  float weight = 0.0f, refl_transmittance = 1.0f, refl_color[3] = {};

  __device__ bool open() const { return transmittance > 0.0f || (Dual && refl_transmittance > 0.0f); }

  // Composites a splat. (x, y): the pixel's place in the tile.
  __device__ void add(const GaussianInTile& r, float x, float y) {
    const float w = gaussian_weight(r, r.x + x, r.y + y);
    const float T = transmittance, share = transmit(counted_alpha(r.opacity * w), transmittance) * T;
    for (int k = 0; k < 3; ++k) color[k] = fmaf(share, r.color[k], color[k]);
    depth = fmaf(share, r.depth, depth);
    if (!Dual) return;
    weight = fmaf(share, r.weight, weight);
    const float T_r = refl_transmittance, refl_share = transmit(counted_alpha(r.refl_opacity * w), refl_transmittance) * T_r;
    for (int k = 0; k < 3; ++k) refl_color[k] = fmaf(refl_share, r.refl_color[k], refl_color[k]);
  }

  __device__ void save(float* state, int pixel) const {
    state[kTransmittancePlane * kTilePixels + pixel] = transmittance;
    if (Dual) state[kReflLightPlane * kTilePixels + pixel] = refl_transmittance;
    if (!open()) return;  // the backward pass reads no states of a finished pixel
    for (int k = 0; k < 3; ++k) state[(kColorPlane + k) * kTilePixels + pixel] = color[k];
    state[kDepthPlane * kTilePixels + pixel] = depth;
    if (!Dual) return;
    state[kWeightPlane * kTilePixels + pixel] = weight;
    for (int k = 0; k < 3; ++k) state[(kReflColorPlane + k) * kTilePixels + pixel] = refl_color[k];
  }

  __device__ void write(const GaussianBlendParams& p, int64_t i) const {
    const float T = fabsf(transmittance), covered = 1.0f - T;
    p.transmittance[i] = T, p.alpha[i] = covered;
    for (int k = 0; k < 3; ++k) p.color[3 * i + k] = fmaf(T, p.background[k], color[k]);
    if (p.depth) p.depth[i] = covered > kMinAlpha / 2 ? depth / covered : 0.0f;
    if (!Dual) return;
    p.weight[i] = weight;
    for (int k = 0; k < 3; ++k) p.reflected[3 * i + k] = refl_color[k];
  }
};

template <bool Dual>
__device__ void blend_gaussians(const GaussianBlendParams& p) {
  __shared__ GaussianInTile batch[kTilePixels];
  __shared__ unsigned char patches[kTilePixels];
  constexpr int kPlanes = Dual ? kDualPlanes : kSinglePlanes;
  const int tile = blockIdx.x, thread = threadIdx.x, lane = thread % kWarp, warp = thread / kWarp;
  const TilePixel pixel(p.tiles, tile, thread), corner(p.tiles, tile, 0);
  const TilePlace place(thread);
  const float x = float(place.x), y = float(place.y);
  const int2 range = p.tiles.ranges[tile];
  float* states = p.states ? p.states + int64_t(first_bucket(p.tiles, tile)) * kPlanes * kTilePixels : nullptr;
  GaussianPixel<Dual> sums;
  if (!pixel.inside(p.tiles)) sums.transmittance = sums.refl_transmittance = -1.0f;
  int begin = range.x;
  for (; begin < range.y; begin += kTilePixels) {
    if (__syncthreads_count(sums.open()) == 0) break;
    const int count = range.y - begin < kTilePixels ? range.y - begin : kTilePixels;
    if (thread < count) {
      const GaussianInTile splat = in_tile(p.records[p.tiles.entries[begin + thread].x], corner);
      batch[thread] = splat, patches[thread] = (unsigned char)touched_patches(splat);
    }
    __syncthreads();
    for (int bucket = 0; bucket < count; bucket += kBucket) {
      if (states) {
        sums.save(states, thread);
        states += kPlanes * kTilePixels;
      }
      const int e = bucket + lane;
      const bool open = __any_sync(kFullWarp, sums.open());
      unsigned touching = __ballot_sync(kFullWarp, open && e < count && (patches[e] >> warp & 1));
      for (; touching; touching &= touching - 1) sums.add(batch[bucket + __ffs(touching) - 1], x, y);
    }
  }
  if (thread == 0) p.reached[tile] = (begin < range.y ? begin : range.y) - range.x;
  if (pixel.inside(p.tiles)) sums.write(p, pixel.index(p.tiles));
}

}  // namespace mgsr
