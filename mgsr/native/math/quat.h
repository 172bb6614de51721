// Rotation of a quaternion (w, x, y, z), normalised when used.
#pragma once

#include "math/macros.h"

namespace mgsr {

// Writes the unit quaternion u and returns the inverse length of q. In float, squares of numbers under 1e-19 vanish and
// those of numbers over 1e19 overflow, so such a q is divided by its largest number first.
template <class T>
MGSR_HD T unit_quat(const T q[4], T u[4]) {
  const T squared = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
  T before = T(1), inverse = T(1) / MGSR_SQRT(squared);
  const Condition<T> extreme = (squared < T(1e-30f)) | (squared > T(1e30f));
  if (any(extreme)) {
    T largest = T(0), again = T(0);
    for (int i = 0; i < 4; ++i) largest = select(q[i] > largest, q[i], select(-q[i] > largest, -q[i], largest));
    before = select(extreme, T(1) / largest, T(1));
    for (int i = 0; i < 4; ++i) again += (q[i] * before) * (q[i] * before);
    inverse = select(extreme, T(1) / MGSR_SQRT(again), inverse);
  }
  for (int i = 0; i < 4; ++i) u[i] = q[i] * before * inverse;
  return before * inverse;
}

// Writes R [9], row-major. A zero or non-finite quaternion gives a non-finite R; callers cull such splats.
template <class T>
MGSR_HD void quat_to_rotation(const T q[4], T R[9]) {
  T u[4];
  unit_quat(q, u);
  const T w = u[0], x = u[1], y = u[2], z = u[3];
  R[0] = 1 - 2 * (y * y + z * z), R[1] = 2 * (x * y - w * z), R[2] = 2 * (x * z + w * y);
  R[3] = 2 * (x * y + w * z), R[4] = 1 - 2 * (x * x + z * z), R[5] = 2 * (y * z - w * x);
  R[6] = 2 * (x * z - w * y), R[7] = 2 * (y * z + w * x), R[8] = 1 - 2 * (x * x + y * y);
}

// v_q += (dR/dq)^T v_R, through the normalisation.
template <class T>
MGSR_HD void quat_to_rotation_vjp(const T q[4], const T v[9], T v_q[4]) {
  T u[4];
  const T s = unit_quat(q, u);
  const T w = u[0], x = u[1], y = u[2], z = u[3];
  const T n[4] = {
      2 * (x * (v[7] - v[5]) + y * (v[2] - v[6]) + z * (v[3] - v[1])),
      2 * (-2 * x * (v[4] + v[8]) + y * (v[1] + v[3]) + z * (v[2] + v[6]) + w * (v[7] - v[5])),
      2 * (x * (v[1] + v[3]) - 2 * y * (v[0] + v[8]) + z * (v[5] + v[7]) + w * (v[2] - v[6])),
      2 * (x * (v[2] + v[6]) + y * (v[5] + v[7]) - 2 * z * (v[0] + v[4]) + w * (v[3] - v[1])),
  };
  const T along = n[0] * w + n[1] * x + n[2] * y + n[3] * z;
  v_q[0] += (n[0] - along * w) * s;
  v_q[1] += (n[1] - along * x) * s;
  v_q[2] += (n[2] - along * y) * s;
  v_q[3] += (n[3] - along * z) * s;
}

}  // namespace mgsr
