// The backward pass of the 3D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// With g = v_out . (the splat's colour and depth), the gradient of alpha_i is
// T_i g_i - (sum over all splats behind i) / (1 - alpha_i). That sum is the pixel's total less a running sum, so it is
// one scalar for any number of channels.
#pragma once

#include "kernels/common/buckets_cuda.h"
#include "kernels/gaussians/blending_cuda.h"

namespace mgsr {

// The inputs of the walk at a pixel, [tiles, planes, 256]: the gradients of its images, and its totals, which are the
// sums over all splats and the background behind them.
enum GaussianPixelPlane { kVColor, kVDepth = kVColor + 3, kBehind, kSinglePixelPlanes, kVWeight = kSinglePixelPlanes, kVReflColor,
                        kReflBehind = kVReflColor + 3, kDualPixelPlanes };

// Null images of the forward pass and null gradients count as zero.
struct GaussianPixelParams {
  Tiles tiles;
  const float *transmittance, *color, *depth, *reflected, *weight;
  const float *v_color, *v_alpha, *v_depth, *v_reflected, *v_weight;
  float* planes;
};

struct GaussianBackwardParams {
  Tiles tiles;
  const GaussianRecord* records;
  const float* states;   // of the forward pass
  const int* reached;
  const float* planes;   // of gaussians_pixels
  float* pairs;          // [pairs, kPairFields] by slot
};

// A block is a tile, and a thread one of its pixels.
template <bool Dual>
__device__ void prepare_pixel(const GaussianPixelParams& p) {
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

// The contribution of a pixel to a splat's gradients: the splat's share and the gradient of its exponent, and the same
// for the reflected part.
template <bool Dual>
struct GaussianTerms;
template <>
struct alignas(8) GaussianTerms<false> {
  float share, v_exponent;
};
template <>
struct alignas(16) GaussianTerms<true> {
  float share, v_exponent, refl_share, v_refl_exponent;
};

// A warp's shared memory. sums: the fields of its splats. terms: the contributions to a chunk's splats, by pixel.
// gradients: those of the patch's pixels for colour and depth, and for reflected colour and weight.
template <bool Dual>
struct GaussianStage {
  static constexpr int kSums = Dual ? 16 : 12;
  GaussianInTile splats[kBucket];
  float4 sums[kBucket][kSums / 4];
  GaussianTerms<Dual> terms[kChunk][kTermsStride];
  float4 gradients[Dual ? 2 : 1][kWarp];
};

// The walk for walk_patches.
template <bool Dual>
struct GaussianWalk {
  GaussianStage<Dual>& stage;
  const float *state, *planes;  // the bucket's states; the tile's planes
  int patch = 0;
  float x = 0.0f, y = 0.0f;     // the lane's pixel in the tile
  float transmittance = 0.0f, behind = 0.0f, v_color[3] = {}, v_depth = 0.0f;
  float refl_transmittance = 0.0f, refl_behind = 0.0f, v_refl_color[3] = {}, v_weight = 0.0f;

  __device__ GaussianWalk(GaussianStage<Dual>& own, const float* of_bucket, const float* of_tile)
      : stage(own), state(of_bucket), planes(of_tile) {}

  __device__ float of_state(int plane) const { return state[plane * kTilePixels + patch * kWarp + threadIdx.x % kWarp]; }
  __device__ float of_pixel(int plane) const { return planes[plane * kTilePixels + patch * kWarp + threadIdx.x % kWarp]; }

  __device__ bool enter(int number) {
    patch = number, transmittance = of_state(kTransmittancePlane);
    if (Dual) refl_transmittance = of_state(kReflLightPlane);
    const bool open = transmittance > 0.0f || (Dual && refl_transmittance > 0.0f);
    if (!__any_sync(kFullWarp, open)) return false;
    const int lane = threadIdx.x % kWarp;
    const TilePlace place(number * kWarp + lane);
    x = float(place.x), y = float(place.y);
    load(open);
    stage.gradients[0][lane] = make_float4(v_color[0], v_color[1], v_color[2], v_depth);
    if (Dual) stage.gradients[Dual ? 1 : 0][lane] = make_float4(v_refl_color[0], v_refl_color[1], v_refl_color[2], v_weight);
    return true;
  }

  // Finished pixels contribute nothing, and pixels outside the image have no gradients.
  __device__ void load(bool open) {
    behind = open ? of_pixel(kBehind) : 0.0f;
    for (int k = 0; k < 3; ++k) take(open, kVColor + k, kColorPlane + k, v_color[k], behind);
    take(open, kVDepth, kDepthPlane, v_depth, behind);
    if (!Dual) return;
    take(open, kVWeight, kWeightPlane, v_weight, behind);
    refl_behind = open ? of_pixel(kReflBehind) : 0.0f;
    for (int k = 0; k < 3; ++k) take(open, kVReflColor + k, kReflColorPlane + k, v_refl_color[k], refl_behind);
  }

  __device__ void take(bool open, int plane, int state_plane, float& gradient, float& left) const {
    gradient = open ? of_pixel(plane) : 0.0f;
    if (open) left -= gradient * of_state(state_plane);
  }

  __device__ void meet(int splat, int at) {
    const GaussianInTile& r = stage.splats[splat];
    GaussianTerms<Dual>& terms = stage.terms[at][threadIdx.x % kWarp];
    const float w = gaussian_weight(r, r.x + x, r.y + y), T = transmittance;
    const float alpha = transmit(counted_alpha(r.opacity * w), transmittance);
    float gain = v_depth * r.depth;
    for (int k = 0; k < 3; ++k) gain = fmaf(v_color[k], r.color[k], gain);
    if (Dual) gain = fmaf(v_weight, r.weight, gain);
    const BlendStep step = blend_vjp(alpha, T, gain, behind);
    if constexpr (Dual) {
      const float T_r = refl_transmittance, refl_alpha = transmit(counted_alpha(r.refl_opacity * w), refl_transmittance);
      float refl_gain = 0.0f;
      for (int k = 0; k < 3; ++k) refl_gain = fmaf(v_refl_color[k], r.refl_color[k], refl_gain);
      const BlendStep refl = blend_vjp(refl_alpha, T_r, refl_gain, refl_behind);
      terms = {step.share, step.v_exponent, refl.share, refl.v_exponent};
    } else {
      terms = {step.share, step.v_exponent};
    }
  }

  __device__ void add(int splat) {
    constexpr int kSums = GaussianStage<Dual>::kSums;
    const ChunkPlace mine(threadIdx.x % kWarp);
    float fields[kPairFields] = {};
    if (splat >= 0) add_row(stage.splats[splat], mine, fields);
    sum_rows<kSums>(fields);
    if (splat < 0) return;
    float* sums = &stage.sums[splat][0].x + mine.row * (kSums / 4);
    for (int k = 0; k < kSums / 4; ++k) sums[k] += fields[k];
  }

  // Along a row only dx changes, by one per pixel.
  __device__ void add_row(const GaussianInTile& r, const ChunkPlace& mine, float* fields) const {
    const float left = r.x + float(patch % 2 * kPatchWidth), dy = r.y + float(patch / 2 * kPatchHeight + mine.row);
    float moment = 0.0f;
    for (int column = 0; column < kPatchWidth; ++column) {
      const int pixel = mine.pixel(column);
      const GaussianTerms<Dual> terms = stage.terms[mine.splat][pixel];
      const float4 v = stage.gradients[0][pixel];
      const float dx = left + float(column);
      float v_exponent = terms.v_exponent;
      fields[kOpacity] += terms.v_exponent;
      add_scaled(terms.share, v.x, fields[kColor]), add_scaled(terms.share, v.y, fields[kColor + 1]);
      add_scaled(terms.share, v.z, fields[kColor + 2]), add_scaled(terms.share, v.w, fields[kDepth]);
      if constexpr (Dual) {
        const float4 refl = stage.gradients[1][pixel];
        v_exponent += terms.v_refl_exponent;
        fields[kReflOpacity] += terms.v_refl_exponent;
        add_scaled(terms.refl_share, refl.x, fields[kReflColor]), add_scaled(terms.refl_share, refl.y, fields[kReflColor + 1]);
        add_scaled(terms.refl_share, refl.z, fields[kReflColor + 2]), add_scaled(terms.share, refl.w, fields[kWeight]);
      }
      const float vx = v_exponent * dx;
      moment += v_exponent, fields[kDx] += vx, add_scaled(vx, dx, fields[kDxx]);
    }
    fields[kDy] = moment * dy, fields[kDxy] = fields[kDx] * dy, fields[kDyy] = fields[kDy] * dy;
  }
};

// Returns the final sums of the lane's splat.
template <bool Dual>
__device__ inline void walk_splats(const GaussianBackwardParams& p, const Bucket& bucket, int number, bool mine, int splat,
                                   GaussianStage<Dual>& stage, float* fields) {
  constexpr int kQuads = GaussianStage<Dual>::kSums / 4;
  const int lane = threadIdx.x % kWarp;
  unsigned patches = 0;
  if (mine) {
    const GaussianInTile r = in_tile(p.records[splat], TilePixel(p.tiles, bucket.tile, 0));
    stage.splats[lane] = r, patches = touched_patches(r);
  }
  for (int k = 0; k < kQuads; ++k) stage.sums[lane][k] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  __syncwarp();
  GaussianWalk<Dual> walk(stage, p.states + int64_t(number) * (Dual ? kDualPlanes : kSinglePlanes) * kTilePixels,
                        p.planes + int64_t(bucket.tile) * (Dual ? kDualPixelPlanes : kSinglePixelPlanes) * kTilePixels);
  walk_patches(patches, walk);
  for (int k = 0; k < kQuads; ++k) {
    const float4 sums = stage.sums[lane][k];
    fields[4 * k] = sums.x, fields[4 * k + 1] = sums.y, fields[4 * k + 2] = sums.z, fields[4 * k + 3] = sums.w;
  }
}

template <bool Dual>
__device__ void walk_bucket(const GaussianBackwardParams& p) {
  __shared__ GaussianStage<Dual> stages[kBucketWarps];
  const int warp = threadIdx.x / kWarp, lane = threadIdx.x % kWarp, number = blockIdx.x * kBucketWarps + warp;
  const Bucket bucket(p.tiles, number);
  if (!bucket.exists) return;
  const bool mine = lane < bucket.count;
  const int2 entry = mine ? p.tiles.entries[bucket.first + lane] : make_int2(0, 0);
  float fields[kPairFields] = {};
  if (bucket.index * kBucket < p.reached[bucket.tile]) walk_splats(p, bucket, number, mine, entry.x, stages[warp], fields);
  if (mine) write_pair(p.pairs, entry.y, fields);
}

}  // namespace mgsr
