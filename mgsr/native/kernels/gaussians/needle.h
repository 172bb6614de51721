// The derivative of the projection of needles (see is_needle), the same on the CPU and the GPU.
#pragma once

#include "kernels/gaussians/record.h"
#include "math/footprint.h"

namespace mgsr {

// Adds the gradients of a splat's geometry to v_mean[3], v_quat[4] and v_scale[3], given the sums over its pairs.
// Returns the gradients of its projection. It works in float64 and projects again, because the record's root is only a
// float.
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
