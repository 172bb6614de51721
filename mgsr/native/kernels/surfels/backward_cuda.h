// The backward pass of the 2D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// With q = v_out . (the splat's outputs), the gradient of alpha_i is T_i q_i - (sum over all splats behind i) /
// (1 - alpha_i). That sum is the pixel's total less a running sum, so it is one scalar for any number of outputs. A
// splat's footprint depends on nine numbers (centre, L, g, depth), whose gradients need nine sums over the pixels.
#pragma once

#include "kernels/common/buckets_cuda.h"
#include "kernels/surfels/blending_cuda.h"

namespace mgsr {

// The inputs of the walk at a pixel, [tiles, planes, 256]: the gradients of its images, and its totals, which are the
// sums over all splats and the background behind them.
enum SurfelPixelPlane { kVColor, kVNormal = kVColor + 3, kVDepth = kVNormal + 3, kVMedian, kBehind, kPlainPixelPlanes,
                        kVMoment = kPlainPixelPlanes, kDistortionPixelPlanes = kVMoment + 2 };

// Null gradients of images count as zero.
struct SurfelPixelParams {
  Tiles tiles;
  const float *transmittance, *moments, *color, *depth, *normal;
  const float *v_color, *v_alpha, *v_depth, *v_median_depth, *v_normal, *v_distortion;
  float* planes;
};

struct SurfelBackwardParams {
  Tiles tiles;
  const SurfelRecord* records;
  const SplatOutline* outlines;
  float near, far, low_pass;
  const float* states;   // of the forward pass
  int state_planes;      // number of planes in states
  const int* reached;
  const float* planes;   // of surfels_pixels
  float* pairs;          // [pairs, kPairFields] by slot
};

// A block is a tile, and a thread one of its pixels.
template <bool Distortion>
__device__ void prepare_pixel(const SurfelPixelParams& p) {
  const TilePixel pixel(p.tiles, blockIdx.x, threadIdx.x);
  if (!pixel.inside(p.tiles)) return;
  const int64_t i = pixel.index(p.tiles);
  constexpr int kPlanes = Distortion ? kDistortionPixelPlanes : kPlainPixelPlanes;
  float* out = p.planes + int64_t(blockIdx.x) * kPlanes * kTilePixels + threadIdx.x;
  const float T = p.transmittance[i], alpha = 1.0f - T;
  float total = p.v_alpha ? -T * p.v_alpha[i] : 0.0f, v_depth = 0.0f;
  for (int k = 0; k < 3; ++k) {
    const float v_color = p.v_color ? p.v_color[3 * i + k] : 0.0f, v_normal = p.v_normal ? p.v_normal[3 * i + k] : 0.0f;
    out[(kVColor + k) * kTilePixels] = v_color, out[(kVNormal + k) * kTilePixels] = v_normal;
    total += v_color * p.color[3 * i + k] + v_normal * p.normal[3 * i + k];
  }
  if (p.v_depth && alpha > 0.5f * kMinAlpha) {
    // depth = sum / alpha: the sum's gradient is v / alpha, and alpha's loses v * depth / alpha.
    v_depth = p.v_depth[i] / alpha;
    total += v_depth * p.depth[i];
  }
  out[kVDepth * kTilePixels] = v_depth;
  out[kVMedian * kTilePixels] = p.v_median_depth ? p.v_median_depth[i] : 0.0f;
  if (Distortion) {
    // distortion = alpha m2 - m1^2
    const float m1 = p.moments[2 * i], m2 = p.moments[2 * i + 1], v = p.v_distortion[i];
    const float v_m1 = -2.0f * m1 * v, v_m2 = alpha * v;
    out[kVMoment * kTilePixels] = v_m1, out[(kVMoment + 1) * kTilePixels] = v_m2;
    total += v_m1 * m1 + v_m2 * m2 - T * m2 * v;
  }
  out[kBehind * kTilePixels] = total;
}

// The contribution of a pixel to a splat's gradients. share: times the pixel's gradients it gives those of colour and
// normal.
// pull: the exponent's gradient / w^2, times 2 ln 2; 0 where the low-pass decides. v_w: the gradient of w.
struct alignas(16) SurfelTerms {
  float share, v_exponent, pull, v_w;
};

// A warp's shared memory. sums: the fields of its splats. terms, and the depth's gradient times the depth: the
// contributions to a chunk's splats, by pixel. gradients: those of the patch's pixels; colour with the normal's x, and
// its y and z.
struct SurfelStage {
  SurfelRecord splats[kBucket];
  float4 sums[kBucket][kPairFields / 4];
  SurfelTerms terms[kChunk][kTermsStride];
  float v_log_depths[kChunk][kTermsStride];
  float4 gradients[kWarp];
  float2 more_gradients[kWarp];
};

// A splat's sums over a row: moments over the pixels' offsets (x, y), which are d, or L d for a needle.
// xx, xy, yy, x, y: moments of the pull. w_x, w_y, w: moments of w's gradient. blur: moments of the exponent's gradient
// where the low-pass decides.
struct SurfelMoments {
  float xx = 0, xy = 0, yy = 0, x = 0, y = 0, w_x = 0, w_y = 0, w = 0, blur_x = 0, blur_y = 0;

