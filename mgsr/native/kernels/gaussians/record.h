// A splat of the 3D branch on the image, and what the walk back through the blending finds for it.
#pragma once

#include "kernels/common/integers.h"

namespace mgsr {

// One splat as the blending loops read it: one cache line. Its weight at d pixels from the centre is 2^-|root d|^2.
// A centre far from the image's origin is coarse in float; its whole and its fractional part are not.
struct alignas(64) GaussianRecord {
  int16_t x, y;          // centre, pixels: the whole part
  float x_rest, y_rest;  // and the rest
  float root[3];         // of the inverse covariance: xx, xy, yy of an upper triangle
  float opacity, depth;
  float color[3];
  float refl_opacity, weight, refl_color[3];
};

// Gradient of one (splat, tile) pair. The moments are of the exponent's gradient over the pixels' offsets from the
// centre; kOpacity and kReflOpacity are times the opacity.
enum GaussianPairField { kDx, kDy, kDxx, kDxy, kDyy, kOpacity, kColor, kDepth = kColor + 3, kReflOpacity, kWeight, kReflColor };

}  // namespace mgsr
