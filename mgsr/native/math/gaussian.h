// Projection of a 3D Gaussian to the image: EWA splatting, supplement Eq. 17-18.
#pragma once

#include "math/camera.h"
#include "math/quat.h"

namespace mgsr {

// A Gaussian on the image: centre and covariance in pixels (low-pass included) and camera depth.
template <class T>
struct ProjectedGaussian {
  T x, y, depth;
  T cxx, cxy, cyy;
  T compensation;  // sqrt(det before the low-pass / det after): the factor that undoes the energy the low-pass adds
};

// Intermediate values that the projection and its derivative share.
template <class T>
struct GaussianFrame {
  T p[3];      // mean in the camera
  T tx, ty;    // x/z and y/z, clamped near the image, where the linearisation is accurate
  Condition<T> held_x, held_y;
  T R[9];      // of the quaternion
  T M[6];      // J times the camera's rotation, [2,3]
  T B[6];      // M R, [2,3]
  T A[6];      // B S, so that the covariance is A A^T
};

template <class T>
MGSR_HD T hold(T x, T low, T high, Condition<T>& held) {
  const Condition<T> under = x < low, over = x > high;
  held = under | over;
  return select(under, low, select(over, high, x));
}

template <class T>
MGSR_HD void gaussian_frame(const Camera<T>& cam, const T mean[3], const T quat[4], const T scale[3], GaussianFrame<T>& f) {
  to_camera(cam, mean, f.p);
  const T iz = T(1) / f.p[2];
  const T mx = T(0.15) * cam.width, my = T(0.15) * cam.height;
  f.tx = hold(f.p[0] * iz, (-mx - cam.cx) / cam.fx, (cam.width + mx - cam.cx) / cam.fx, f.held_x);
  f.ty = hold(f.p[1] * iz, (-my - cam.cy) / cam.fy, (cam.height + my - cam.cy) / cam.fy, f.held_y);
  quat_to_rotation(quat, f.R);
  for (int j = 0; j < 3; ++j) {
    f.M[j] = cam.fx * iz * (cam.R[j] - f.tx * cam.R[6 + j]);
    f.M[3 + j] = cam.fy * iz * (cam.R[3 + j] - f.ty * cam.R[6 + j]);
  }
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j) {
      f.B[3 * i + j] = f.M[3 * i] * f.R[j] + f.M[3 * i + 1] * f.R[3 + j] + f.M[3 * i + 2] * f.R[6 + j];
      f.A[3 * i + j] = f.B[3 * i + j] * scale[j];
    }
}

// low_pass: variance in px^2 added to both axes.
template <class T>
MGSR_HD ProjectedGaussian<T> project_gaussian(const Camera<T>& cam, const T mean[3], const T quat[4], const T scale[3],
                                              T low_pass) {
  GaussianFrame<T> f;
  gaussian_frame(cam, mean, quat, scale, f);
  const T* A = f.A;
  const T xx = A[0] * A[0] + A[1] * A[1] + A[2] * A[2];
  const T xy = A[0] * A[3] + A[1] * A[4] + A[2] * A[5];
  const T yy = A[3] * A[3] + A[4] * A[4] + A[5] * A[5];
  ProjectedGaussian<T> g;
  g.x = cam.fx * f.p[0] / f.p[2] + cam.cx;
  g.y = cam.fy * f.p[1] / f.p[2] + cam.cy;
  g.depth = f.p[2];
  g.cxx = xx + low_pass, g.cxy = xy, g.cyy = yy + low_pass;
  const T det0 = xx * yy - xy * xy, det = g.cxx * g.cyy - xy * xy;
  g.compensation = select(det0 > T(0), MGSR_SQRT(det0 / det), T(0));
  return g;
}

// Adds the gradients of the parameters to v_mean[3], v_quat[4] and v_scale[3], given the gradients `v` of the projected
// values. The covariance in `v` is the low-passed one.
template <class T>
MGSR_HD void project_gaussian_vjp(const Camera<T>& cam, const T mean[3], const T quat[4], const T scale[3], T low_pass,
                                  const ProjectedGaussian<T>& v, T v_mean[3], T v_quat[4], T v_scale[3]) {
  GaussianFrame<T> f;
  gaussian_frame(cam, mean, quat, scale, f);
  const T* A = f.A;
  T v_xx = v.cxx, v_xy = v.cxy, v_yy = v.cyy;
  if (any(v.compensation != T(0))) {
    const T xx = A[0] * A[0] + A[1] * A[1] + A[2] * A[2];
    const T xy = A[0] * A[3] + A[1] * A[4] + A[2] * A[5];
    const T yy = A[3] * A[3] + A[4] * A[4] + A[5] * A[5];
    const T det0 = xx * yy - xy * xy, det = (xx + low_pass) * (yy + low_pass) - xy * xy;
    const Condition<T> flat = det0 <= T(0);  // without energy before the low-pass, there is no gradient
    const T i0 = select(flat, T(0), T(1) / det0), i = T(1) / det;
    const T half = select(flat, T(0), T(0.5) * MGSR_SQRT(det0 * i) * v.compensation);
    v_xx += half * (yy * i0 - (yy + low_pass) * i);
    v_yy += half * (xx * i0 - (xx + low_pass) * i);
    v_xy += half * 2 * xy * (i - i0);
  }
  T v_B[6];
  for (int j = 0; j < 3; ++j) {
    const T v_A0 = 2 * v_xx * A[j] + v_xy * A[3 + j], v_A1 = v_xy * A[j] + 2 * v_yy * A[3 + j];
    v_scale[j] += v_A0 * f.B[j] + v_A1 * f.B[3 + j];
    v_B[j] = v_A0 * scale[j], v_B[3 + j] = v_A1 * scale[j];
  }
  T v_R[9], v_M[6];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) v_R[3 * i + j] = f.M[i] * v_B[j] + f.M[3 + i] * v_B[3 + j];
  for (int i = 0; i < 2; ++i)
    for (int j = 0; j < 3; ++j)
      v_M[3 * i + j] = v_B[3 * i] * f.R[3 * j] + v_B[3 * i + 1] * f.R[3 * j + 1] + v_B[3 * i + 2] * f.R[3 * j + 2];
  quat_to_rotation_vjp(quat, v_R, v_quat);

  // M's rows are (f/z) (axis - t * z-axis). The gradient passes through f/z, and through t if it was not clamped.
  const T iz = T(1) / f.p[2];
  const T mx = v_M[0] * f.M[0] + v_M[1] * f.M[1] + v_M[2] * f.M[2];
  const T my = v_M[3] * f.M[3] + v_M[4] * f.M[4] + v_M[5] * f.M[5];
  T v_tx = -cam.fx * iz * (v_M[0] * cam.R[6] + v_M[1] * cam.R[7] + v_M[2] * cam.R[8]);
  T v_ty = -cam.fy * iz * (v_M[3] * cam.R[6] + v_M[4] * cam.R[7] + v_M[5] * cam.R[8]);
  v_tx = select(f.held_x, T(0), v_tx);
  v_ty = select(f.held_y, T(0), v_ty);
  T v_p[3];
  const T v_ux = v_tx + cam.fx * v.x, v_uy = v_ty + cam.fy * v.y;  // gradients of x/z and y/z
  v_p[0] = v_ux * iz;
  v_p[1] = v_uy * iz;
  v_p[2] = v.depth - iz * (mx + my) - iz * iz * (v_ux * f.p[0] + v_uy * f.p[1]);
  to_camera_vjp(cam, v_p, v_mean);
}

}  // namespace mgsr
