// Front-to-back blending (math/blending.h) of vectors of pixels, which all rasterizers share.
#pragma once

#include "kernels/common/simd.h"
#include "math/blending.h"

namespace mgsr {

namespace MGSR_ISA {

// Composites a splat of this alpha, and updates the transmittance, which starts at 1 and is negative once a pixel is
// finished. Returns the alpha with which the splat blends, 0 in finished pixels. The transmittance is a plain vector,
// not a class, so that compilers keep it in a register.
inline vfloat transmit(vfloat alpha, vfloat& transmittance) {
  const vfloat after = fma(-alpha, transmittance, transmittance);
  const vint passes = after >= kMinTransmittance;
  transmittance = select(passes, after, (vfloat)((vint)transmittance | INT32_MIN));
  return keep(passes, alpha);
}

// Composites the first n of Count splats in Chains independent vectors of pixels. alpha: becomes the alphas with which
// they blend, 0 from n on. T: gets the transmittance before each splat; it is valid only where the alpha is not 0.
template <int Count, int Chains>
inline void transmit_batch(int n, vfloat transmittances[Chains], vfloat alpha[Count][Chains], vfloat T[Count][Chains]) {
  for (int e = n; e < Count; ++e)
    for (int c = 0; c < Chains; ++c) alpha[e][c] = vfloat{};
  // The loops are unrolled explicitly, since compilers turn copy loops into memcpy and leave the transmittance in
  // memory.
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
