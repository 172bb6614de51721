// The environment map that a surface reflects: where it throws the line of sight to, and what two maps of directions show there.
//
// A map is the octahedron |x| + |y| + |z| = 1 seen from +z, its far half folded out over the corners of the square
// -1..1. One map stands still in the scene; the other is held by the camera, its middle the way back to the camera.
#pragma once

#include "math/macros.h"

namespace mgsr {

// Square of the length under which a normal counts as this long, so that none at all gives finite numbers.
constexpr double kShortestNormal = 1e-12;

template <class T>
struct OctahedralPlace {
  T sign[3];      // -1 or 1
  T inverse;      // of |x| + |y| + |z|
  T unfolded[2];  // x and y on the octahedron
  T place[2];
};

// d: a direction of any length; where |x| + |y| + |z| is less than `least`, that is taken instead.
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

// v_d += the derivative. On an edge of the octahedron, that of one of the faces that meet there.
template <class T>
MGSR_HD void octahedral_vjp(const OctahedralPlace<T>& o, const T v_place[2], T v_d[3]) {
  const T turn = -o.sign[0] * o.sign[1];
  T v[2];
  for (int i = 0; i < 2; ++i) v[i] = select(o.sign[2] < T(0), turn * v_place[1 - i], v_place[i]);
  const T along = v[0] * o.unfolded[0] + v[1] * o.unfolded[1];
  for (int i = 0; i < 2; ++i) v_d[i] += (v[i] - along * o.sign[i]) * o.inverse;
  v_d[2] -= along * o.sign[2] * o.inverse;
}

// A reflected line of sight: its places on both maps, and what their derivative needs.
template <class T>
struct EnvironmentMapSight {
  T ray[2];             // the sight (x, y, 1), camera axes
  T n[3];               // the normal, camera axes
  T across, square;     // n . ray; |n|^2, at least kShortestNormal
  OctahedralPlace<T> still, held;
};

// R: cam_from_world, row-major. normal: world, of any length. The sight is reflected to |n|^2 ray - 2 (n . ray) n, whose
// length doesn't matter.
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

// v_normal = the derivative, from those by the places on the maps.
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

// Where a place -1..1 lies among `side` texels, whose centres are the whole numbers: held between the outermost ones.
// NaN gives 0.
template <class T>
MGSR_HD T texel_of(T place, T side) {
  const T texel = (place * side + side - T(1)) * T(0.5), last = side - T(1);
  return select(texel > T(0), select(texel < last, texel, last), T(0));
}

// The derivative of texel_of by the place, from its result: none where it was held.
template <class T>
MGSR_HD T texel_slope(T texel, T side) {
  return select(texel > T(0), select(texel < side - T(1), side * T(0.5), T(0)), T(0));
}

// Four neighbouring texels: V is a number, or several channels that count like one.
template <class V>
struct Corners {
  V upper_left, upper_right, lower_left, lower_right;
};

// x, y: 0..1 from the upper left.
template <class V, class T>
MGSR_HD V bilinear(const Corners<V>& c, T x, T y) {
  const V upper = c.upper_left + (c.upper_right - c.upper_left) * x;
  const V lower = c.lower_left + (c.lower_right - c.lower_left) * x;
  return upper + (lower - upper) * y;
}

// The derivatives of bilinear by x and y, channel by channel.
template <class V, class T>
MGSR_HD void bilinear_slopes(const Corners<V>& c, T x, T y, V& by_x, V& by_y) {
  const V across = c.upper_right - c.upper_left, below = c.lower_right - c.lower_left;
  by_x = across + (below - across) * y;
  by_y = (c.lower_left - c.upper_left) + (below - across) * x;
}

// The derivatives of bilinear by the corners, times v.
template <class V, class T>
MGSR_HD Corners<V> bilinear_vjp(V v, T x, T y) {
  const V right = v * x, left = v - right, lower_right = right * y, lower_left = left * y;
  return {left - lower_left, right - lower_right, lower_left, lower_right};
}

}  // namespace mgsr
