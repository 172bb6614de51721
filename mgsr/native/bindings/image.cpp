// Python module mgsr.native._image.
#include <nanobind/stl/pair.h>

#include <tuple>
#include <utility>

#include "bindings/doubles.h"
#include "bindings/fields.h"
#include "bindings/sizes.h"
#include "kernels/image/image.h"
#include "math/depth_normal.h"
#include "math/ssim.h"
#include "math/tv.h"

namespace mgsr {
namespace {

IsaChoice<ImageTable>& choice() {
  static IsaChoice<ImageTable> current(MGSR_TABLES(image_table));
  return current;
}

template <class T>
using Rgb = Array<T, nb::shape<-1, -1, 3>>;
template <class T>
using Channels = Array<T, nb::ndim<3>>;
template <class T>
using Plane = Array<T, nb::ndim<2>>;

std::pair<double, double> image_loss(nb::handle pair, nb::handle v_image, nb::handle v_target) {
  const Fields fields(pair, "pair");
  const auto image = fields.array<Rgb<const float>>("image"), target = fields.array<Rgb<const float>>("target");
  const auto mask = fields.array_or_none<Plane<const float>>("mask");
  const auto to_image = read_or_none<Rgb<float>>(v_image, "v_image");
  const auto to_target = read_or_none<Rgb<float>>(v_target, "v_target");
  expect_same_size(image, target, "target: expected the image's size");
  expect_same_size(image, mask, "mask: expected the image's size");
  expect_same_size(image, to_image, "v_image: expected the image's size");
  expect_same_size(image, to_target, "v_target: expected the image's size");
  expect(to_image.is_valid() || !to_target.is_valid(), "v_target: expected only beside v_image");
  ImageLossParams p;
  p.height = int(image.shape(0)), p.width = int(image.shape(1));
  p.image = image.data(), p.target = target.data(), p.mask = pointer_or_null(mask);
  p.l1_weight = fields.value<float>("l1_weight"), p.clip = fields.value<bool>("clip");
  p.v_image = pointer_or_null(to_image), p.v_target = pointer_or_null(to_target);
  nb::gil_scoped_release release;
  const ImageLossSums sums = choice()->loss(p);
  return {sums.total, sums.weight};
}

std::pair<double, double> tv(nb::handle values, nb::handle guide, nb::handle mask, nb::handle v_values) {
  const auto of_values = read<Channels<const float>>(values, "values");
  const auto of_guide = read<Rgb<const float>>(guide, "guide");
  const auto of_mask = read_or_none<Plane<const float>>(mask, "mask");
  const auto to_values = read_or_none<Channels<float>>(v_values, "v_values");
  expect_same_size(of_values, of_guide, "guide: expected the values' size");
  expect_same_size(of_values, of_mask, "mask: expected the values' size");
  expect_same_size(of_values, to_values, "v_values: expected the values' size");
  expect(!to_values.is_valid() || to_values.shape(2) == of_values.shape(2), "v_values: expected the values' channels");
  TvParams p;
  p.height = int(of_values.shape(0)), p.width = int(of_values.shape(1)), p.channels = int(of_values.shape(2));
  p.values = of_values.data(), p.guide = of_guide.data(), p.mask = pointer_or_null(of_mask);
  p.v_values = pointer_or_null(to_values);
  nb::gil_scoped_release release;
  const TvSums sums = choice()->tv(p);
  return {sums.total, sums.pairs};
}

// The struct DepthSurface of structs.py.
struct Surface {
  explicit Surface(const Fields& fields)
      : depth(fields.array<Plane<const float>>("depth")),
        alpha(fields.array_or_none<Plane<const float>>("alpha")),
        camera(camera_of(fields.get("camera"))) {
    expect_same_size(depth, alpha, "alpha: expected the depth's size");
  }

