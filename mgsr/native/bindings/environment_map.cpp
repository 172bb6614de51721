// Python module mgsr.native._environment_map.
#include "bindings/arrays.h"
#include "kernels/environment_map/environment_map.h"
#include "math/environment_map.h"

namespace mgsr {
namespace {

IsaChoice<EnvironmentMapTable>& choice() {
  static IsaChoice<EnvironmentMapTable> current(MGSR_TABLES(environment_map_table));
  return current;
}

template <class T>
using Maps = Array<T, nb::shape<2, -1, -1, 3>>;
template <class T>
using Rgb = Array<T, nb::shape<-1, -1, 3>>;
using Pixels = Array<const int64_t, nb::ndim<1>>;
using Intrinsics = std::tuple<float, float, float, float>;

// The same number of rows and columns.
template <class A, class B>
bool same_size(const A& a, const B& b) {
  return a.shape(0) == b.shape(0) && a.shape(1) == b.shape(1);
}

// intrinsics: fx, fy, cx, cy. cam_from_world: rotation, row-major.
EnvironmentMapParams params(const Maps<const float>& maps, const Rgb<const float>& normals, const Pixels& pixels,
                      const std::vector<float>& cam_from_world, const Intrinsics& intrinsics) {
  expect(maps.shape(1) == maps.shape(2) && maps.shape(1) > 0, "maps: expected square maps of one texel at least");
  expect(cam_from_world.size() == 9, "cam_from_world: expected the 9 numbers of a rotation");
  EnvironmentMapParams p;
  const int64_t all = int64_t(normals.shape(0)) * int64_t(normals.shape(1));
  p.count = pixels.is_valid() ? int64_t(pixels.shape(0)) : all, p.pixels = pointer_or_null(pixels);
  bool inside = true;
  for (int64_t i = 0; p.pixels && i < p.count; ++i) inside &= uint64_t(p.pixels[i]) < uint64_t(all);
  expect(inside, "pixels: expected row * width + column of pixels inside the image");
  p.width = int(normals.shape(1)), p.side = int(maps.shape(1));
  p.maps = maps.data(), p.normals = normals.data();
  for (size_t i = 0; i < 9; ++i) p.cam_from_world[i] = cam_from_world[i];
  std::tie(p.fx, p.fy, p.cx, p.cy) = intrinsics;
  return p;
}

void forward(const Maps<const float>& maps, const Rgb<const float>& normals, const Pixels& pixels,
             const std::vector<float>& cam_from_world, const Intrinsics& intrinsics, const Rgb<float>& light) {
  EnvironmentMapParams p = params(maps, normals, pixels, cam_from_world, intrinsics);
  expect(same_size(normals, light), "light: expected the normals' size");
  p.light = light.data();
  nb::gil_scoped_release release;
  choice()->forward(p);
}

void backward(const Maps<const float>& maps, const Rgb<const float>& normals, const Pixels& pixels,
              const std::vector<float>& cam_from_world, const Intrinsics& intrinsics, const Rgb<const float>& v_light,
              const Maps<float>& v_maps, const Rgb<float>& v_normals) {
  EnvironmentMapParams p = params(maps, normals, pixels, cam_from_world, intrinsics);
  expect(same_size(normals, v_light), "v_light: expected the normals' size");
  expect(!v_normals.is_valid() || same_size(normals, v_normals), "v_normals: expected the normals' size");
  expect(!v_maps.is_valid() || (v_maps.shape(1) == maps.shape(1) && v_maps.shape(2) == maps.shape(2)),
         "v_maps: expected the maps' size");
  p.v_light = v_light.data(), p.v_maps = pointer_or_null(v_maps), p.v_normals = pointer_or_null(v_normals);
  nb::gil_scoped_release release;
  choice()->backward(p);
}

using Numbers = Array<double, nb::ndim<1>>;
using ConstNumbers = Array<const double, nb::ndim<1>>;

// The maths in float64, for its tests: the places [4] on both maps of a normal [3] seen along ray [2], and the normal's
// gradient [3] from v_places [4].
void places_double(const ConstNumbers& rotation, const ConstNumbers& ray, const ConstNumbers& normal,
                   const ConstNumbers& v_places, const Numbers& places, const Numbers& v_normal) {
  expect(rotation.shape(0) == 9 && ray.shape(0) == 2 && normal.shape(0) == 3 && v_places.shape(0) == 4 &&
             places.shape(0) == 4 && v_normal.shape(0) == 3,
         "expected 9, 2, 3, 4, 4 and 3 numbers");
  const EnvironmentMapSight<double> sight = reflect_sight(rotation.data(), ray.data(), normal.data());
  for (int k = 0; k < 2; ++k) places.data()[k] = sight.still.place[k], places.data()[2 + k] = sight.held.place[k];
  reflect_sight_vjp(rotation.data(), sight, v_places.data(), v_places.data() + 2, v_normal.data());
}

// (texel, slope) of a place.
std::tuple<double, double> texel_double(double place, double side) {
  const double texel = texel_of(place, side);
  return {texel, texel_slope(texel, side)};
}

// The value between corners [4] at x, y; v [6] are its derivatives by the corners, x and y.
double bilinear_double(const ConstNumbers& corners, double x, double y, const Numbers& v) {
  expect(corners.shape(0) == 4 && v.shape(0) == 6, "corners, v: expected 4 and 6 numbers");
  const double* c = corners.data();
  const Corners<double> at = {c[0], c[1], c[2], c[3]}, by = bilinear_vjp(1.0, x, y);
  const double parts[4] = {by.upper_left, by.upper_right, by.lower_left, by.lower_right};
  for (int i = 0; i < 4; ++i) v.data()[i] = parts[i];
  bilinear_slopes(at, x, y, v.data()[4], v.data()[5]);
  return bilinear(at, x, y);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_environment_map, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("forward", &forward, nb::arg("maps"), nb::arg("normals"), nb::arg("pixels").none(), nb::arg("cam_from_world"),
        nb::arg("intrinsics"), nb::arg("light"));
  m.def("backward", &backward, nb::arg("maps"), nb::arg("normals"), nb::arg("pixels").none(), nb::arg("cam_from_world"),
        nb::arg("intrinsics"), nb::arg("v_light"), nb::arg("v_maps").none(), nb::arg("v_normals").none());
  m.def("places_double", &places_double, nb::arg("rotation"), nb::arg("ray"), nb::arg("normal"), nb::arg("v_places"),
        nb::arg("places"), nb::arg("v_normal"));
  m.def("texel_double", &texel_double, nb::arg("place"), nb::arg("side"));
  m.def("bilinear_double", &bilinear_double, nb::arg("corners"), nb::arg("x"), nb::arg("y"), nb::arg("v"));
}
