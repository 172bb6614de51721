// The difference of two silhouettes at a pixel, with its derivative, and a photograph on a colour.
#pragma once

#include "math/macros.h"

namespace mgsr {

constexpr float kLeastAlpha = 1e-4f;  // the least alpha and 1 - alpha in a cross entropy

// Returns |alpha - mask|, and writes the derivative with respect to alpha.
MGSR_HD float silhouette_gap(float alpha, float mask, float& slope) {
  const float difference = alpha - mask;
  slope = float(difference > 0.0f) - float(difference < 0.0f);
  return difference * slope;
}

// Returns the cross entropy of alpha, limited to kLeastAlpha from 0 and 1, and a mask, and writes the derivative with
// respect to alpha.
MGSR_HD double silhouette_entropy(float alpha, float mask, float& slope) {
  const float most = 1.0f - kLeastAlpha, inside = alpha < kLeastAlpha ? kLeastAlpha : alpha > most ? most : alpha;
  slope = inside == alpha ? (inside - mask) / (inside * (1.0f - inside)) : 0.0f;
  return -(double(mask) * log(double(inside)) + (1.0 - double(mask)) * log(1.0 - double(inside)));
}

// Returns a channel of a photograph, a byte, on a background.
MGSR_HD float composited(unsigned char channel, float background, float alpha) {
  return background + (float(channel) / 255.0f - background) * alpha;
}

}  // namespace mgsr