  Plane<const float> depth, alpha;
  Camera<float> camera;
};

DepthNormalsParams params_of(const Surface& a) {
  DepthNormalsParams p;
  p.height = int(a.depth.shape(0)), p.width = int(a.depth.shape(1));
  p.depth = a.depth.data(), p.alpha = pointer_or_null(a.alpha);
  p.fx = a.camera.fx, p.fy = a.camera.fy, p.cx = a.camera.cx, p.cy = a.camera.cy;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) p.world_from_cam[3 * i + j] = a.camera.R[3 * j + i];
  return p;
}

void depth_normals(nb::handle surface, nb::handle normals) {
  const Surface a(Fields(surface, "surface"));
  const auto to_normals = read<Rgb<float>>(normals, "normals");
  expect_same_size(a.depth, to_normals, "normals: expected the depth's size");
  DepthNormalsParams p = params_of(a);
  p.normals = to_normals.data();
  nb::gil_scoped_release release;
  choice()->depth_normals(p);
}

void depth_normals_vjp(nb::handle surface, nb::handle v_normals, nb::handle v_depth) {
  const Surface a(Fields(surface, "surface"));
  const auto from_normals = read<Rgb<const float>>(v_normals, "v_normals");
  const auto to_depth = read<Plane<float>>(v_depth, "v_depth");
  expect_same_size(a.depth, from_normals, "v_normals: expected the depth's size");
  expect_same_size(a.depth, to_depth, "v_depth: expected the depth's size");
  DepthNormalsParams p = params_of(a);
  p.v_normals = from_normals.data(), p.v_depth = to_depth.data();
  nb::gil_scoped_release release;
  choice()->depth_normals_vjp(p);
}

// The maths in float64 for its tests, one case per call.

// Returns the value by ssim and by ssim_vjp, and its derivatives [4] with respect to the moments [4].
std::tuple<double, double, std::vector<double>> ssim_double(const Doubles& moments) {
  const auto m = struct_of<SsimMoments<double>>(moments);
  SsimMoments<double> v;
  const double value = ssim_vjp<double>(m, 1.0, v);
  return {ssim(m), value, {v.a, v.b, v.squares, v.product}};
}

// Returns the weight, the pair's value and its derivative.
std::tuple<double, double, double> tv_double(double difference, double guide_difference) {
  const double weight = tv_weight(guide_difference);
  return {weight, tv_pair(difference, weight), tv_pair_vjp(difference, weight)};
}

// Returns the normal [3], and the depths' gradients [4], given v_normal [3]. depths: left, right, up, down. ray: fx,
// fy, rx, ry.
std::tuple<std::vector<double>, std::vector<double>> depth_normal_double(const Doubles& depths, const Doubles& ray,
                                                                         const Doubles& v_normal) {
  expect(depths.size() == 4 && ray.size() == 4 && v_normal.size() == 3,
         "depths, ray, v_normal: expected 4, 4 and 3 numbers");
  const double *d = depths.data(), *r = ray.data();
  std::vector<double> normal(3);
  depth_normal<double>({d[0], d[1], d[2], d[3]}, {r[0], r[1], r[2], r[3]}, normal.data());
  const auto v = depth_normal_vjp<double>({d[0], d[1], d[2], d[3]}, {r[0], r[1], r[2], r[3]}, v_normal.data());
  return {normal, {v.left, v.right, v.up, v.down}};
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_image, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("image_loss", &image_loss, nb::arg("pair"), nb::arg("v_image").none(), nb::arg("v_target").none());
  m.def("tv", &tv, nb::arg("values"), nb::arg("guide"), nb::arg("mask").none(), nb::arg("v_values").none());
  m.def("depth_normals", &depth_normals, nb::arg("surface"), nb::arg("normals"));
  m.def("depth_normals_vjp", &depth_normals_vjp, nb::arg("surface"), nb::arg("v_normals"), nb::arg("v_depth"));
  m.def("ssim_double", &ssim_double, nb::arg("moments"));
  m.def("tv_double", &tv_double, nb::arg("difference"), nb::arg("guide_difference"));
  m.def("depth_normal_double", &depth_normal_double, nb::arg("depths"), nb::arg("ray"), nb::arg("v_normal"));
}
