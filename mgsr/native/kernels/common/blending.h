// Front-to-back blending (math/blending.h) of vectors of pixels, the same in every rasterizer.
#pragma once

#include "kernels/common/simd.h"
#include "math/blending.h"

namespace mgsr {

namespace MGSR_ISA {

// Transmittance at a vector of pixels so far, with a minus where a pixel has stopped. It starts at 1.
// (A plain vector and no class, so that compilers keep it in a register.)

// Passes a splat of this alpha. Returns what it blends with: 0 in pixels that have stopped or that stop here.
inline vfloat transmit(vfloat alpha, vfloat& transmittance) {
  const vfloat after = fma(-alpha, transmittance, transmittance);
  const vint passes = after >= kMinTransmittance;
  transmittance = select(passes, after, (vfloat)((vint)transmittance | INT32_MIN));
  return keep(passes, alpha);
}

// Passes the first n of Count splats through Chains vectors of pixels, which do not wait for one another. alpha: becomes
// what they blend with, 0 from n on; T: gets the transmittance before each splat, to be used only times an alpha.
template <int Count, int Chains>
inline void transmit_batch(int n, vfloat transmittances[Chains], vfloat alpha[Count][Chains], vfloat T[Count][Chains]) {
  for (int e = n; e < Count; ++e)
    for (int c = 0; c < Chains; ++c) alpha[e][c] = vfloat{};
  // Unrolled by order: a compiler that sees the copies as loops makes them a memcpy and leaves the transmittance in memory.
  vfloat transmittance[Chains];
#pragma GCC unroll 16
  for (int c = 0; c < Chains; ++c) transmittance[c] = transmittances[c];
  for (int e = 0; e < Count; ++e)
#pragma GCC unroll 16
    for (int c = 0; c < Chains; ++c) T[e][c] = transmittance[c], alpha[e][c] = transmit(alpha[e][c], transmittance[c]);
#pragma GCC unroll 16
  for (int c = 0; c < Chains; ++c) transmittances[c] = transmittance[c];
}

template <int Chains>
inline bool any_open(const vfloat transmittances[Chains]) {
  vint open = {};
  for (int c = 0; c < Chains; ++c) open |= transmittances[c] > 0.0f;
  return any(open);
}

}  // namespace MGSR_ISA
}  // namespace mgsr
