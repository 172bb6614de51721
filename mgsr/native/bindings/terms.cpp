// Python module mgsr.native._terms.
#include <vector>

#include "bindings/fields.h"
#include "bindings/sizes.h"
#include "kernels/terms/terms.h"

namespace mgsr {
namespace {

IsaChoice<TermsTable>& choice() {
  static IsaChoice<TermsTable> current(MGSR_TABLES(terms_table));
  return current;
}

template <class T>
using Plane = Array<T, nb::ndim<2>>;
template <class T>
using Rgb = Array<T, nb::shape<-1, -1, 3>>;
template <class T>
using Maps = Array<T, nb::ndim<4>>;
template <class T>
using Any = Array<T>;

// Requires that b, if it is given, has as many numbers as a.
template <class A, class B>
void expect_same_count(const A& a, const B& b, const char* message) {
  expect(!b.is_valid() || a.size() == b.size(), message);
}

void composite(nb::handle photograph, nb::handle background, nb::handle out) {
  const Fields given(photograph, "photograph"), fields(out, "out");
  const auto image = given.array<Rgb<const uint8_t>>("image");
  const auto mask = given.array<Plane<const uint8_t>>("mask");
  const auto off_edge = given.array_or_none<Plane<const bool>>("off_edge");
  const auto behind = read<Array<const float, nb::shape<3>>>(background, "background");
  const auto color = fields.array<Rgb<float>>("color");
  const auto alpha = fields.array<Plane<float>>("alpha");
  const auto weights = fields.array_or_none<Plane<float>>("weights");
  expect_same_size(image, mask, "mask: expected the image's size");
  expect_same_size(image, off_edge, "off_edge: expected the image's size");
  expect_same_size(image, color, "color: expected the image's size");
  expect_same_size(image, alpha, "alpha: expected the image's size");
  expect_same_size(image, weights, "weights: expected the image's size");
  expect(off_edge.is_valid() == weights.is_valid(), "weights: expected exactly if off_edge is given");
  TargetParams p;
  p.pixels = int64_t(mask.size()), p.image = image.data(), p.mask = mask.data(), p.off_edge = pointer_or_null(off_edge);
  p.background = behind.data(), p.color = color.data(), p.alpha = alpha.data(), p.weights = pointer_or_null(weights);
  nb::gil_scoped_release release;
  choice()->target(p);
}

void covered(nb::handle alpha, nb::handle mask, nb::handle covered) {
  const auto own = read<Plane<const float>>(alpha, "alpha");
  const auto other = read_or_none<Plane<const float>>(mask, "mask");
  const auto to_covered = read<Plane<float>>(covered, "covered");
  expect_same_size(own, other, "mask: expected alpha's size");
  expect_same_size(own, to_covered, "covered: expected alpha's size");
  CoveredParams p;
  p.pixels = int64_t(own.size()), p.alpha = own.data(), p.mask = pointer_or_null(other), p.covered = to_covered.data();
  nb::gil_scoped_release release;
  choice()->covered(p);
}

double silhouette(nb::handle alpha, nb::handle mask, nb::handle weights, bool entropy, nb::handle v_alpha) {
  const auto own = read<Plane<const float>>(alpha, "alpha"), other = read<Plane<const float>>(mask, "mask");
  const auto by = read_or_none<Plane<const float>>(weights, "weights");
  const auto to_alpha = read_or_none<Plane<float>>(v_alpha, "v_alpha");
  expect_same_size(own, other, "mask: expected alpha's size");
  expect_same_size(own, by, "weights: expected alpha's size");
  expect_same_size(own, to_alpha, "v_alpha: expected alpha's size");
  SilhouetteParams p;
  p.pixels = int64_t(own.size()), p.alpha = own.data(), p.mask = other.data(), p.weights = pointer_or_null(by);
  p.entropy = entropy, p.v_alpha = pointer_or_null(to_alpha);
  nb::gil_scoped_release release;
  return choice()->silhouette(p);
}

double squares(nb::handle difference, nb::handle differences) {
  const Fields fields(difference, "difference");
  const auto a = fields.array<Any<const float>>("a");
  const auto b = fields.array_or_none<Any<const float>>("b");
  const auto first = fields.array_or_none<Any<const float>>("first");
  const auto second = fields.array_or_none<Any<const float>>("second");
  const auto to_differences = read<Any<float>>(differences, "differences");
  expect_same_count(a, b, "b: expected the shape of a");
  expect_same_count(a, first, "first: expected the shape of a");
  expect_same_count(a, second, "second: expected the shape of a");
  expect_same_count(a, to_differences, "differences: expected the shape of a");
  SquaresParams p;
  p.count = int64_t(a.size()), p.a = a.data(), p.b = pointer_or_null(b), p.first = pointer_or_null(first);
  p.second = pointer_or_null(second), p.offset = fields.value<float>("offset"), p.differences = to_differences.data();
  nb::gil_scoped_release release;
  return choice()->squares(p);
}

double product(nb::handle weight, nb::handle color, nb::handle v_weight) {
  const auto factor = read<Plane<const float>>(weight, "weight");
  const auto image = read<Rgb<const float>>(color, "color");
  const auto to_weight = read<Plane<float>>(v_weight, "v_weight");
  expect_same_size(factor, image, "color: expected the size of weight");
  expect_same_size(factor, to_weight, "v_weight: expected the size of weight");
  ProductParams p;
  p.pixels = int64_t(factor.size()), p.weight = factor.data(), p.color = image.data(), p.v_weight = to_weight.data();
  nb::gil_scoped_release release;
  return choice()->product(p);
}

double steps(nb::handle maps, nb::handle v_maps) {
  const auto values = read<Maps<const float>>(maps, "maps");
  const auto to_maps = read<Maps<float>>(v_maps, "v_maps");
  expect(values.shape(1) == values.shape(2), "maps: expected squares");
  for (size_t i = 0; i < 4; ++i) expect(to_maps.shape(i) == values.shape(i), "v_maps: expected the shape of maps");
  StepsParams p;
  p.maps = int(values.shape(0)), p.side = int(values.shape(1)), p.channels = int(values.shape(3));
  p.values = values.data(), p.v_values = to_maps.data();
  nb::gil_scoped_release release;
  return choice()->steps(p);
}

void gradient(const std::vector<nb::object>& slopes, const std::vector<float>& scales, nb::handle out) {
  const auto image = read<Any<float>>(out, "out");
  expect(slopes.size() == scales.size(), "scales: expected one for each of the slopes");
  std::vector<GradientPart> parts;
  for (size_t k = 0; k < slopes.size(); ++k) {
    const auto of_term = read<Any<const float>>(slopes[k], "slopes");
    bool same = of_term.ndim() == image.ndim(), all_channels = of_term.ndim() + 1 == image.ndim();
    for (size_t i = 0; i < of_term.ndim() && (same || all_channels); ++i)
      if (of_term.shape(i) != image.shape(i)) same = all_channels = false;
    expect(same || all_channels, "slopes: expected the shape of out, or that of its pixels");
    expect(same || image.shape(image.ndim() - 1) <= kMostChannels, "out: expected 16 channels at most");
    parts.push_back({of_term.data(), all_channels, scales[k]});
  }
  GradientParams p;
  const size_t channels = image.ndim() > 1 ? image.shape(image.ndim() - 1) : 1;
  p.channels = int(channels), p.pixels = channels ? int64_t(image.size() / channels) : 0;
  p.parts = parts.data(), p.count = int(parts.size()), p.out = image.data();
  nb::gil_scoped_release release;
  choice()->gradient(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_terms, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("composite", &composite, nb::arg("photograph"), nb::arg("background"), nb::arg("out"));
  m.def("covered", &covered, nb::arg("alpha"), nb::arg("mask").none(), nb::arg("covered"));
  m.def("silhouette", &silhouette, nb::arg("alpha"), nb::arg("mask"), nb::arg("weights").none(), nb::arg("entropy"),
        nb::arg("v_alpha").none());
  m.def("squares", &squares, nb::arg("difference"), nb::arg("differences"));
  m.def("product", &product, nb::arg("weight"), nb::arg("color"), nb::arg("v_weight"));
  m.def("steps", &steps, nb::arg("maps"), nb::arg("v_maps"));
  m.def("gradient", &gradient, nb::arg("slopes"), nb::arg("scales"), nb::arg("out"));
}