  __device__ void add(const SurfelTerms& terms, float at_x, float at_y) {
    const float vx = terms.pull * at_x, vy = terms.pull * at_y;
    x += vx, y += vy, w += terms.v_w;
    add_scaled(vx, at_x, xx), add_scaled(vx, at_y, xy), add_scaled(vy, at_y, yy);
    add_scaled(terms.v_w, at_x, w_x), add_scaled(terms.v_w, at_y, w_y);
  }

  // inverse_low_pass: 1/px^2
  __device__ void write(const SurfelRecord& s, bool needle, float inverse_low_pass, float* fields) const {
    fields[kXX] = xx, fields[kXY] = xy, fields[kYY] = yy, fields[kSlopeX] = w_x, fields[kSlopeY] = w_y, fields[kW] = w;
    fields[kMeanX] = x, fields[kMeanY] = y;
    if (s.plain()) return;
    // A shift of the centre shifts every d in the opposite direction.
    const float a = needle ? x : s.L[0] * x + s.L[1] * y, b = needle ? y : s.L[2] * x + s.L[3] * y;
    fields[kMeanX] = inverse_low_pass * blur_x + s.L[0] * a + s.L[2] * b - s.g[0] * w;
    fields[kMeanY] = inverse_low_pass * blur_y + s.L[1] * a + s.L[3] * b - s.g[1] * w;
  }
};

// The walk for walk_patches.
template <bool Distortion>
struct SurfelWalk {
  SurfelStage& stage;
  const float *state, *planes;  // the bucket's states; the tile's planes
  TilePixel corner;
  SurfelLimits limits;
  float inverse_low_pass;
  DepthUnit unit;
  int patch = 0;
  float x = 0.0f, y = 0.0f;     // the centre of the lane's pixel
  float transmittance = 0.0f, behind = 0.0f;
  float v_color[3] = {}, v_normal[3] = {}, v_depth = 0.0f, v_median = 0.0f, v_moment[2] = {};

  __device__ SurfelWalk(const SurfelBackwardParams& p, int tile, int number, SurfelStage& own)
      : stage(own),
        state(p.states + int64_t(number) * p.state_planes * kTilePixels),
        planes(p.planes + int64_t(tile) * (Distortion ? kDistortionPixelPlanes : kPlainPixelPlanes) * kTilePixels),
        corner(p.tiles, tile, 0),
        limits(p.near, p.low_pass),
        inverse_low_pass(1.0f / p.low_pass),
        unit(depth_unit(p.tiles, p.records, tile, p.near, p.far)) {}

