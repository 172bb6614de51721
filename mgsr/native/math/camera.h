// The pinhole camera: OpenCV axes, pixel centres at +0.5, no skew.
#pragma once

#include "math/macros.h"

namespace mgsr {

template <class T>
struct Camera {
  T R[9];  // world to camera, row-major
  T t[3];
  T fx, fy, cx, cy;
  T width, height;  // pixels
};

template <class T, class S>
MGSR_HD Camera<T> camera_as(const Camera<S>& cam) {
  Camera<T> c;
  for (int i = 0; i < 9; ++i) c.R[i] = T(cam.R[i]);
  for (int i = 0; i < 3; ++i) c.t[i] = T(cam.t[i]);
  c.fx = T(cam.fx), c.fy = T(cam.fy), c.cx = T(cam.cx), c.cy = T(cam.cy);
  c.width = T(cam.width), c.height = T(cam.height);
  return c;
}

// p = R x + t
template <class T>
MGSR_HD void to_camera(const Camera<T>& cam, const T x[3], T p[3]) {
  for (int i = 0; i < 3; ++i) p[i] = cam.R[3 * i] * x[0] + cam.R[3 * i + 1] * x[1] + cam.R[3 * i + 2] * x[2] + cam.t[i];
}

// v_x += R^T v_p
template <class T>
MGSR_HD void to_camera_vjp(const Camera<T>& cam, const T v_p[3], T v_x[3]) {
  for (int i = 0; i < 3; ++i) v_x[i] += cam.R[i] * v_p[0] + cam.R[3 + i] * v_p[1] + cam.R[6 + i] * v_p[2];
}

}  // namespace mgsr
