// The footprint of a projected Gaussian in the form that blending uses: at the offset d in pixels from the centre, its
// weight is 2^-|root d|^2.
#pragma once

#include "math/gaussian.h"

namespace mgsr {

constexpr double kLog2E = 1.4426950408889634;

// root: [3] of the inverse covariance, xx, xy, yy of an upper triangle. Returns the covariance's determinant; unless it
// is positive, the root means nothing.
template <class T>
MGSR_HD T footprint_root(const ProjectedGaussian<T>& g, T root[3]) {
  const double scale = 0.84932180028801907;  // sqrt(log2(e) / 2)
  const T det = g.cxx * g.cyy - g.cxy * g.cxy, inverse = scale / MGSR_SQRT(det * g.cyy);
  root[0] = inverse * g.cyy, root[1] = -inverse * g.cxy, root[2] = scale / MGSR_SQRT(g.cyy);
  return det;
}

// Whether the footprint, by its root, is over 30 times as long as wide. The products in its gradient would then lose
// the contribution of the longer axis in float32.
template <class T>
MGSR_HD bool is_needle(const T root[3]) {
  const T trace = root[0] * root[0] + root[1] * root[1] + root[2] * root[2], product = root[0] * root[2];
  return trace * trace > T(1e3) * product * product;
}

// Returns the gradients of the projection, apart from its compensation. Given are the moments of the exponent's
// gradient over the pixels' offsets from the centre, and v_depth, which is passed on.
template <class T>
MGSR_HD ProjectedGaussian<T> footprint_vjp(const T root[3], T dx, T dy, T dxx, T dxy, T dyy, T v_depth) {
  // exponent (natural) = -0.5 (qxx dx^2 + 2 qxy dx dy + qyy dy^2) in terms of the inverse covariance Q.
  const T scale = float(2.0 / kLog2E);
  const T qxx = scale * root[0] * root[0], qxy = scale * root[0] * root[1];
  const T qyy = scale * (root[1] * root[1] + root[2] * root[2]);
  ProjectedGaussian<T> g = {};
  g.x = qxx * dx + qxy * dy;
  g.y = qxy * dx + qyy * dy;
  g.depth = v_depth;
  // v_covariance = -Q v_Q Q, with v_Q = -0.5 * moments.
  const T mxx = 0.5f * dxx, mxy = 0.5f * dxy, myy = 0.5f * dyy;
  const T axx = qxx * mxx + qxy * mxy, axy = qxx * mxy + qxy * myy;
  const T ayx = qxy * mxx + qyy * mxy, ayy = qxy * mxy + qyy * myy;
  g.cxx = axx * qxx + axy * qxy;
  g.cyy = ayx * qxy + ayy * qyy;
  g.cxy = (axx * qxy + axy * qyy) + (ayx * qxx + ayy * qxy);
  return g;
}

}  // namespace mgsr
