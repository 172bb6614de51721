// A projected splat of the 3D branch, and the gradient of a (splat, tile) pair.
#pragma once

#include "kernels/common/integers.h"

namespace mgsr {

// A splat in the form that the blending loops read: one cache line. Its weight at d pixels from the centre is
// 2^-|root d|^2. The centre is split into its whole and its fractional part, because one float would be too coarse far
// from the image's origin.
struct alignas(64) GaussianRecord {
  int16_t x, y;          // centre, pixels: the whole part
  float x_rest, y_rest;  // the fractional part
  float root[3];         // of the inverse covariance: xx, xy, yy of an upper triangle
  float opacity, depth;
  float color[3];
  float refl_opacity, weight, refl_color[3];
};

// The gradient of a (splat, tile) pair. The moments are those of the exponent's gradient over the pixels' offsets from
// the centre. kOpacity and kReflOpacity are multiplied by the opacity.
enum GaussianPairField { kDx, kDy, kDxx, kDxy, kDyy, kOpacity, kColor, kDepth = kColor + 3, kReflOpacity, kWeight, kReflColor };

}  // namespace mgsr
