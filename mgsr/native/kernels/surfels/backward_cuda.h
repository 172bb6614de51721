// The walk back through the 2D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// With q = v_out . (what the splat adds), the gradient to alpha_i is T_i q_i - (everything behind i) / (1 - alpha_i), and
// "everything behind" is the pixel's total less a running sum: one scalar however many outputs there are. A splat's
// footprint depends on nine numbers (centre, L, g, depth), whose gradients need nine sums over the pixels.
#pragma once

#include "kernels/common/buckets_cuda.h"
#include "kernels/surfels/blending_cuda.h"

namespace mgsr {

// What the walk needs of a pixel, [tiles, planes, 256]: the gradients of its images, and what the walk will have added up
// by its end, with what lies behind the last splat.
enum SurfelPixelPlane { kVColor, kVNormal = kVColor + 3, kVDepth = kVNormal + 3, kVMedian, kBehind, kPlainPixelPlanes,
                        kVMoment = kPlainPixelPlanes, kDistortionPixelPlanes = kVMoment + 2 };

// Gradients of images may be null: then they count as zero.
struct SurfelPixelParams {
  Tiles tiles;
  const float *transmittance, *moments, *color, *depth, *normal;
  const float *v_color, *v_alpha, *v_depth, *v_median_depth, *v_normal, *v_distortion;
  float* planes;
};

struct SurfelBackwardParams {
  Tiles tiles;
  const SurfelRecord* records;
  float near, far, low_pass;
  const float* states;   // of the forward pass
  int state_planes;      // in them
  const int* reached;
  const float* planes;   // of surfels_pixels
  float* pairs;          // [pairs, kPairFields] by slot
};

// A thread is a pixel of the tile that is its block.
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

// A bucket's pixels in flight: their gradients, coordinates and states at its begin.
template <bool Distortion>
struct SurfelRing {
  float v_color[3][kRing], v_normal[3][kRing], v_depth[kRing], v_median[kRing], v_moment[2][Distortion ? kRing : 1];
  float light[kRing], behind[kRing];
  int x[kRing], y[kRing];

  // planes, state: at the pixel's first number of each. Only pixels that let light through are loaded.
  __device__ void load(const TilePixel& pixel, const float* planes, const float* state, int at) {
    x[at] = pixel.x, y[at] = pixel.y, light[at] = state[kLightPlane * kTilePixels];
    float left = planes[kBehind * kTilePixels];
    for (int k = 0; k < 3; ++k) {
      v_color[k][at] = planes[(kVColor + k) * kTilePixels], v_normal[k][at] = planes[(kVNormal + k) * kTilePixels];
      left -= v_color[k][at] * state[(kColorPlane + k) * kTilePixels];
      left -= v_normal[k][at] * state[(kNormalPlane + k) * kTilePixels];
    }
    v_depth[at] = planes[kVDepth * kTilePixels], v_median[at] = planes[kVMedian * kTilePixels];
    left -= v_depth[at] * state[kDepthPlane * kTilePixels];
    for (int k = 0; k < 2 && Distortion; ++k) {
      v_moment[k][at] = planes[(kVMoment + k) * kTilePixels];
      left -= v_moment[k][at] * state[(kMomentPlane + k) * kTilePixels];
    }
    behind[at] = left;
  }
};

// What a lane adds up for its splat: moments (x, y) over the pixels' offsets d, but of a needle over L d.
// xx, xy, yy, x, y: of the exponent's gradient / w^2; w_x, w_y, w: of w's gradient; blur: where the low-pass rules.
struct SurfelSums {
  float xx = 0, xy = 0, yy = 0, x = 0, y = 0, w_x = 0, w_y = 0, w = 0, blur_x = 0, blur_y = 0;
  float depth = 0, opacity = 0, color[3] = {}, normal[3] = {};

