// Surface normal at a pixel from the depths of its four neighbours.
//
// With r the pixel's ray (rx, ry, 1), the neighbours back-project to points whose central differences are
//   dx = (R - L) r + (R + L) / fx e_x,   dy = (D - U) r + (D + U) / fy e_y,
// so that -(dx x dy), divided by the positive (R + L)(D + U) / (fx fy), is
//   m = (gx, gy, -(1 + rx gx + ry gy)),  gx = fx (R - L) / (R + L),  gy = fy (D - U) / (D + U).
// Since m . r = -1, m always faces the camera and is never short.
#pragma once

#include "math/macros.h"

namespace mgsr {

template <class T>
struct DepthNeighbours {
  T left, right, up, down;
};

// The focal lengths of the camera, and the ray (rx, ry, 1) of the pixel.
template <class T>
struct PixelRay {
  T fx, fy, rx, ry;
};

// Writes the normal n [3], unit, in camera axes. All four depths must be positive. Returns |m|.
template <class T>
MGSR_HD T depth_normal(const DepthNeighbours<T>& d, const PixelRay<T>& ray, T n[3]) {
  const T gx = ray.fx * (d.right - d.left) / (d.right + d.left);
  const T gy = ray.fy * (d.down - d.up) / (d.down + d.up);
  const T z = T(-1) - ray.rx * gx - ray.ry * gy;
  const T length = MGSR_SQRT(gx * gx + gy * gy + z * z);
  n[0] = gx / length, n[1] = gy / length, n[2] = z / length;
  return length;
}

// Returns the gradients of the four depths, given v_n.
template <class T>
MGSR_HD DepthNeighbours<T> depth_normal_vjp(const DepthNeighbours<T>& d, const PixelRay<T>& ray, const T v_n[3]) {
  T n[3];
  const T length = depth_normal(d, ray, n);
  const T along = n[0] * v_n[0] + n[1] * v_n[1] + n[2] * v_n[2];
  const T v_z = v_n[2] - along * n[2];
  const T v_gx = (v_n[0] - along * n[0] - ray.rx * v_z) / length;
  const T v_gy = (v_n[1] - along * n[1] - ray.ry * v_z) / length;
  const T across = d.right + d.left, upright = d.down + d.up;
  const T sx = 2 * v_gx * ray.fx / (across * across), sy = 2 * v_gy * ray.fy / (upright * upright);
  return {-sx * d.right, sx * d.left, -sy * d.down, sy * d.up};
}

}  // namespace mgsr
