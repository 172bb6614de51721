// Blending the 2D branch's surfels, front to back. A block is a tile, a thread a pixel.
//
// The block loads its list into shared memory, 256 splats at a time and one per thread, and finds the patches of 8x4
// pixels that each splat touches. A warp has one patch. Of each bucket of 32 splats, it walks only those that touch its
// patch.
#pragma once

#include "kernels/common/tiles_cuda.h"
#include "kernels/surfels/record.h"
#include "math/blending.h"

namespace mgsr {

// A pixel's state at the beginning of a bucket, [buckets, planes, 256]: its transmittance, and its sums so far.
enum SurfelPlane { kTransmittancePlane, kColorPlane, kNormalPlane = kColorPlane + 3, kDepthPlane = kNormalPlane + 3, kPlainPlanes,
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
  float* states;                         // or null, if no backward pass follows
  int* reached;                          // [tiles] number of splats of each list that were processed
};

// Depth relative to a tile's first splat, in units of the depth range. Distortion needs only differences, which keep
// their precision in this form.
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
  float alpha;     // 0 if the splat does not count
  float r;         // depth = the centre's depth * r: 1 / w, or 1 if the low-pass is stronger
  float exponent;  // the weight is 2^-exponent
  bool on_disk;    // whether the disk, not the low-pass, gives the weight
};

// The near plane, and the exponent of the low-pass at a distance of one pixel from the centre.
struct SurfelLimits {
  float near, blur;
  __device__ SurfelLimits(float near_plane, float low_pass) : near(near_plane), blur(kExponentScale / low_pass) {}
};

// Evaluates a splat at the pixel's centre (x, y). It uses only products, fused operations and one quotient, so that
// forward and backward round alike.
__device__ inline SurfelMeeting meet(const SurfelRecord& s, float x, float y, const SurfelLimits& limits) {
  SurfelMeeting m;
  m.dx = x - s.x, m.dy = y - s.y;
  m.a = fmaf(s.L[1], m.dy, __fmul_rn(s.L[0], m.dx)), m.b = fmaf(s.L[3], m.dy, __fmul_rn(s.L[2], m.dx));
  m.r = quick_quotient(1.0f, fmaf(s.g[1], m.dy, fmaf(s.g[0], m.dx, 1.0f)));
  m.exponent = __fmul_rn(fmaf(m.a, m.a, __fmul_rn(m.b, m.b)), __fmul_rn(m.r, m.r));
  m.on_disk = true;
  if (!s.plain()) {
    const float blur = __fmul_rn(limits.blur, fmaf(m.dx, m.dx, __fmul_rn(m.dy, m.dy)));
    m.on_disk = m.exponent <= blur && s.depth() * m.r > limits.near;
    if (!m.on_disk) m.exponent = blur, m.r = 1.0f;
  }
  // Also false for NaN, which comes from a plane that is seen edge-on.
  const float log2_alpha = __fadd_rn(s.log2_opacity, -m.exponent);
  m.alpha = 0.0f;
  if (log2_alpha >= kLog2MinAlpha) m.alpha = fminf(quick_exp2(log2_alpha), kMaxAlpha);
  return m;
}

template <bool Distortion>
struct SurfelPixel {
  float transmittance = 1.0f, color[3] = {}, normal[3] = {}, depth = 0.0f, median = 0.0f, m1 = 0.0f, m2 = 0.0f;

  __device__ bool open() const { return transmittance > 0.0f; }

  __device__ void add(const SurfelRecord& s, const SurfelMeeting& m, const DepthUnit& unit) {
    const float T = transmittance, share = transmit(m.alpha, transmittance) * T, z = s.depth() * m.r;
    if (!(share > 0.0f)) return;
    for (int k = 0; k < 3; ++k) color[k] = fmaf(share, s.color[k], color[k]), normal[k] = fmaf(share, s.normal[k], normal[k]);
    depth = fmaf(share, z, depth);
    if (T >= 0.5f && T - share < 0.5f) median = z;
    if (!Distortion) return;
    const float from_first = unit.of(z), w = share * from_first;
    m1 += w, m2 = fmaf(w, from_first, m2);
  }

  __device__ void save(float* state, int pixel) const {
    state[kTransmittancePlane * kTilePixels + pixel] = transmittance;
    if (!open()) return;  // the backward pass reads no states of a finished pixel
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
    const float T = fabsf(transmittance), covered = 1.0f - T;
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
  __shared__ SurfelRecord batch[kTilePixels];
  __shared__ unsigned char patches[kTilePixels];
  constexpr int kPlanes = Distortion ? kDistortionPlanes : kPlainPlanes;
  const int tile = blockIdx.x, thread = threadIdx.x, lane = thread % kWarp, warp = thread / kWarp;
  const TilePixel pixel(p.tiles, tile, thread), corner(p.tiles, tile, 0);
  const float x = float(pixel.x) + 0.5f, y = float(pixel.y) + 0.5f;
  const SurfelLimits limits(p.near, p.low_pass);
  const DepthUnit unit = depth_unit(p.tiles, p.records, tile, p.near, p.far);
  const int2 range = p.tiles.ranges[tile];
  float* states = p.states ? p.states + int64_t(first_bucket(p.tiles, tile)) * kPlanes * kTilePixels : nullptr;
  SurfelPixel<Distortion> sums;
  if (!pixel.inside(p.tiles)) sums.transmittance = -1.0f;
  int begin = range.x;
  for (; begin < range.y; begin += kTilePixels) {
    if (__syncthreads_count(sums.open()) == 0) break;
    const int count = range.y - begin < kTilePixels ? range.y - begin : kTilePixels;
    if (thread < count) {
      const int splat = p.tiles.entries[begin + thread].x;
      batch[thread] = p.records[splat], patches[thread] = (unsigned char)touched_patches(p.outlines[splat], corner);
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
      for (; touching; touching &= touching - 1) {
        const SurfelRecord& s = batch[bucket + __ffs(touching) - 1];
        sums.add(s, meet(s, x, y, limits), unit);
      }
    }
  }
  if (thread == 0) p.reached[tile] = (begin < range.y ? begin : range.y) - range.x;
  if (pixel.inside(p.tiles)) sums.write(p, pixel.index(p.tiles));
}

}  // namespace mgsr
