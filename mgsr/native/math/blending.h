// Front-to-back blending of one splat at one pixel. A splat counts at a pixel if its alpha is at least kMinAlpha. A
// pixel is finished before the first splat that would reduce its transmittance below kMinTransmittance.
#pragma once

#include "math/macros.h"

namespace mgsr {

constexpr float kMinTransmittance = 1e-4f;
constexpr float kMinAlpha = 1.0f / 255.0f;
constexpr float kLog2MinAlpha = -7.9943534f;
constexpr float kMaxAlpha = 0.999f;

// Returns the alpha of a splat, 0 if it does not count. raw: opacity times weight.
MGSR_HD float counted_alpha(float raw) {
  const float held = raw < kMaxAlpha ? raw : kMaxAlpha;
  return raw >= kMinAlpha ? held : 0.0f;
}

// Composites a splat of this alpha, and updates the transmittance, which is negative once the pixel is finished.
// Returns the alpha with which the splat blends: 0 if the pixel is finished, or is finished by this splat. The single
// fused operation leaves the compiler no choice of rounding, so the backward pass reproduces the bits of the forward
// pass.
MGSR_HD float transmit(float alpha, float& transmittance) {
  const float after = fma(-alpha, transmittance, transmittance);
  if (after >= kMinTransmittance) {
    transmittance = after;
    return alpha;
  }
  transmittance = transmittance > 0.0f ? -transmittance : transmittance;
  return 0.0f;
}

// The adjoint of one splat that blends with `alpha`. T: the transmittance before it. gain: the derivative of the loss
// with respect to the splat's share alpha T. behind: the sum of share times gain over this splat and all behind it; on
// return, only over those behind it. Returns the share, and the gradient of the exponent of the splat's weight, which
// equals its opacity times the gradient of the opacity.
struct BlendStep {
  float share, v_exponent;
};
MGSR_HD BlendStep blend_vjp(float alpha, float T, float gain, float& behind) {
  const float share = alpha * T;
  behind = fma(-share, gain, behind);
  const float v_alpha = fma(T, gain, quick_quotient(-behind, 1.0f - alpha));
  return {share, alpha < kMaxAlpha ? v_alpha * alpha : 0.0f};
}

}  // namespace mgsr
