// Front-to-back blending (math/blending.h) of vectors of pixels, the same in every rasterizer.
#pragma once

#include "kernels/common/simd.h"
#include "math/blending.h"

namespace mgsr {

namespace MGSR_ISA {

// Light at a vector of pixels: the transmittance so far, with a minus where a pixel has stopped. It starts at 1.
// (A plain vector and no class, so that compilers keep it in a register.)

// Passes a splat of this alpha. Returns what it blends with: 0 in pixels that have stopped or that stop here.
inline vfloat pass(vfloat alpha, vfloat& light) {
  const vfloat after = fma(-alpha, light, light);
  const vint passes = after >= kMinTransmittance;
  light = select(passes, after, (vfloat)((vint)light | INT32_MIN));
  return keep(passes, alpha);
}

// Passes the first n of Count splats through Chains vectors of pixels, which do not wait for one another. alpha: becomes
// what they blend with, 0 from n on; T: gets the light before each splat, to be used only times an alpha.
template <int Count, int Chains>
inline void pass_batch(int n, vfloat lights[Chains], vfloat alpha[Count][Chains], vfloat T[Count][Chains]) {
  for (int e = n; e < Count; ++e)
    for (int c = 0; c < Chains; ++c) alpha[e][c] = vfloat{};
  // Unrolled by order: a compiler that sees the copies as loops makes them a memcpy and leaves the light in memory.
  vfloat light[Chains];
#pragma GCC unroll 16
  for (int c = 0; c < Chains; ++c) light[c] = lights[c];
  for (int e = 0; e < Count; ++e)
#pragma GCC unroll 16
    for (int c = 0; c < Chains; ++c) T[e][c] = light[c], alpha[e][c] = pass(alpha[e][c], light[c]);
#pragma GCC unroll 16
  for (int c = 0; c < Chains; ++c) lights[c] = light[c];
}

template <int Chains>
inline bool any_open(const vfloat lights[Chains]) {
  vint open = {};
  for (int c = 0; c < Chains; ++c) open |= lights[c] > 0.0f;
  return any(open);
}

}  // namespace MGSR_ISA
}  // namespace mgsr
