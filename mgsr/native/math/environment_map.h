// The environment map that a surface reflects: the direction of the reflected line of sight, and two maps of
// directions.
//
// A map is the octahedron |x| + |y| + |z| = 1 seen from +z, with its far half folded out over the corners of the square
// -1..1. One map is fixed in the scene. The other is fixed to the camera; its middle is the direction to the camera.
#pragma once

#include "math/macros.h"

namespace mgsr {

// The least squared length of a normal. Shorter normals count as this long, so that a zero normal gives finite numbers.
constexpr double kShortestNormal = 1e-12;

template <class T>
struct OctahedralPlace {
  T sign[3];      // -1 or 1
  T inverse;      // of |x| + |y| + |z|
  T unfolded[2];  // x and y on the octahedron
  T place[2];
};

// Projects a direction d of any length to the map. least: the lower limit of |x| + |y| + |z|.
template <class T>
MGSR_HD OctahedralPlace<T> octahedral(const T d[3], T least) {
  OctahedralPlace<T> o;
  for (int i = 0; i < 3; ++i) o.sign[i] = select(d[i] < T(0), T(-1), T(1));
  const T sum = d[0] * o.sign[0] + d[1] * o.sign[1] + d[2] * o.sign[2];
  o.inverse = T(1) / select(sum < least, least, sum);
  for (int i = 0; i < 2; ++i) o.unfolded[i] = d[i] * o.inverse;
  for (int i = 0; i < 2; ++i) {
    const T folded = (T(1) - o.unfolded[1 - i] * o.sign[1 - i]) * o.sign[i];
    o.place[i] = select(d[2] < T(0), folded, o.unfolded[i]);
  }
  return o;
}

// Adds the gradient of d to v_d. On an edge of the octahedron it is the gradient on one of the adjacent faces.
template <class T>
MGSR_HD void octahedral_vjp(const OctahedralPlace<T>& o, const T v_place[2], T v_d[3]) {
  const T turn = -o.sign[0] * o.sign[1];
  T v[2];
  for (int i = 0; i < 2; ++i) v[i] = select(o.sign[2] < T(0), turn * v_place[1 - i], v_place[i]);
  const T along = v[0] * o.unfolded[0] + v[1] * o.unfolded[1];
  for (int i = 0; i < 2; ++i) v_d[i] += (v[i] - along * o.sign[i]) * o.inverse;
  v_d[2] -= along * o.sign[2] * o.inverse;
}

// A reflected line of sight: its places on both maps, and the intermediate values that the derivative needs.
template <class T>
struct EnvironmentMapSight {
  T ray[2];             // the line of sight (x, y, 1), camera axes
  T n[3];               // the normal, camera axes
  T across, square;     // n . ray; |n|^2, at least kShortestNormal
  OctahedralPlace<T> still, held;  // on the scene's map and on the camera's
};

// R: cam_from_world, row-major. normal: world frame, of any length. The reflected line of sight is
// |n|^2 ray - 2 (n . ray) n; its length has no effect.
template <class T>
MGSR_HD EnvironmentMapSight<T> reflect_sight(const T R[9], const T ray[2], const T normal[3]) {
  EnvironmentMapSight<T> m;
  for (int i = 0; i < 2; ++i) m.ray[i] = ray[i];
  for (int i = 0; i < 3; ++i) m.n[i] = R[3 * i] * normal[0] + R[3 * i + 1] * normal[1] + R[3 * i + 2] * normal[2];
  m.across = m.n[0] * ray[0] + m.n[1] * ray[1] + m.n[2];
  const T square = m.n[0] * m.n[0] + m.n[1] * m.n[1] + m.n[2] * m.n[2];
  m.square = select(square < T(kShortestNormal), T(kShortestNormal), square);
  const T twice = T(2) * m.across, least = T(1e-9) * m.square;
  const T reflected[3] = {m.square * ray[0] - twice * m.n[0], m.square * ray[1] - twice * m.n[1], m.square - twice * m.n[2]};
  T world[3];
  for (int i = 0; i < 3; ++i) world[i] = R[i] * reflected[0] + R[3 + i] * reflected[1] + R[6 + i] * reflected[2];
  const T back[3] = {reflected[0], reflected[1], -reflected[2]};
  m.still = octahedral(world, least), m.held = octahedral(back, least);
  return m;
}

// Writes the gradient of the normal, given the gradients of the places on the maps.
template <class T>
MGSR_HD void reflect_sight_vjp(const T R[9], const EnvironmentMapSight<T>& m, const T v_still[2], const T v_held[2], T v_normal[3]) {
  T v_world[3] = {T(0), T(0), T(0)}, v[3] = {T(0), T(0), T(0)}, v_n[3];
  octahedral_vjp(m.still, v_still, v_world);
  octahedral_vjp(m.held, v_held, v);
  v[2] = -v[2];
  for (int i = 0; i < 3; ++i) v[i] += R[3 * i] * v_world[0] + R[3 * i + 1] * v_world[1] + R[3 * i + 2] * v_world[2];
  const T v_square = v[0] * m.ray[0] + v[1] * m.ray[1] + v[2];
  const T v_twice = v[0] * m.n[0] + v[1] * m.n[1] + v[2] * m.n[2];
  const T by_square = select(m.square > T(kShortestNormal), v_square, T(0));
  const T ray[3] = {m.ray[0], m.ray[1], T(1)};
  for (int i = 0; i < 3; ++i) v_n[i] = T(2) * (by_square * m.n[i] - v_twice * ray[i] - m.across * v[i]);
  for (int i = 0; i < 3; ++i) v_normal[i] = R[i] * v_n[0] + R[3 + i] * v_n[1] + R[6 + i] * v_n[2];
}

// Returns the texel coordinate of a place -1..1 on a side of `side` texels, with texel centres at whole numbers. It is
// clamped to the outermost texels, and NaN gives 0.
template <class T>
MGSR_HD T texel_of(T place, T side) {
  const T texel = (place * side + side - T(1)) * T(0.5), last = side - T(1);
  return select(texel > T(0), select(texel < last, texel, last), T(0));
}

// Returns the derivative of texel_of with respect to the place, given its result; 0 where it was clamped.
template <class T>
MGSR_HD T texel_slope(T texel, T side) {
  return select(texel > T(0), select(texel < side - T(1), side * T(0.5), T(0)), T(0));
}

// Four neighbouring texels. V is a scalar, or several channels with the operators of a scalar.
template <class V>
struct Corners {
  V upper_left, upper_right, lower_left, lower_right;
};

// Interpolates between the corners at x, y: 0..1 from the upper left.
template <class V, class T>
MGSR_HD V bilinear(const Corners<V>& c, T x, T y) {
  const V upper = c.upper_left + (c.upper_right - c.upper_left) * x;
  const V lower = c.lower_left + (c.lower_right - c.lower_left) * x;
  return upper + (lower - upper) * y;
}

// The derivatives of bilinear with respect to x and y, channel by channel.
template <class V, class T>
MGSR_HD void bilinear_slopes(const Corners<V>& c, T x, T y, V& by_x, V& by_y) {
  const V across = c.upper_right - c.upper_left, below = c.lower_right - c.lower_left;
  by_x = across + (below - across) * y;
  by_y = (c.lower_left - c.upper_left) + (below - across) * x;
}

// Returns the gradients of the corners, given the gradient v of bilinear.
template <class V, class T>
MGSR_HD Corners<V> bilinear_vjp(V v, T x, T y) {
  const V right = v * x, left = v - right, lower_right = right * y, lower_left = left * y;
  return {left - lower_left, right - lower_right, lower_left, lower_right};
}

}  // namespace mgsr
