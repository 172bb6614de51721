// Blending the 2D branch's surfels, front to back.
#pragma once

#include <algorithm>

#include "kernels/common/blending.h"
#include "kernels/common/subtiles.h"
#include "kernels/surfels/surfels.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// The walk processes batches of splats, each in stages: first the footprints and alphas, which are independent; then
// the transmittance, which depends on the splats before; then the use of both. In a single loop the processor could not
// look far enough ahead to overlap them.
constexpr int kBatch = kWidth;

// A batch of splats on a sub-tile. The last batch of a list is padded with splats that count nowhere.
struct Batch {
  const SurfelRecord* splat[kBatch];
  float depth[kBatch];                 // of the centres
  vfloat alpha[kBatch][kVectors];      // 0 where a splat does not count
  vfloat T[kBatch][kVectors];          // the transmittance before the splat
  vfloat r[kBatch][kVectors];          // depth = centre's depth * r: 1 / w, or 1 where the low-pass is stronger
  vfloat exponent[kBatch][kVectors];   // the weight is 2^-exponent
  vint on_disk[kBatch][kVectors];      // where the disk, not the low-pass, gives the weight; not set for plain splats
};

// Writes the logarithms of a splat's alphas to alpha. Plain splats need no check of the low-pass and the near plane.
template <bool Plain>
inline void meet(const SurfelRecord& s, const Pixels& pixels, float near, float low_pass, int e, Batch& batch) {
  const float depth = Plain ? s.signed_depth : -s.signed_depth;
  batch.splat[e] = &s, batch.depth[e] = depth;
  const vfloat dx = pixels.x + (pixels.x0 - s.x);
  const vfloat ax = s.L[0] * dx, bx = s.L[2] * dx, wx = fma(splat(s.g[0]), dx, splat(1.0f));
  for (int v = 0; v < kVectors; ++v) {
    const vfloat dy = pixels.y[v] + (pixels.y0 - s.y);
    const vfloat a = fma(splat(s.L[1]), dy, ax), b = fma(splat(s.L[3]), dy, bx);
    const vfloat inverse = reciprocal(fma(splat(s.g[1]), dy, wx));
    vfloat exponent = fma(a, a, b * b) * (inverse * inverse), r = inverse;
    if (!Plain) {
      const vfloat blur = (kExponentScale / low_pass) * fma(dx, dx, dy * dy);
      const vint on_disk = (exponent <= blur) & (depth * inverse > near);
      exponent = select(on_disk, exponent, blur), r = select(on_disk, inverse, splat(1.0f));
      batch.on_disk[e][v] = on_disk;
    }
    // Off the disk w can be 0, and values derived from it infinite. Even 0 times infinity would spoil a sum.
    const vfloat log2_alpha = s.log2_opacity - exponent;
    const vint counts = log2_alpha >= kLog2MinAlpha;
    batch.alpha[e][v] = log2_alpha;
    batch.r[e][v] = keep(counts, r), batch.exponent[e][v] = keep(counts, exponent);
  }
}

// Replaces the logarithms of the alphas by the alphas.
inline void raise_alphas(vfloat* alpha, int count) {
  constexpr int kAtOnce = 4;
  for (int i = 0; i < count; i += kAtOnce) {
    vfloat raw[kAtOnce];
    for (int k = 0; k < kAtOnce; ++k) raw[k] = alpha[i + k];
    exp2_in_range<kAtOnce>(raw);
    for (int k = 0; k < kAtOnce; ++k) alpha[i + k] = keep(alpha[i + k] >= kLog2MinAlpha, min(raw[k], splat(kMaxAlpha)));
  }
}

// Composites up to kBatch splats of a sub-tile's list, and returns their number.
inline int composite_splats(const SurfelInputs& in, const SurfelState& state, const SubTileLists& sub, const uint32_t* list,
                       int count, const Pixels& pixels, vfloat transmittances[kVectors], Batch& batch) {
  const int n = std::min(count, kBatch);
  prefetch_records(state.records.data(), sub, list, kBatch, std::min(count, 2 * kBatch));
  for (int e = 0; e < kBatch; ++e) {
    const SurfelRecord& s = state.records[sub.splat(list[e < n ? e : 0])];
    if (s.plain())
      meet<true>(s, pixels, in.near, in.low_pass, e, batch);
    else
      meet<false>(s, pixels, in.near, in.low_pass, e, batch);
  }
  raise_alphas(batch.alpha[0], kBatch * kVectors);
  transmit_batch<kBatch, kVectors>(n, transmittances, batch.alpha, batch.T);
  return n;
}

// Depth relative to a sub-tile's first splat, in units of the depth range. Distortion needs only differences, which
// keep their precision in this form.
struct DepthUnit {
  float offset, scale;
  vfloat of(vfloat z) const { return (z - offset) * scale; }
};

