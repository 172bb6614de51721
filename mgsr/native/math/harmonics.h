// Real spherical harmonics of degree 0 to 3, in the sign convention of splat files: y, z, x order, Condon-Shortley
// phase.
// T is float, double or a vector of floats, so only + - * and comparisons are used. The literals are floats, which
// combine with every T; in double they cause a relative error of 1e-8.
#pragma once

#include "math/macros.h"

namespace mgsr {

// Returns 1 / |(dx, dy, dz)|. A zero vector gives a large finite number, so its direction is zero.
template <class T>
MGSR_HD T inverse_length(T dx, T dy, T dz) {
  const T squared = dx * dx + dy * dy + dz * dz;
  return T(1) / MGSR_SQRT(squared < T(1e-24f) ? T(1e-24f) : squared);
}

// Adds to v_d the gradient through (dx, dy, dz) * inverse_length, given the unit vector u and the inverse length. A
// vector too short to have a direction gets no gradient.
template <class T>
MGSR_HD void unit_vector_vjp(const T u[3], T inverse, const T v_u[3], T v_d[3]) {
  const T along = u[0] * v_u[0] + u[1] * v_u[1] + u[2] * v_u[2];
  const T factor = inverse < 9e11f ? inverse : T{};
  for (int i = 0; i < 3; ++i) v_d[i] += (v_u[i] - along * u[i]) * factor;
}

// Writes the basis functions in the direction of the unit vector u to b [(D+1)^2].
template <int D, class T>
MGSR_HD void harmonics_basis(const T u[3], T* b) {
  const T x = u[0], y = u[1], z = u[2];
  b[0] = T{} + 0.28209479177387814f;
  if constexpr (D >= 1) {
    b[1] = -0.4886025119029199f * y;
    b[2] = 0.4886025119029199f * z;
    b[3] = -0.4886025119029199f * x;
  }
  if constexpr (D >= 2) {
    b[4] = 1.0925484305920792f * x * y;
    b[5] = -1.0925484305920792f * y * z;
    b[6] = 0.31539156525252005f * (2.0f * z * z - x * x - y * y);
    b[7] = -1.0925484305920792f * x * z;
    b[8] = 0.5462742152960396f * (x * x - y * y);
  }
  if constexpr (D >= 3) {
    const T xx = x * x, yy = y * y, zz = z * z;
    b[9] = -0.5900435899266435f * y * (3.0f * xx - yy);
    b[10] = 2.890611442640554f * x * y * z;
    b[11] = -0.4570457994644658f * y * (4.0f * zz - xx - yy);
    b[12] = 0.3731763325901154f * z * (2.0f * zz - 3.0f * xx - 3.0f * yy);
    b[13] = -0.4570457994644658f * x * (4.0f * zz - xx - yy);
    b[14] = 1.445305721320277f * z * (xx - yy);
    b[15] = -0.5900435899266435f * x * (xx - 3.0f * yy);
  }
}

// Adds to v_u the gradient of u, given the gradients v [(D+1)^2] of the basis functions.
template <int D, class T>
MGSR_HD void harmonics_basis_vjp(const T u[3], const T* v, T v_u[3]) {
  const T x = u[0], y = u[1], z = u[2];
  T gx = T{}, gy = T{}, gz = T{};
  if constexpr (D >= 1) {
    gx += -0.4886025119029199f * v[3];
    gy += -0.4886025119029199f * v[1];
    gz += 0.4886025119029199f * v[2];
  }
  if constexpr (D >= 2) {
    const float a = 1.0925484305920792f, c = 0.31539156525252005f;
    gx += a * (y * v[4] - z * v[7] + x * v[8]) - 2.0f * c * x * v[6];
    gy += a * (x * v[4] - z * v[5] - y * v[8]) - 2.0f * c * y * v[6];
    gz += 4.0f * c * z * v[6] - a * (y * v[5] + x * v[7]);
  }
  if constexpr (D >= 3) {
    const float p = 0.5900435899266435f, q = 2.890611442640554f, r = 0.4570457994644658f, s = 0.3731763325901154f,
                t = 1.445305721320277f;
    const T xx = x * x, yy = y * y, zz = z * z, xy = x * y, xz = x * z, yz = y * z;
    gx += -6.0f * p * xy * v[9] + q * yz * v[10] + 2.0f * r * xy * v[11] - 6.0f * s * xz * v[12] -
          r * (4.0f * zz - 3.0f * xx - yy) * v[13] + 2.0f * t * xz * v[14] - 3.0f * p * (xx - yy) * v[15];
    gy += -3.0f * p * (xx - yy) * v[9] + q * xz * v[10] - r * (4.0f * zz - xx - 3.0f * yy) * v[11] -
          6.0f * s * yz * v[12] + 2.0f * r * xy * v[13] - 2.0f * t * yz * v[14] + 6.0f * p * xy * v[15];
    gz += q * xy * v[10] - 8.0f * r * yz * v[11] + s * (6.0f * zz - 3.0f * xx - 3.0f * yy) * v[12] -
          8.0f * r * xz * v[13] + t * (xx - yy) * v[14];
  }
  v_u[0] += gx, v_u[1] += gy, v_u[2] += gz;
}

// rgb = max(0, sum_k b_k coeffs_k + 0.5); coeffs: [(D+1)^2][3]. A NaN stays a NaN.
template <int D, class T>
MGSR_HD void harmonics_to_rgb(const T* coeffs, const T u[3], T rgb[3]) {
  T b[(D + 1) * (D + 1)];
  harmonics_basis<D>(u, b);
  for (int c = 0; c < 3; ++c) {
    T sum = T{} + 0.5f;
    for (int k = 0; k < (D + 1) * (D + 1); ++k) sum += b[k] * coeffs[3 * k + c];
    rgb[c] = sum < T{} ? T{} : sum;
  }
}

// Writes v_coeffs and adds to v_u the gradients through harmonics_to_rgb, whose result is rgb. A channel that is
// clipped at 0 passes no gradient.
template <int D, class T>
MGSR_HD void harmonics_to_rgb_vjp(const T* coeffs, const T u[3], const T rgb[3], const T v_rgb[3], T* v_coeffs,
                                  T v_u[3]) {
  T b[(D + 1) * (D + 1)], v_b[(D + 1) * (D + 1)], v[3];
  harmonics_basis<D>(u, b);
  for (int c = 0; c < 3; ++c) v[c] = rgb[c] > T{} ? v_rgb[c] : T{};
  for (int k = 0; k < (D + 1) * (D + 1); ++k) {
    v_b[k] = coeffs[3 * k] * v[0] + coeffs[3 * k + 1] * v[1] + coeffs[3 * k + 2] * v[2];
    for (int c = 0; c < 3; ++c) v_coeffs[3 * k + c] = b[k] * v[c];
  }
  harmonics_basis_vjp<D>(u, v_b, v_u);
}

}  // namespace mgsr