  __device__ float of_state(int plane) const { return state[plane * kTilePixels + patch * kWarp + threadIdx.x % kWarp]; }
  __device__ float of_pixel(int plane) const { return planes[plane * kTilePixels + patch * kWarp + threadIdx.x % kWarp]; }

  __device__ bool enter(int number) {
    patch = number, transmittance = of_state(kTransmittancePlane);
    const bool open = transmittance > 0.0f;
    if (!__any_sync(kFullWarp, open)) return false;
    const int lane = threadIdx.x % kWarp;
    const TilePlace place(number * kWarp + lane);
    x = float(corner.x + place.x) + 0.5f, y = float(corner.y + place.y) + 0.5f;
    load(open);
    stage.gradients[lane] = make_float4(v_color[0], v_color[1], v_color[2], v_normal[0]);
    stage.more_gradients[lane] = make_float2(v_normal[1], v_normal[2]);
    return true;
  }

  // Finished pixels contribute nothing, and pixels outside the image have no gradients.
  __device__ void load(bool open) {
    behind = open ? of_pixel(kBehind) : 0.0f;
    for (int k = 0; k < 3; ++k) {
      take(open, kVColor + k, kColorPlane + k, v_color[k]);
      take(open, kVNormal + k, kNormalPlane + k, v_normal[k]);
    }
    take(open, kVDepth, kDepthPlane, v_depth);
    v_median = open ? of_pixel(kVMedian) : 0.0f;
    for (int k = 0; k < 2 && Distortion; ++k) take(open, kVMoment + k, kMomentPlane + k, v_moment[k]);
  }

  __device__ void take(bool open, int plane, int state_plane, float& gradient) {
    gradient = open ? of_pixel(plane) : 0.0f;
    if (open) behind -= gradient * of_state(state_plane);
  }

  __device__ void meet(int splat, int at) {
    const SurfelRecord& s = stage.splats[splat];
    const SurfelMeeting m = mgsr::meet(s, x, y, limits);
    const float T = transmittance, alpha = transmit(m.alpha, transmittance);
    SurfelTerms terms = {};
    float v_log_depth = 0.0f;
    // Where the splat does not count, the depth may have any value, even NaN.
    if (alpha > 0.0f) take_back(s, m, alpha, T, terms, v_log_depth);
    stage.terms[at][threadIdx.x % kWarp] = terms, stage.v_log_depths[at][threadIdx.x % kWarp] = v_log_depth;
  }

  __device__ void take_back(const SurfelRecord& s, const SurfelMeeting& m, float alpha, float T, SurfelTerms& terms,
                            float& v_log_depth) {
    const float z = s.depth() * m.r, share = alpha * T;
    float gain = v_depth * z, v_z = share * v_depth;
    for (int k = 0; k < 3; ++k) gain = fmaf(v_color[k], s.color[k], fmaf(v_normal[k], s.normal[k], gain));
    if (T >= 0.5f && T - share < 0.5f) v_z += v_median;
    if (Distortion) {
      const float from_first = unit.of(z);
      gain += from_first * (v_moment[0] + from_first * v_moment[1]);
      v_z += share * unit.scale * (v_moment[0] + 2.0f * from_first * v_moment[1]);
    }
    const BlendStep step = blend_vjp(alpha, T, gain, behind);
    v_log_depth = v_z * z;
    terms.share = share, terms.v_exponent = step.v_exponent;
    if (!m.on_disk) return;
    const float scaled = 2.0f * kLn2 * step.v_exponent;
    terms.pull = scaled * m.r * m.r, terms.v_w = (scaled * m.exponent - v_log_depth) * m.r;
  }

  __device__ void add(int splat) {
    const ChunkPlace mine(threadIdx.x % kWarp);
    float fields[kPairFields] = {};
    if (splat >= 0) add_row(stage.splats[splat], mine, fields);
    sum_rows<kPairFields>(fields);
    if (splat < 0) return;
    float4& sums = stage.sums[splat][mine.row];
    sums = make_float4(sums.x + fields[0], sums.y + fields[1], sums.z + fields[2], sums.w + fields[3]);
  }