  __device__ void write(const SurfelRecord& s, float* fields) const {
    fields[kXX] = xx, fields[kXY] = xy, fields[kYY] = yy, fields[kSlopeX] = w_x, fields[kSlopeY] = w_y;
    fields[kMeanX] = x, fields[kMeanY] = y, fields[kW] = w, fields[kDepth] = depth, fields[kOpacity] = opacity;
    for (int k = 0; k < 3; ++k) fields[kColor + k] = color[k], fields[kNormal + k] = normal[k];
    if (s.plain()) return;
    // Moving the centre moves every d the other way.
    const float a = s.needle() ? x : s.L[0] * x + s.L[1] * y, b = s.needle() ? y : s.L[2] * x + s.L[3] * y;
    fields[kMeanX] = blur_x + s.L[0] * a + s.L[2] * b - s.g[0] * w;
    fields[kMeanY] = blur_y + s.L[1] * a + s.L[3] * b - s.g[1] * w;
  }
};

struct SurfelWalk {
  float light = 0.0f, behind = 0.0f;
};

// One splat meets one pixel.
template <bool Distortion>
__device__ inline void meet_pixel(const SurfelBackwardParams& p, const SurfelRecord& s, const DepthUnit& unit,
                                  const SurfelRing<Distortion>& ring, int at, SurfelWalk& walk, SurfelSums& sums) {
  const SurfelMeeting m = meet(s, ring.x[at], ring.y[at], p.near, p.low_pass);
  const float T = walk.light, alpha = pass_light(m.alpha, walk.light);
  if (!(alpha > 0.0f)) return;
  const float z = s.depth() * m.r, share = alpha * T, v_depth = ring.v_depth[at];
  float gain = v_depth * z, v_z = share * v_depth;
  for (int k = 0; k < 3; ++k) gain = fmaf(ring.v_color[k][at], s.color[k], fmaf(ring.v_normal[k][at], s.normal[k], gain));
  if (T >= 0.5f && T - share < 0.5f) v_z += ring.v_median[at];
  if (Distortion) {
    const float from_first = unit.of(z), v_m1 = ring.v_moment[0][at], v_m2 = ring.v_moment[1][at];
    gain += from_first * (v_m1 + from_first * v_m2);
    v_z += share * unit.scale * (v_m1 + 2.0f * from_first * v_m2);
  }
  const BlendStep step = blend_vjp(alpha, T, gain, walk.behind);
  const float v_log_depth = v_z * z;
  sums.depth += v_log_depth, sums.opacity += step.v_exponent;
  for (int k = 0; k < 3; ++k) {
    sums.color[k] = fmaf(share, ring.v_color[k][at], sums.color[k]);
    sums.normal[k] = fmaf(share, ring.v_normal[k][at], sums.normal[k]);
  }
  if (m.on_disk) {
    const bool needle = s.needle();
    const float scaled = 2.0f * kLn2 * step.v_exponent, v_w = (scaled * m.exponent - v_log_depth) * m.r;
    const float x = needle ? m.a : m.dx, y = needle ? m.b : m.dy;
    const float vx = scaled * m.r * m.r * x, vy = scaled * m.r * m.r * y;
    sums.x += vx, sums.y += vy, sums.w += v_w;
    sums.xx = fmaf(vx, x, sums.xx), sums.xy = fmaf(vx, y, sums.xy), sums.yy = fmaf(vy, y, sums.yy);
    sums.w_x = fmaf(v_w, x, sums.w_x), sums.w_y = fmaf(v_w, y, sums.w_y);
  } else {
    const float v_blur = step.v_exponent / p.low_pass;
    sums.blur_x = fmaf(v_blur, m.dx, sums.blur_x), sums.blur_y = fmaf(v_blur, m.dy, sums.blur_y);
  }
}

template <bool Distortion>
__device__ void walk_bucket(const SurfelBackwardParams& p) {
  __shared__ SurfelRing<Distortion> rings[kBucketWarps];
  __shared__ unsigned char lists[kBucketWarps][kTilePixels];
  const int warp = threadIdx.x / kWarp, lane = threadIdx.x % kWarp, number = blockIdx.x * kBucketWarps + warp;
  const Bucket bucket(p.tiles, number);
  if (!bucket.exists) return;
  const bool mine = lane < bucket.count;
  const int2 entry = mine ? p.tiles.entries[bucket.first + lane] : make_int2(0, 0);
  float fields[kPairFields] = {};
  if (bucket.index * kBucket < p.reached[bucket.tile]) {
    SurfelRing<Distortion>& ring = rings[warp];
    unsigned char* list = lists[warp];
    SurfelRecord s = {};
    if (mine) s = p.records[entry.x];
    const DepthUnit unit = depth_unit(p.tiles, p.records, bucket.tile, p.near, p.far);
    SurfelWalk walk;
    SurfelSums sums;
    constexpr int kPlanes = Distortion ? kDistortionPixelPlanes : kPlainPixelPlanes;
    const float* state = p.states + int64_t(number) * p.state_planes * kTilePixels;
    const float* planes = p.planes + int64_t(bucket.tile) * kPlanes * kTilePixels;
    const int open = list_open_pixels(list, [&](int pixel) { return state[kLightPlane * kTilePixels + pixel] > 0.0f; });
    hand_through(
        open,
        [&](int i, int at) { ring.load(TilePixel(p.tiles, bucket.tile, list[i]), planes + list[i], state + list[i], at); },
        [&](int at) { walk.light = ring.light[at], walk.behind = ring.behind[at]; },
        [&] {
          walk.light = __shfl_up_sync(kFullWarp, walk.light, 1), walk.behind = __shfl_up_sync(kFullWarp, walk.behind, 1);
        },
        [&](int at) {
          if (mine) meet_pixel<Distortion>(p, s, unit, ring, at, walk, sums);
        });
    sums.write(s, fields);
  }
  if (mine) write_pair(p.pairs, entry.y, fields);
}

}  // namespace mgsr
