// The outlines of splats on the image, cut into bands of rows.
#pragma once

#include <cmath>

#include "kernels/common/simd.h"
#include "math/ellipse.h"

namespace mgsr {
namespace MGSR_ISA {

// A box on the image in continuous coordinates; empty if x1 < x0 or y1 < y0.
struct PixelBox {
  float x0, x1, y0, y1;
};

// For each lane's band of rows [y0, y1]: the smallest x interval that contains all points of an outline in the band.
struct Intervals {
  vfloat x0, x1;
  vint any;  // 0 where the band has no points
};

// ellipse_columns for a vector of bands at once.
struct Ellipse : EllipseForm<float> {
  PixelBox box() const { return {x - hx - kOutlineSlack, x + hx + kOutlineSlack, y - hy - kOutlineSlack, y + hy + kOutlineSlack}; }

  Intervals cut(vfloat y0, vfloat y1) const {
    const vfloat low = max(y0 - (y + kOutlineSlack), splat(-hy - kOutlineSlack)), high = min(y1 - (y - kOutlineSlack), splat(hy + kOutlineSlack));
    const vfloat right = min(max(splat(at_right), low), high), left = min(max(splat(-at_right), low), high);
    const vfloat to_right = sqrt(max(w2 - k * right * right, vfloat{})), to_left = sqrt(max(w2 - k * left * left, vfloat{}));
    return {x + slope * left - to_left - kOutlineSlack, x + slope * right + to_right + kOutlineSlack, low <= high};
  }
};

}  // namespace MGSR_ISA
}  // namespace mgsr