  __device__ void add_row(const SurfelRecord& s, const ChunkPlace& mine, float* fields) const {
    const bool needle = s.needle();
    const float axes[4] = {needle ? s.L[0] : 1.0f, needle ? s.L[1] : 0.0f, needle ? s.L[2] : 0.0f, needle ? s.L[3] : 1.0f};
    const float left = (float(corner.x + patch % 2 * kPatchWidth) + 0.5f) - s.x;
    const float dy = (float(corner.y + patch / 2 * kPatchHeight + mine.row) + 0.5f) - s.y;
    SurfelMoments moments;
    for (int column = 0; column < kPatchWidth; ++column) {
      const int pixel = mine.pixel(column);
      const SurfelTerms terms = stage.terms[mine.splat][pixel];
      const float4 v = stage.gradients[pixel];
      const float2 more = stage.more_gradients[pixel];
      const float dx = left + float(column);
      fields[kDepth] += stage.v_log_depths[mine.splat][pixel], fields[kOpacity] += terms.v_exponent;
      add_scaled(terms.share, v.x, fields[kColor]), add_scaled(terms.share, v.y, fields[kColor + 1]);
      add_scaled(terms.share, v.z, fields[kColor + 2]), add_scaled(terms.share, v.w, fields[kNormal]);
      add_scaled(terms.share, more.x, fields[kNormal + 1]), add_scaled(terms.share, more.y, fields[kNormal + 2]);
      moments.add(terms, fmaf(axes[1], dy, axes[0] * dx), fmaf(axes[3], dy, axes[2] * dx));
      const float v_blur = terms.pull == 0.0f ? terms.v_exponent : 0.0f;
      add_scaled(v_blur, dx, moments.blur_x), add_scaled(v_blur, dy, moments.blur_y);
    }
    moments.write(s, needle, inverse_low_pass, fields);
  }
};

// Returns the final sums of the lane's splat.
template <bool Distortion>
__device__ inline void walk_splats(const SurfelBackwardParams& p, const Bucket& bucket, int number, bool mine, int splat,
                                   SurfelStage& stage, float* fields) {
  const int lane = threadIdx.x % kWarp;
  unsigned patches = 0;
  if (mine) {
    stage.splats[lane] = p.records[splat];
    patches = touched_patches(p.outlines[splat], TilePixel(p.tiles, bucket.tile, 0));
  }
  for (int k = 0; k < kPairFields / 4; ++k) stage.sums[lane][k] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  __syncwarp();
  SurfelWalk<Distortion> walk(p, bucket.tile, number, stage);
  walk_patches(patches, walk);
  for (int k = 0; k < kPairFields / 4; ++k) {
    const float4 sums = stage.sums[lane][k];
    fields[4 * k] = sums.x, fields[4 * k + 1] = sums.y, fields[4 * k + 2] = sums.z, fields[4 * k + 3] = sums.w;
  }
}

template <bool Distortion>
__device__ void walk_bucket(const SurfelBackwardParams& p) {
  __shared__ SurfelStage stages[kBucketWarps];
  const int warp = threadIdx.x / kWarp, lane = threadIdx.x % kWarp, number = blockIdx.x * kBucketWarps + warp;
  const Bucket bucket(p.tiles, number);
  if (!bucket.exists) return;
  const bool mine = lane < bucket.count;
  const int2 entry = mine ? p.tiles.entries[bucket.first + lane] : make_int2(0, 0);
  float fields[kPairFields] = {};
  if (bucket.index * kBucket < p.reached[bucket.tile])
    walk_splats<Distortion>(p, bucket, number, mine, entry.x, stages[warp], fields);
  if (mine) write_pair(p.pairs, entry.y, fields);
}

}  // namespace mgsr
