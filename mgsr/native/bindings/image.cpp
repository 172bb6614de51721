// Python module mgsr.native._image.
#include <nanobind/stl/pair.h>

#include <tuple>
#include <utility>

#include "bindings/arrays.h"
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
using Vector = Array<double, nb::ndim<1>>;
using ConstVector = Array<const double, nb::ndim<1>>;

template <class A, class B>
void expect_same_size(const A& a, const B& b, const char* message) {
  expect(!b.is_valid() || (a.shape(0) == b.shape(0) && a.shape(1) == b.shape(1)), message);
}

std::pair<double, double> image_loss(const Rgb<const float>& image, const Rgb<const float>& target, float l1_weight,
                                     bool clip, const Plane<const float>& mask,
                                     const std::tuple<int, int, int, int>& region, const Rgb<float>& v_image,
                                     const Rgb<float>& v_target) {
  expect_same_size(image, target, "target: expected the image's size");
  expect_same_size(image, mask, "mask: expected the image's size");
  expect_same_size(image, v_image, "v_image: expected the image's size");
  expect_same_size(image, v_target, "v_target: expected the image's size");
  expect(v_image.is_valid() || !v_target.is_valid(), "v_target: expected only beside v_image");
  ImageLossParams p;
  p.height = int(image.shape(0)), p.width = int(image.shape(1));
  p.image = image.data(), p.target = target.data(), p.mask = pointer_or_null(mask), p.l1_weight = l1_weight, p.clip = clip;
  std::tie(p.region.y0, p.region.y1, p.region.x0, p.region.x1) = region;
  expect(p.region.y0 >= 0 && p.region.x0 >= 0 && p.region.y1 <= p.height && p.region.x1 <= p.width,
         "region: expected rows and columns inside the image");
  p.v_image = pointer_or_null(v_image), p.v_target = pointer_or_null(v_target);
  nb::gil_scoped_release release;
  const ImageLossSums sums = choice()->loss(p);
  return {sums.total, sums.weight};
}

std::pair<double, double> tv(const Channels<const float>& values, const Rgb<const float>& guide,
                             const Plane<const float>& mask, const Channels<float>& v_values) {
  expect_same_size(values, guide, "guide: expected the values' size");
  expect_same_size(values, mask, "mask: expected the values' size");
  expect_same_size(values, v_values, "v_values: expected the values' size");
  expect(!v_values.is_valid() || v_values.shape(2) == values.shape(2), "v_values: expected the values' channels");
  TvParams p;
  p.height = int(values.shape(0)), p.width = int(values.shape(1)), p.channels = int(values.shape(2));
  p.values = values.data(), p.guide = guide.data(), p.mask = pointer_or_null(mask);
  p.v_values = pointer_or_null(v_values);
  nb::gil_scoped_release release;
  const TvSums sums = choice()->tv(p);
  return {sums.total, sums.pairs};
}

// intrinsics: fx, fy, cx, cy. world_from_cam: rotation, row-major.
DepthNormalsParams normals_params(const Plane<const float>& depth, const Plane<const float>& alpha,
                                  const std::tuple<float, float, float, float>& intrinsics,
                                  const std::vector<float>& world_from_cam) {
  expect_same_size(depth, alpha, "alpha: expected the depth's size");
  expect(world_from_cam.size() == 9, "world_from_cam: expected the 9 numbers of a rotation");
  DepthNormalsParams p;
  p.height = int(depth.shape(0)), p.width = int(depth.shape(1));
  p.depth = depth.data(), p.alpha = pointer_or_null(alpha);
  std::tie(p.fx, p.fy, p.cx, p.cy) = intrinsics;
  for (size_t i = 0; i < 9; ++i) p.world_from_cam[i] = world_from_cam[i];
  return p;
}

void depth_normals(const Plane<const float>& depth, const Plane<const float>& alpha,
                   const std::tuple<float, float, float, float>& intrinsics, const std::vector<float>& world_from_cam,
                   const Rgb<float>& normals) {
  DepthNormalsParams p = normals_params(depth, alpha, intrinsics, world_from_cam);
  expect_same_size(depth, normals, "normals: expected the depth's size");
  p.normals = normals.data();
  nb::gil_scoped_release release;
  choice()->depth_normals(p);
}