inline DepthUnit depth_unit(const SurfelInputs& in, const SurfelState& state, const SubTileLists& sub, int s) {
  return {sub.count(s) > 0 ? state.records[sub.splat(*sub.begin(s))].depth() : 0.0f, 1.0f / (in.far - in.near)};
}

// The sums of blending at a vector of pixels.
struct Blend {
  vfloat color[3], normal[3], depth, median, m1, m2;
};

template <bool Distortion>
inline void blend_vector(const Batch& batch, int v, const DepthUnit& unit, Blend& sums) {
  // Separate copies, so that the loop keeps them in registers.
  vfloat depth = sums.depth, median = sums.median, m1 = {}, m2 = {};
  vfloat red = sums.color[0], green = sums.color[1], blue = sums.color[2];
  vfloat nx = sums.normal[0], ny = sums.normal[1], nz = sums.normal[2];
  for (int e = 0; e < kBatch; ++e) {
    const SurfelRecord& s = *batch.splat[e];
    const vfloat T = batch.T[e][v], w = batch.alpha[e][v] * T, z = batch.depth[e] * batch.r[e][v];
    red = fma(w, splat(s.color[0]), red), green = fma(w, splat(s.color[1]), green), blue = fma(w, splat(s.color[2]), blue);
    nx = fma(w, splat(s.normal[0]), nx), ny = fma(w, splat(s.normal[1]), ny), nz = fma(w, splat(s.normal[2]), nz);
    depth = fma(w, z, depth);
    median = select((T >= 0.5f) & (T - w < 0.5f), z, median);
    if (Distortion) {
      const vfloat m = unit.of(z), wm = w * m;
      m1 += wm, m2 = fma(wm, m, m2);
    }
  }
  sums.depth = depth, sums.median = median;
  sums.color[0] = red, sums.color[1] = green, sums.color[2] = blue;
  sums.normal[0] = nx, sums.normal[1] = ny, sums.normal[2] = nz;
  if (Distortion) sums.m1 += m1, sums.m2 += m2;
}

template <bool Distortion>
inline void blend_subtile(const SurfelInputs& in, const SurfelState& state, const SubTileLists& sub, int s, const Pixels& pixels,
                          vfloat transmittances[kVectors], Blend p[kVectors]) {
  const DepthUnit unit = depth_unit(in, state, sub, s);
  Batch batch;
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    composite_splats(in, state, sub, list + e, count - e, pixels, transmittances, batch);
    for (int v = 0; v < kVectors; ++v) blend_vector<Distortion>(batch, v, unit, p[v]);
    if (!any_open<kVectors>(transmittances)) break;
  }
}

template <bool Distortion>
void write_pixels(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, const vfloat transmittances[kVectors],
                  const Blend p[kVectors], int x0, int y0) {
  float f[11][16];
  for (int v = 0; v < kVectors; ++v) {
    store(f[0] + v * kWidth, abs(transmittances[v]));
    for (int k = 0; k < 3; ++k) store(f[1 + k] + v * kWidth, p[v].color[k]), store(f[4 + k] + v * kWidth, p[v].normal[k]);
    store(f[7] + v * kWidth, p[v].depth), store(f[8] + v * kWidth, p[v].median);
    if (Distortion) store(f[9] + v * kWidth, p[v].m1), store(f[10] + v * kWidth, p[v].m2);
  }
  for_pixels(x0, y0, in.width, in.height, [&](int64_t i, int j) {
    const float T = f[0][j], alpha = 1.0f - T;
    state.transmittance[i] = T, out.alpha[i] = alpha;
    for (int k = 0; k < 3; ++k) {
      out.color[3 * i + k] = f[1 + k][j] + T * in.background[k];
      out.normal[3 * i + k] = f[4 + k][j];
    }
    out.depth[i] = alpha > 0.5f * kMinAlpha ? f[7][j] / alpha : 0.0f;
    out.median_depth[i] = f[8][j];
    if (!Distortion) return;
    const float m1 = f[9][j], m2 = f[10][j];
    state.moments[2 * i] = m1, state.moments[2 * i + 1] = m2;
    out.distortion[i] = std::max(alpha * m2 - m1 * m1, 0.0f);
  });
}

template <bool Distortion>
void blend(const SurfelInputs& in, SurfelState& state, const SurfelImages& out) {
  for_tiles(state.lists, state.records.data(), [&](int, const SubTileLists& sub, int x0, int y0) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const Pixels pixels(x, y);
      Blend p[kVectors] = {};
      vfloat transmittances[kVectors];
      for (vfloat& transmittance : transmittances) transmittance = splat(1.0f);
      blend_subtile<Distortion>(in, state, sub, s, pixels, transmittances, p);
      write_pixels<Distortion>(in, state, out, transmittances, p, x, y);
    });
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
