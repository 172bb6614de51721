// A channel of a pixel under a flash, in sRGB = (1 + offset) light^(1/2.4) - offset.
#pragma once

#include "math/macros.h"

namespace mgsr {

// Returns the channel of an object that `shading`, the flash's light to the power 1/2.4, falls on. unlit: the channel
// under even light, with the background. The background is not lit.
MGSR_HD float lit(float unlit, float alpha, float background, float shading, float offset) {
  const float own = unlit + alpha * (background + offset) - background;
  return unlit + (shading - 1.0f) * own;
}

// Returns the derivative of `lit` with respect to alpha, divided by shading - 1; that with respect to unlit is shading.
MGSR_HD float lit_by_alpha(float background, float offset) { return background + offset; }

}  // namespace mgsr