void depth_normals_vjp(const Plane<const float>& depth, const Plane<const float>& alpha,
                       const std::tuple<float, float, float, float>& intrinsics,
                       const std::vector<float>& world_from_cam, const Rgb<const float>& v_normals,
                       const Plane<float>& v_depth) {
  DepthNormalsParams p = normals_params(depth, alpha, intrinsics, world_from_cam);
  expect_same_size(depth, v_normals, "v_normals: expected the depth's size");
  expect_same_size(depth, v_depth, "v_depth: expected the depth's size");
  p.v_normals = v_normals.data(), p.v_depth = v_depth.data();
  nb::gil_scoped_release release;
  choice()->depth_normals_vjp(p);
}

// The maths in float64, one case at a time, for its tests: each returns the value and writes the derivatives.

// The value by ssim and by ssim_vjp.
std::pair<double, double> ssim_double(const ConstVector& moments, const Vector& v_moments) {
  expect(moments.shape(0) == 4 && v_moments.shape(0) == 4, "moments, v_moments: expected 4 numbers");
  const double* at = moments.data();
  const SsimMoments<double> m = {at[0], at[1], at[2], at[3]};
  SsimMoments<double> v;
  const double value = ssim_vjp<double>(m, 1.0, v);
  const double parts[4] = {v.a, v.b, v.squares, v.product};
  for (int i = 0; i < 4; ++i) v_moments.data()[i] = parts[i];
  return {ssim(m), value};
}

std::tuple<double, double, double> tv_double(double difference, double guide_difference) {
  const double weight = tv_weight(guide_difference);
  return {weight, tv_pair(difference, weight), tv_pair_vjp(difference, weight)};
}

// depths: left, right, up, down. ray: fx, fy, rx, ry. normal is written; v_depths too, for v_normal.
void depth_normal_double(const ConstVector& depths, const ConstVector& ray, const ConstVector& v_normal,
                         const Vector& normal, const Vector& v_depths) {
  expect(depths.shape(0) == 4 && ray.shape(0) == 4 && v_depths.shape(0) == 4, "depths, ray, v_depths: expected 4 numbers");
  expect(v_normal.shape(0) == 3 && normal.shape(0) == 3, "v_normal, normal: expected 3 numbers");
  const double *d = depths.data(), *r = ray.data();
  depth_normal<double>({d[0], d[1], d[2], d[3]}, {r[0], r[1], r[2], r[3]}, normal.data());
  const auto v = depth_normal_vjp<double>({d[0], d[1], d[2], d[3]}, {r[0], r[1], r[2], r[3]}, v_normal.data());
  const double parts[4] = {v.left, v.right, v.up, v.down};
  for (int i = 0; i < 4; ++i) v_depths.data()[i] = parts[i];
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_image, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("image_loss", &image_loss, nb::arg("image"), nb::arg("target"), nb::arg("l1_weight"), nb::arg("clip"),
        nb::arg("mask").none(), nb::arg("region"), nb::arg("v_image").none(), nb::arg("v_target").none());
  m.def("tv", &tv, nb::arg("values"), nb::arg("guide"), nb::arg("mask").none(), nb::arg("v_values").none());
  m.def("depth_normals", &depth_normals, nb::arg("depth"), nb::arg("alpha").none(), nb::arg("intrinsics"),
        nb::arg("world_from_cam"), nb::arg("normals"));
  m.def("depth_normals_vjp", &depth_normals_vjp, nb::arg("depth"), nb::arg("alpha").none(), nb::arg("intrinsics"),
        nb::arg("world_from_cam"), nb::arg("v_normals"), nb::arg("v_depth"));
  m.def("ssim_double", &ssim_double, nb::arg("moments"), nb::arg("v_moments"));
  m.def("tv_double", &tv_double, nb::arg("difference"), nb::arg("guide_difference"));
  m.def("depth_normal_double", &depth_normal_double, nb::arg("depths"), nb::arg("ray"), nb::arg("v_normal"),
        nb::arg("normal"), nb::arg("v_depths"));
}
