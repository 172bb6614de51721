// Front-to-back blending, the same in every rasterizer: a splat counts for a pixel where its alpha is at least kMinAlpha;
// a pixel stops before the first splat that would leave it less than kMinTransmittance.
#pragma once

#include "kernels/common/simd.h"

namespace mgsr {

constexpr float kMinTransmittance = 1e-4f;
constexpr float kMinAlpha = 1.0f / 255.0f;
constexpr float kLog2MinAlpha = -7.9943534f;
constexpr float kMaxAlpha = 0.999f;

namespace MGSR_ISA {

// What is left of the light at a vector of pixels, and which of them still blend.
struct Light {
  vfloat T = splat(1.0f);
  vint open = vint{} - 1;

  // What a splat of this alpha blends with: 0 in pixels that have stopped or that stop here. T is that before the splat;
  // call pass() with the result then.
  vfloat admit(vfloat alpha) {
    open &= fma(-alpha, T, T) >= kMinTransmittance;
    return keep(open, alpha);
  }
  void pass(vfloat admitted) { T = fma(-admitted, T, T); }
};

}  // namespace MGSR_ISA
}  // namespace mgsr
