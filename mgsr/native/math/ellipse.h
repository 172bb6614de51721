// The outline of a splat on the image: an ellipse, cut into bands of rows.
#pragma once

#include "math/macros.h"

namespace mgsr {

// Pixels. Bounds are this much wider than exact, so that rounding never loses a pixel that blending would keep.
constexpr float kOutlineSlack = 2e-3f;

// An ellipse in a form that is cheap to cut into bands: two square roots and no division per band.
template <class T>
struct EllipseForm {
  T x, y;
  T hx, hy;    // half extents
  T at_right;  // dy of the rightmost point
  T slope;     // the middle of the row at dy lies at x + slope dy ...
  T w2, k;     // ... and its half width is sqrt(w2 - k dy^2)
};

// The ellipse at sqrt(r2) standard deviations from the centre (x, y), with covariance (cxx, cxy, cyy).
template <class T>
MGSR_HD EllipseForm<T> make_ellipse(T x, T y, T cxx, T cxy, T cyy, T r2) {
  const T det = cxx * cyy - cxy * cxy, slope = cxy / cyy, k = det / (cyy * cyy), hx = MGSR_SQRT(r2 * cxx);
  return {x, y, hx, MGSR_SQRT(r2 * cyy), cxy / cxx * hx, slope, r2 * k * cyy, k};
}

MGSR_HD float held_between(float x, float low, float high) { return x < low ? low : x > high ? high : x; }

// A range of columns in continuous coordinates; empty if x1 < x0.
struct Columns {
  float x0, x1;
};

// Returns the smallest range that contains all points of the ellipse in the rows [y0, y1].
MGSR_HD Columns ellipse_columns(const EllipseForm<float>& e, float y0, float y1) {
  const float top = y0 - (e.y + kOutlineSlack), bottom = y1 - (e.y - kOutlineSlack);
  const float reach = e.hy + kOutlineSlack, low = top > -reach ? top : -reach, high = bottom < reach ? bottom : reach;
  if (!(low <= high)) return {1.0f, 0.0f};
  const float right = held_between(e.at_right, low, high), left = held_between(-e.at_right, low, high);
  const float to_right2 = e.w2 - e.k * right * right, to_left2 = e.w2 - e.k * left * left;
  const float to_right = to_right2 > 0.0f ? quick_sqrt(to_right2) : 0.0f;
  const float to_left = to_left2 > 0.0f ? quick_sqrt(to_left2) : 0.0f;
  return {e.x + e.slope * left - to_left - kOutlineSlack, e.x + e.slope * right + to_right + kOutlineSlack};
}

}  // namespace mgsr
