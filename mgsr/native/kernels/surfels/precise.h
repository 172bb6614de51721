// The projection of a splat and its derivative, the same on the CPU and the GPU. They work in float64 for needles,
// because float32 loses the image of an axis that is nearly parallel to the line of sight.
#pragma once

#include "kernels/surfels/record.h"

namespace mgsr {

template <class T>
struct SurfelParameters {
  T mean[3], quat[4], scale[2];

  MGSR_MEMBER SurfelParameters(const float* m, const float* q, const float* s)
      : mean{m[0], m[1], m[2]}, quat{q[0], q[1], q[2], q[3]}, scale{s[0], s[1]} {}
};

// Returns the projection of a needle, and writes edge_on as in SurfelFrame.
MGSR_HD ProjectedSurfel<float> project_needle(const Camera<float>& camera, const float* mean, const float* quat,
                                              const float* scale, bool& edge_on) {
  const SurfelParameters<double> splat(mean, quat, scale);
  const Camera<double> cam = camera_as<double>(camera);
  SurfelFrame<double> f;
  surfel_frame(cam, splat.mean, splat.quat, splat.scale, f);
  edge_on = f.edge_on;
  const ProjectedSurfel<double> s = project_surfel(cam, f);
  ProjectedSurfel<float> rounded = {float(s.x), float(s.y), float(s.depth), {}, {float(s.g[0]), float(s.g[1])}, {}};
  for (int k = 0; k < 4; ++k) rounded.L[k] = float(s.L[k]);
  for (int k = 0; k < 3; ++k) rounded.normal[k] = float(s.normal[k]);
  return rounded;
}

// The gradients of a splat's geometry. center: the gradient of its projected centre in pixels.
struct SurfelGeometryGradients {
  float mean[3], quat[4], scale[2], center[2];
};

// Returns the gradients of a splat's geometry, given the sums over its pairs.
template <class T>
MGSR_HD SurfelGeometryGradients surfel_geometry_gradients(const Camera<T>& cam, const float* mean, const float* quat,
                                                          const float* scale, const SurfelRecord& s, const float* total) {
  const SurfelParameters<T> splat(mean, quat, scale);
  SurfelFrame<T> f;
  surfel_frame(cam, splat.mean, splat.quat, splat.scale, f);
  T slope[2], v_mean[3] = {}, v_quat[4] = {}, v_scale[2] = {};
  surfel_slope(f, splat.scale, slope);
  const SurfelPull<T> g = surfel_gradients(s, slope, total);
  pull_surfel_back(cam, splat.quat, splat.scale, f, g, v_mean, v_quat, v_scale);
  return {{float(v_mean[0]), float(v_mean[1]), float(v_mean[2])},
          {float(v_quat[0]), float(v_quat[1]), float(v_quat[2]), float(v_quat[3])},
          {float(v_scale[0]), float(v_scale[1])},
          {float(g.x), float(g.y)}};
}

}  // namespace mgsr
