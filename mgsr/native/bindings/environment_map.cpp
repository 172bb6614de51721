// Python module mgsr.native._environment_map.
#include <algorithm>

#include "bindings/doubles.h"
#include "bindings/fields.h"
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
using Samples = Array<const float, nb::shape<-1, -1, -1, 3>>;

// The struct EnvironmentMapLookup of structs.py.
struct Lookup {
  explicit Lookup(const Fields& fields)
      : maps(fields.array<Maps<const float>>("maps")),
        normals(fields.array_or_none<Rgb<const float>>("normals")),
        samples(fields.array_or_none<Samples>("samples")),
        pixels(fields.array_or_none<Pixels>("pixels")),
        camera(camera_of(fields.get("camera"))) {
    expect(maps.shape(1) == maps.shape(2) && maps.shape(1) > 0, "maps: expected square maps of one texel at least");
    expect(normals.is_valid() != samples.is_valid(), "normals, samples: expected one of them");
    if (normals.is_valid()) expect(fits(normals), "normals: expected the camera's size");
    if (!samples.is_valid()) return;
    expect(samples.shape(1) == samples.shape(2) && samples.shape(1) > 0,
           "samples: expected as many columns as rows in a pixel, one at least");
    expect(pixels.is_valid() && pixels.shape(0) == samples.shape(0), "pixels: expected one for each pixel of the samples");
  }

  // Whether an image [height, width, 3] has the camera's size.
  template <class Image>
  bool fits(const Image& image) const {
    return float(image.shape(0)) == camera.height && float(image.shape(1)) == camera.width;
  }

  Maps<const float> maps;
  Rgb<const float> normals;
  Samples samples;
  Pixels pixels;
  Camera<float> camera;
};

EnvironmentMapParams params_of(const Lookup& a) {
  EnvironmentMapParams p;
  const int64_t all = int64_t(a.camera.height) * int64_t(a.camera.width);
  p.count = a.pixels.is_valid() ? int64_t(a.pixels.shape(0)) : all, p.pixels = pointer_or_null(a.pixels);
  bool inside = true;
  for (int64_t i = 0; p.pixels && i < p.count; ++i) inside &= uint64_t(p.pixels[i]) < uint64_t(all);
  expect(inside, "pixels: expected row * width + column of pixels inside the image");
  p.width = int(a.camera.width), p.side = int(a.maps.shape(1));
  p.samples = a.samples.is_valid() ? int(a.samples.shape(1)) : 0;
  p.maps = a.maps.data(), p.normals = a.samples.is_valid() ? a.samples.data() : a.normals.data();
  std::copy(a.camera.R, a.camera.R + 9, p.cam_from_world);
  p.fx = a.camera.fx, p.fy = a.camera.fy, p.cx = a.camera.cx, p.cy = a.camera.cy;
  return p;
}

void forward(nb::handle lookup, nb::handle light) {
  const Lookup a(Fields(lookup, "lookup"));
  const auto to_light = read<Rgb<float>>(light, "light");
  expect(a.fits(to_light), "light: expected the camera's size");
  EnvironmentMapParams p = params_of(a);
  p.light = to_light.data();
  nb::gil_scoped_release release;
  choice()->forward(p);
}

void backward(nb::handle lookup, nb::handle v_light, nb::handle v_maps, nb::handle v_normals) {
  const Lookup a(Fields(lookup, "lookup"));
  const auto from_light = read<Rgb<const float>>(v_light, "v_light");
  const auto to_maps = read_or_none<Maps<float>>(v_maps, "v_maps");
  const auto to_normals = read_or_none<Rgb<float>>(v_normals, "v_normals");
  EnvironmentMapParams p = params_of(a);
  expect(a.fits(from_light), "v_light: expected the camera's size");
  expect(!to_normals.is_valid() || (a.normals.is_valid() && a.fits(to_normals)),
         "v_normals: expected normals, and the camera's size");
  expect(!to_maps.is_valid() || (to_maps.shape(1) == a.maps.shape(1) && to_maps.shape(2) == a.maps.shape(2)),
         "v_maps: expected the maps' size");
  p.v_light = from_light.data(), p.v_maps = pointer_or_null(to_maps), p.v_normals = pointer_or_null(to_normals);
  nb::gil_scoped_release release;
  choice()->backward(p);
}

// The maths in float64, for its tests. Returns the places [4] on both maps of a normal [3] seen along a ray [2], and
// the normal's gradient [3], given v_places [4].
std::tuple<std::vector<double>, std::vector<double>> places_double(const Doubles& rotation, const Doubles& ray,
                                                                   const Doubles& normal, const Doubles& v_places) {
  expect(rotation.size() == 9 && ray.size() == 2 && normal.size() == 3 && v_places.size() == 4,
         "rotation, ray, normal, v_places: expected 9, 2, 3 and 4 numbers");
  const EnvironmentMapSight<double> sight = reflect_sight(rotation.data(), ray.data(), normal.data());
  std::vector<double> v_normal(3);
  reflect_sight_vjp(rotation.data(), sight, v_places.data(), v_places.data() + 2, v_normal.data());
  const auto &still = sight.still.place, &held = sight.held.place;
  return {{still[0], still[1], held[0], held[1]}, v_normal};
}

// Returns texel_of a place, and its derivative.
std::tuple<double, double> texel_double(double place, double side) {
  const double texel = texel_of(place, side);
  return {texel, texel_slope(texel, side)};
}

// Returns the bilinear value between corners [4] at x, y, and its derivatives [6] with respect to the corners, x and y.
std::tuple<double, std::vector<double>> bilinear_double(const Doubles& corners, double x, double y) {
  expect(corners.size() == 4, "corners: expected 4 numbers");
  const auto at = struct_of<Corners<double>>(corners), by = bilinear_vjp(1.0, x, y);
  std::vector<double> v = {by.upper_left, by.upper_right, by.lower_left, by.lower_right, 0, 0};
  bilinear_slopes(at, x, y, v[4], v[5]);
  return {bilinear(at, x, y), v};
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_environment_map, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("forward", &forward, nb::arg("lookup"), nb::arg("light"));
  m.def("backward", &backward, nb::arg("lookup"), nb::arg("v_light"), nb::arg("v_maps").none(),
        nb::arg("v_normals").none());
  m.def("places_double", &places_double, nb::arg("rotation"), nb::arg("ray"), nb::arg("normal"), nb::arg("v_places"));
  m.def("texel_double", &texel_double, nb::arg("place"), nb::arg("side"));
  m.def("bilinear_double", &bilinear_double, nb::arg("corners"), nb::arg("x"), nb::arg("y"));
}
