// Outlines of splats on the image, and cutting them into bands of rows.
#pragma once

#include <cmath>

#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {

// A range of pixels on the image, continuous coordinates; empty when x1 < x0 or y1 < y0.
struct PixelBox {
  float x0, x1, y0, y1;
};

// For each lane's band of rows [y0, y1]: the smallest x interval that holds all of an outline's points in the band.
struct Intervals {
  vfloat x0, x1;
  vint any;  // 0 where there are none
};

// The outline of a splat with its centre at (x, y) and covariance (cxx, cxy, cyy), sqrt(r2) standard deviations out, in
// the form that cutting it into bands of rows needs: no division, two square roots a band.
struct Ellipse {
  float x, y;
  float hx, hy;    // half extents
  float at_right;  // dy of the rightmost point
  float slope;     // the middle of the row at dy lies at x + slope dy ...
  float w2, k;     // ... and its half width is sqrt(w2 - k dy^2)

  // A hair wider than exact, so that rounding never loses a pixel that the blending would keep.
  static Ellipse make(float x, float y, float cxx, float cxy, float cyy, float r2) {
    const float det = cxx * cyy - cxy * cxy, hx = std::sqrt(r2 * cxx), hy = std::sqrt(r2 * cyy);
    return {x, y, hx + kSlack, hy + kSlack, cxy / cxx * hx, cxy / cyy, r2 * det / cyy, det / (cyy * cyy)};
  }

  PixelBox box() const { return {x - hx, x + hx, y - hy, y + hy}; }

  Intervals cut(vfloat y0, vfloat y1) const {
    const vfloat low = max(y0 - (y + kSlack), splat(-hy)), high = min(y1 - (y - kSlack), splat(hy));
    const vfloat right = min(max(splat(at_right), low), high), left = min(max(splat(-at_right), low), high);
    const vfloat to_right = sqrt(max(w2 - k * right * right, vfloat{})), to_left = sqrt(max(w2 - k * left * left, vfloat{}));
    return {x + slope * left - to_left - kSlack, x + slope * right + to_right + kSlack, low <= high};
  }

 private:
  static constexpr float kSlack = 2e-3f;
};

}  // namespace MGSR_ISA
}  // namespace mgsr
