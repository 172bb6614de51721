// Blending the 2D branch's surfels, front to back. A block is a tile, a thread a pixel.
//
// The block takes its list 128 splats at a time into shared memory. A warp's pixels are a block of 8x4: for each bucket of
// 32 splats its lanes test an outline each against that block, and only the splats that touch it are walked.
#pragma once

#include "kernels/common/tiles_cuda.h"
#include "kernels/surfels/record.h"
#include "math/blending.h"

namespace mgsr {

constexpr int kSurfelBatch = 128;

// A pixel's state at the begin of a bucket, [buckets, planes, 256]: its light, and what it has added up.
enum SurfelPlane { kLightPlane, kColorPlane, kNormalPlane = kColorPlane + 3, kDepthPlane = kNormalPlane + 3, kPlainPlanes,
                   kMomentPlane = kPlainPlanes, kDistortionPlanes = kMomentPlane + 2 };

struct SurfelBlendParams {
  Tiles tiles;
  const SurfelRecord* records;
  const SplatOutline* outlines;
  const float* background;               // [3]
  float near, far, low_pass;
  float *color, *alpha, *depth, *median_depth, *normal;  // [H,W,3], [H,W], [H,W], [H,W], [H,W,3]
  float* distortion;                     // [H,W], or null
  float* transmittance;                  // [H,W]
  float* moments;                        // [H,W,2] of depth, for distortion; or null
  float* states;                         // or null, when there will be no backward pass
  int* reached;                          // [tiles] how many splats of its list were looked at
};

// Depth measured from a tile's first splat, in units of the depth range: distortion needs only differences, and these lose
// no digits.
struct DepthUnit {
  float offset, scale;
  __device__ float of(float z) const { return (z - offset) * scale; }
};

__device__ inline DepthUnit depth_unit(const Tiles& tiles, const SurfelRecord* records, int tile, float near, float far) {
  const int2 range = tiles.ranges[tile];
  return {range.y > range.x ? records[tiles.entries[range.x].x].depth() : 0.0f, 1.0f / (far - near)};
}

// A splat at a pixel.
struct SurfelMeeting {
  float dx, dy;    // from the centre, pixels
  float a, b;      // L d
  float alpha;     // 0 where it does not count
  float r;         // depth = the centre's depth * r: 1 / w, or 1 where the low-pass is stronger
  float exponent;  // the weight is 2^-exponent
  bool on_disk;    // whether the disk, not the low-pass, gives the weight
};

// Products and fused operations only, so that forward and backward round alike.
__device__ inline SurfelMeeting meet(const SurfelRecord& s, int x, int y, float near, float low_pass) {
  SurfelMeeting m;
  m.dx = (float(x) + 0.5f) - s.x, m.dy = (float(y) + 0.5f) - s.y;
  m.a = fmaf(s.L[1], m.dy, __fmul_rn(s.L[0], m.dx)), m.b = fmaf(s.L[3], m.dy, __fmul_rn(s.L[2], m.dx));
  m.r = 1.0f / fmaf(s.g[1], m.dy, fmaf(s.g[0], m.dx, 1.0f));
  m.exponent = __fmul_rn(fmaf(m.a, m.a, __fmul_rn(m.b, m.b)), __fmul_rn(m.r, m.r));
  m.on_disk = true;
  if (!s.plain()) {
    const float blur = __fmul_rn(kExponentScale / low_pass, fmaf(m.dx, m.dx, __fmul_rn(m.dy, m.dy)));
    m.on_disk = m.exponent <= blur && s.depth() * m.r > near;
    if (!m.on_disk) m.exponent = blur, m.r = 1.0f;
  }
  // Also false for a NaN, where the plane is seen from its edge.
  const float log2_alpha = __fadd_rn(s.log2_opacity, -m.exponent);
  m.alpha = 0.0f;
  if (log2_alpha >= kLog2MinAlpha) m.alpha = fminf(exp2f(log2_alpha), kMaxAlpha);
  return m;
}

// Whether an outline can hold a pixel's centre of the block from (x, y) on.
__device__ inline bool touches_patch(const SplatOutline& s, int x, int y) {
  const Columns c = outline_columns(s, float(y) + 0.5f, float(y) + (kPatchHeight - 0.5f));
  return c.x0 <= c.x1 && c.x0 <= float(x) + (kPatchWidth - 0.5f) && c.x1 >= float(x) + 0.5f;
}

template <bool Distortion>
struct SurfelPixel {
  float light = 1.0f, color[3] = {}, normal[3] = {}, depth = 0.0f, median = 0.0f, m1 = 0.0f, m2 = 0.0f;

