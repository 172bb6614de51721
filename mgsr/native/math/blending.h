// Front-to-back blending of one splat at one pixel. A splat counts for a pixel where its alpha is at least kMinAlpha; a
// pixel stops before the first splat that would leave it less than kMinTransmittance.
#pragma once

#include "math/macros.h"

namespace mgsr {

constexpr float kMinTransmittance = 1e-4f;
constexpr float kMinAlpha = 1.0f / 255.0f;
constexpr float kLog2MinAlpha = -7.9943534f;
constexpr float kMaxAlpha = 0.999f;

// raw: opacity times weight. The result is 0 where the splat does not count.
MGSR_HD float counted_alpha(float raw) {
  const float held = raw < kMaxAlpha ? raw : kMaxAlpha;
  return raw >= kMinAlpha ? held : 0.0f;
}

// Passes a splat of this alpha; transmittance: so far, with a minus where the pixel has stopped. Returns what
// the splat blends with: 0 in a pixel that has stopped or that stops here. The one fused operation leaves a compiler no
// choice of rounding, so that the backward pass finds the forward pass's bits again.
MGSR_HD float transmit(float alpha, float& transmittance) {
  const float after = fma(-alpha, transmittance, transmittance);
  if (after >= kMinTransmittance) {
    transmittance = after;
    return alpha;
  }
  transmittance = transmittance > 0.0f ? -transmittance : transmittance;
  return 0.0f;
}

// The way back through one splat that blends with `alpha`, before which the transmittance was T, and of which a share
// alpha T adds `gain` each to the loss. behind: what the splats from this one on add up to, and then those behind it.
// Returns the gradient of the exponent of the splat's weight, which is also that of its opacity times the opacity.
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
