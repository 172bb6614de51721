// The way back through a needle's projection, the same on both machines.
#pragma once

#include "kernels/gaussians/record.h"
#include "math/footprint.h"

namespace mgsr {

// From the sums over a splat's pairs to the gradients of its geometry (added to v_mean[3], v_quat[4], v_scale[3]) and of its
// projection, which are returned. In float64, and from the parameters anew: the record's root has float's digits alone.
MGSR_HD ProjectedGaussian<double> needle_gradients(const Camera<double>& cam, const double mean[3], const double quat[4],
                                                   const double scale[3], double low_pass, const float* total,
                                                   double v_compensation, double v_mean[3], double v_quat[4],
                                                   double v_scale[3]) {
  double root[3];
  footprint_root(project_gaussian(cam, mean, quat, scale, low_pass), root);
  auto g = footprint_vjp<double>(root, total[kDx], total[kDy], total[kDxx], total[kDxy], total[kDyy], total[kDepth]);
  g.compensation = v_compensation;
  project_gaussian_vjp(cam, mean, quat, scale, low_pass, g, v_mean, v_quat, v_scale);
  return g;
}

}  // namespace mgsr