  __device__ bool open() const { return light > 0.0f; }

  __device__ void add(const SurfelRecord& s, const SurfelMeeting& m, const DepthUnit& unit) {
    const float T = light, share = pass_light(m.alpha, light) * T, z = s.depth() * m.r;
    if (!(share > 0.0f)) return;
    for (int k = 0; k < 3; ++k) color[k] = fmaf(share, s.color[k], color[k]), normal[k] = fmaf(share, s.normal[k], normal[k]);
    depth = fmaf(share, z, depth);
    if (T >= 0.5f && T - share < 0.5f) median = z;
    if (!Distortion) return;
    const float from_first = unit.of(z), w = share * from_first;
    m1 += w, m2 = fmaf(w, from_first, m2);
  }

  __device__ void save(float* state, int pixel) const {
    state[kLightPlane * kTilePixels + pixel] = light;
    if (!open()) return;  // the backward pass looks no further
    for (int k = 0; k < 3; ++k) {
      state[(kColorPlane + k) * kTilePixels + pixel] = color[k];
      state[(kNormalPlane + k) * kTilePixels + pixel] = normal[k];
    }
    state[kDepthPlane * kTilePixels + pixel] = depth;
    if (!Distortion) return;
    state[kMomentPlane * kTilePixels + pixel] = m1;
    state[(kMomentPlane + 1) * kTilePixels + pixel] = m2;
  }

  __device__ void write(const SurfelBlendParams& p, int64_t i) const {
    const float T = fabsf(light), covered = 1.0f - T;
    p.transmittance[i] = T, p.alpha[i] = covered;
    for (int k = 0; k < 3; ++k) {
      p.color[3 * i + k] = fmaf(T, p.background[k], color[k]);
      p.normal[3 * i + k] = normal[k];
    }
    p.depth[i] = covered > 0.5f * kMinAlpha ? depth / covered : 0.0f;
    p.median_depth[i] = median;
    if (!Distortion) return;
    p.moments[2 * i] = m1, p.moments[2 * i + 1] = m2;
    p.distortion[i] = fmaxf(covered * m2 - m1 * m1, 0.0f);
  }
};

template <bool Distortion>
__device__ void blend_surfels(const SurfelBlendParams& p) {
  __shared__ SurfelRecord batch[kSurfelBatch];
  __shared__ SplatOutline outlines[kSurfelBatch];
  constexpr int kPlanes = Distortion ? kDistortionPlanes : kPlainPlanes;
  const int tile = blockIdx.x, thread = threadIdx.x, lane = thread % kWarp;
  const TilePixel pixel(p.tiles, tile, thread), corner(p.tiles, tile, thread - lane);
  const DepthUnit unit = depth_unit(p.tiles, p.records, tile, p.near, p.far);
  const int2 range = p.tiles.ranges[tile];
  float* states = p.states ? p.states + int64_t(first_bucket(p.tiles, tile)) * kPlanes * kTilePixels : nullptr;
  SurfelPixel<Distortion> sums;
  if (!pixel.inside(p.tiles)) sums.light = -1.0f;
  int begin = range.x;
  for (; begin < range.y; begin += kSurfelBatch) {
    if (__syncthreads_count(sums.open()) == 0) break;
    const int count = range.y - begin < kSurfelBatch ? range.y - begin : kSurfelBatch;
    if (thread < count) {
      const int splat = p.tiles.entries[begin + thread].x;
      batch[thread] = p.records[splat], outlines[thread] = p.outlines[splat];
    }
    __syncthreads();
    for (int bucket = 0; bucket < count; bucket += kBucket) {
      if (states) {
        sums.save(states, thread);
        states += kPlanes * kTilePixels;
      }
      const int e = bucket + lane;
      const bool open = __any_sync(kFullWarp, sums.open());
      unsigned touching = __ballot_sync(kFullWarp, open && e < count && touches_patch(outlines[e], corner.x, corner.y));
      for (; touching; touching &= touching - 1) {
        const SurfelRecord& s = batch[bucket + __ffs(touching) - 1];
        sums.add(s, meet(s, pixel.x, pixel.y, p.near, p.low_pass), unit);
      }
    }
  }
  if (thread == 0) p.reached[tile] = (begin < range.y ? begin : range.y) - range.x;
  if (pixel.inside(p.tiles)) sums.write(p, pixel.index(p.tiles));
}

}  // namespace mgsr
