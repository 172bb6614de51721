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

// The outline of a splat in the form that cutting it into bands of rows needs: no division, two square roots a band.
template <class T>
struct EllipseForm {
  T x, y;
  T hx, hy;    // half extents
  T at_right;  // dy of the rightmost point
  T slope;     // the middle of the row at dy lies at x + slope dy ...
  T w2, k;     // ... and its half width is sqrt(w2 - k dy^2)

  // With the centre at (x, y) and covariance (cxx, cxy, cyy), sqrt(r2) standard deviations out.
  static EllipseForm make(T x, T y, T cxx, T cxy, T cyy, T r2) {
    using std::sqrt;
    const T det = cxx * cyy - cxy * cxy, slope = cxy / cyy, k = det / (cyy * cyy), hx = sqrt(r2 * cxx);
    return {x, y, hx, sqrt(r2 * cyy), cxy / cxx * hx, slope, r2 * k * cyy, k};
  }
};

// Taken a hair wider than exact, so that rounding never loses a pixel that the blending would keep.
struct Ellipse : EllipseForm<float> {
  PixelBox box() const { return {x - hx - kSlack, x + hx + kSlack, y - hy - kSlack, y + hy + kSlack}; }

  Intervals cut(vfloat y0, vfloat y1) const {
    const vfloat low = max(y0 - (y + kSlack), splat(-hy - kSlack)), high = min(y1 - (y - kSlack), splat(hy + kSlack));
    const vfloat right = min(max(splat(at_right), low), high), left = min(max(splat(-at_right), low), high);
    const vfloat to_right = sqrt(max(w2 - k * right * right, vfloat{})), to_left = sqrt(max(w2 - k * left * left, vfloat{}));
    return {x + slope * left - to_left - kSlack, x + slope * right + to_right + kSlack, low <= high};
  }

 private:
  static constexpr float kSlack = 2e-3f;
};

}  // namespace MGSR_ISA
}  // namespace mgsr
