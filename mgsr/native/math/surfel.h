// Projection of a 2D surfel (2DGS, Eq. 4-10): the intersection of a pixel's ray with the splat's plane, in closed form.
//
// With H = [s_u t_u, s_v t_v, p] in the camera's frame, a point (u, v) of the splat has homogeneous pixel coordinates
// M (u, v, 1)^T, M = K H. The two planes through a pixel's column and row, h_u = x M_3 - M_1 and h_v = y M_3 - M_2,
// meet in h_u x h_v = adj(M) (x, y, 1)^T, which is linear in the pixel. Relative to the projected centre m, and divided
// by det(M) / depth, it needs six numbers: with d = (x, y) - m and w = 1 + g . d
//   (u, v) = L d / w,   depth at the hit = depth of the centre / w,
// where L and g are the first two columns of depth * M^-1. This form has no quotient of large, nearly equal products.
#pragma once

#include "math/camera.h"
#include "math/quat.h"

namespace mgsr {

// If |sine| of the angle between viewing ray and plane is less than this, only the low-pass of a splat is drawn.
constexpr float kEdgeOnSine = 1e-3f;
// The least length of an axis. Such a disk is invisible anyway, and its inverse stays finite.
constexpr float kShortest = 1e-18f;

template <class T>
struct ProjectedSurfel {
  T x, y, depth;  // the centre: pixels, camera z
  T L[4];         // row-major [2,2], 1/pixel
  T g[2];         // 1/pixel
  T normal[3];    // world frame, towards the camera
};

// Intermediate values that the projection, the outline and the derivative share.
template <class T>
struct SurfelFrame {
  T p[3];                  // centre in the camera
  T R[9];                  // of the quaternion
  T tu[3], tv[3], n[3];    // the splat's axes in the camera
  T plane;                 // p . n: signed distance of the camera from the plane
  T facing;                // -1 if n points away from the camera, else 1
  bool edge_on;
  T G[9];                  // H^-1, row-major; zero when edge-on
};

template <class T>
MGSR_HD T at_least(T x, T low) {
  return x < low ? low : x;
}

template <class T>
MGSR_HD void rotate_column(const Camera<T>& cam, const T R[9], int column, T out[3]) {
  for (int i = 0; i < 3; ++i)
    out[i] = cam.R[3 * i] * R[column] + cam.R[3 * i + 1] * R[3 + column] + cam.R[3 * i + 2] * R[6 + column];
}

template <class T>
MGSR_HD void scaled_cross(const T a[3], const T b[3], T scale, T out[3]) {
  out[0] = scale * (a[1] * b[2] - a[2] * b[1]);
  out[1] = scale * (a[2] * b[0] - a[0] * b[2]);
  out[2] = scale * (a[0] * b[1] - a[1] * b[0]);
}

// Computes the frame. This is cheap enough to repeat instead of storing the result.
template <class T>
MGSR_HD void surfel_frame(const Camera<T>& cam, const T mean[3], const T quat[4], const T scale[2], SurfelFrame<T>& f) {
  to_camera(cam, mean, f.p);
  quat_to_rotation(quat, f.R);
  rotate_column(cam, f.R, 0, f.tu);
  rotate_column(cam, f.R, 1, f.tv);
  rotate_column(cam, f.R, 2, f.n);
  f.plane = f.p[0] * f.n[0] + f.p[1] * f.n[1] + f.p[2] * f.n[2];
  f.facing = f.plane > T(0) ? T(-1) : T(1);
  const T distance2 = f.p[0] * f.p[0] + f.p[1] * f.p[1] + f.p[2] * f.p[2];
  f.edge_on = f.plane * f.plane < T(kEdgeOnSine * kEdgeOnSine) * distance2;
  const T inverse = f.edge_on ? T(0) : T(1) / f.plane;
  scaled_cross(f.tv, f.p, inverse / at_least(scale[0], T(kShortest)), f.G);
  scaled_cross(f.p, f.tu, inverse / at_least(scale[1], T(kShortest)), f.G + 3);
  for (int i = 0; i < 3; ++i) f.G[6 + i] = inverse * f.n[i];
}

// Projects a splat. An edge-on splat gets L = 0 and g = 0, and only its low-pass must be drawn.
template <class T>
MGSR_HD ProjectedSurfel<T> project_surfel(const Camera<T>& cam, const SurfelFrame<T>& f) {
  ProjectedSurfel<T> s;
  const T focal[2] = {cam.fx, cam.fy};
  s.depth = f.p[2];
  s.x = cam.fx * f.p[0] / f.p[2] + cam.cx;
  s.y = cam.fy * f.p[1] / f.p[2] + cam.cy;
  for (int j = 0; j < 2; ++j) {
    const T k = f.p[2] / focal[j];
    s.L[j] = k * f.G[j], s.L[2 + j] = k * f.G[3 + j], s.g[j] = k * f.G[6 + j];
  }
  for (int i = 0; i < 3; ++i) s.normal[i] = f.facing * f.R[3 * i + 2];
  return s;
}

// Gradients of a projected surfel. W [3,3] is v_A A^T with A = [L; g]; the parameters need the gradients of L and g
// only in this form. Each pixel adds to W by its (u, v) = L d. This keeps precision for splats seen from the side, for
// which L is large but (u, v) is not.
template <class T>
struct SurfelPull {
  T x, y, depth;
  T W[9];
  T normal[3];
};

// Writes the slope with w = 1 + slope . L d. The splat must not be edge-on.
template <class T>
MGSR_HD void surfel_slope(const SurfelFrame<T>& f, const T scale[2], T slope[2]) {
  slope[0] = -at_least(scale[0], T(kShortest)) * f.tu[2] / f.p[2];
  slope[1] = -at_least(scale[1], T(kShortest)) * f.tv[2] / f.p[2];
}

// Adds the gradients of the parameters to v_mean[3], v_quat[4] and v_scale[2], given the gradients `v` of the projected
// values. The derivative of an inverse is v_H = -H^-T v_(H^-1) H^-T. The camera matrix cancels in the product of the
// two right factors, which is W.
template <class T>
MGSR_HD void pull_surfel_back(const Camera<T>& cam, const T quat[4], const T scale[2], const SurfelFrame<T>& f,
                              const SurfelPull<T>& v, T v_mean[3], T v_quat[4], T v_scale[2]) {
  const T* W = v.W;
  T v_H[9];  // by columns: of s_u t_u, s_v t_v, p
  for (int k = 0; k < 3; ++k)
    for (int i = 0; i < 3; ++i) v_H[3 * k + i] = -(f.G[i] * W[k] + f.G[3 + i] * W[3 + k] + f.G[6 + i] * W[6 + k]);
  v_scale[0] -= f.edge_on || scale[0] < T(kShortest) ? T(0) : W[0] / scale[0];
  v_scale[1] -= f.edge_on || scale[1] < T(kShortest) ? T(0) : W[4] / scale[1];

  T v_R[9];
  for (int i = 0; i < 3; ++i) {
    v_R[3 * i] = scale[0] * (cam.R[i] * v_H[0] + cam.R[3 + i] * v_H[1] + cam.R[6 + i] * v_H[2]);
    v_R[3 * i + 1] = scale[1] * (cam.R[i] * v_H[3] + cam.R[3 + i] * v_H[4] + cam.R[6 + i] * v_H[5]);
    v_R[3 * i + 2] = f.facing * v.normal[i];
  }
  quat_to_rotation_vjp(quat, v_R, v_quat);

  const T iz = T(1) / f.p[2];
  const T v_ux = cam.fx * v.x * iz, v_uy = cam.fy * v.y * iz;
  const T v_p[3] = {v_H[6] + v_ux, v_H[7] + v_uy,
                    v_H[8] + v.depth + iz * (W[0] + W[4] + W[8] - v_ux * f.p[0] - v_uy * f.p[1])};
  to_camera_vjp(cam, v_p, v_mean);
}

// Does the same as pull_surfel_back, given the gradients of the projected values themselves.
template <class T>
MGSR_HD void project_surfel_vjp(const Camera<T>& cam, const T quat[4], const T scale[2], const SurfelFrame<T>& f,
                                const ProjectedSurfel<T>& v, T v_mean[3], T v_quat[4], T v_scale[2]) {
  const ProjectedSurfel<T> s = project_surfel(cam, f);
  const T A[6] = {s.L[0], s.L[1], s.L[2], s.L[3], s.g[0], s.g[1]};
  const T v_A[6] = {v.L[0], v.L[1], v.L[2], v.L[3], v.g[0], v.g[1]};
  SurfelPull<T> pull = {v.x, v.y, v.depth, {}, {v.normal[0], v.normal[1], v.normal[2]}};
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) pull.W[3 * i + k] = v_A[2 * i] * A[2 * k] + v_A[2 * i + 1] * A[2 * k + 1];
  pull_surfel_back(cam, quat, scale, f, pull, v_mean, v_quat, v_scale);
}

// The image of the disk u^2 + v^2 <= r2 is the ellipse (p - centre)^T C^-1 (p - centre) <= 1, with its centre relative
// to the projected centre. It follows from the dual conic M diag(r2, r2, -1) M^T. Shifted to the projected centre,
// every term of C is a sum of squares, so thin ellipses keep their precision.
template <class T>
struct SurfelOutline {
  T x, y;
  T cxx, cxy, cyy;
};

// Writes the outline. Returns false if the disk reaches camera depths of `near` or less.
template <class T>
MGSR_HD bool surfel_outline(const Camera<T>& cam, const SurfelFrame<T>& f, const T scale[2], T r2, T near,
                            SurfelOutline<T>& o) {
  const T iz = T(1) / f.p[2];
  const T tx = f.p[0] * iz, ty = f.p[1] * iz;
  const T ux = scale[0] * cam.fx * (f.tu[0] - tx * f.tu[2]), uy = scale[0] * cam.fy * (f.tu[1] - ty * f.tu[2]);
  const T vx = scale[1] * cam.fx * (f.tv[0] - tx * f.tv[2]), vy = scale[1] * cam.fy * (f.tv[1] - ty * f.tv[2]);
  const T uz = scale[0] * f.tu[2], vz = scale[1] * f.tv[2];
  const T reach2 = r2 * (uz * uz + vz * vz);
  const T k = r2 / (f.p[2] * f.p[2] - reach2);
  o.x = -k * (ux * uz + vx * vz);
  o.y = -k * (uy * uz + vy * vz);
  o.cxx = o.x * o.x + k * (ux * ux + vx * vx);
  o.cxy = o.x * o.y + k * (ux * uy + vx * vy);
  o.cyy = o.y * o.y + k * (uy * uy + vy * vy);
  return f.p[2] > near && reach2 < (f.p[2] - near) * (f.p[2] - near);
}

}  // namespace mgsr
