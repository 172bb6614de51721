// Python module mgsr.native._harmonics.
#include <algorithm>

#include "bindings/fields.h"
#include "kernels/harmonics/harmonics.h"
#include "math/harmonics.h"

namespace mgsr {
namespace {

IsaChoice<HarmonicsTable>& choice() {
  static IsaChoice<HarmonicsTable> current(MGSR_TABLES(harmonics_table));
  return current;
}

template <class T>
using Coeffs = Array<T, nb::shape<-1, -1, 3>>;
template <class T>
using Triples = Array<T, nb::shape<-1, 3>>;
template <class T>
using Triple = Array<T, nb::shape<3>>;

// The struct Harmonics of structs.py, with numbers of type T.
template <class T>
struct Arguments {
  explicit Arguments(const Fields& fields)
      : coeffs(fields.array<Coeffs<const T>>("coeffs")),
        means(fields.array<Triples<const T>>("means")),
        center(fields.array<Triple<const T>>("center")),
        degree(fields.value<int>("degree")) {
    expect(coeffs.shape(0) == means.shape(0), "coeffs and means: expected the same number of splats");
    expect(degree >= 0 && degree <= 3 && size_t((degree + 1) * (degree + 1)) <= coeffs.shape(1) && coeffs.shape(1) <= 16,
           "degree: expected 0 to 3, with (degree + 1)^2 coefficients at least and 16 at most");
  }

  Coeffs<const T> coeffs;
  Triples<const T> means;
  Triple<const T> center;
  int degree;
};

HarmonicsParams params_of(const Arguments<float>& a) {
  HarmonicsParams p;
  p.n = int64_t(a.coeffs.shape(0)), p.k = int(a.coeffs.shape(1)), p.degree = a.degree;
  p.coeffs = a.coeffs.data(), p.means = a.means.data();
  std::copy(a.center.data(), a.center.data() + 3, p.center);
  return p;
}

void forward(nb::handle splats, nb::handle rgb) {
  const Arguments<float> a(Fields(splats, "splats"));
  const auto to_rgb = read<Triples<float>>(rgb, "rgb");
  HarmonicsParams p = params_of(a);
  expect(int64_t(to_rgb.shape(0)) == p.n, "rgb: expected one row per splat");
  p.rgb = to_rgb.data();
  nb::gil_scoped_release release;
  choice()->forward(p);
}

void backward(nb::handle splats, nb::handle rgb, nb::handle v_rgb, nb::handle v_coeffs, nb::handle v_means) {
  const Arguments<float> a(Fields(splats, "splats"));
  const auto of_rgb = read<Triples<float>>(rgb, "rgb");
  const auto from_rgb = read<Triples<const float>>(v_rgb, "v_rgb");
  const auto to_coeffs = read<Coeffs<float>>(v_coeffs, "v_coeffs");
  const auto to_means = read_or_none<Triples<float>>(v_means, "v_means");
  HarmonicsParams p = params_of(a);
  const size_t n = a.coeffs.shape(0);
  expect(of_rgb.shape(0) == n && from_rgb.shape(0) == n && to_coeffs.shape(0) == n &&
             to_coeffs.shape(1) == a.coeffs.shape(1),
         "rgb, v_rgb, v_coeffs: expected one row per splat");
  expect(!to_means.is_valid() || to_means.shape(0) == n, "v_means: expected one row per splat");
  p.rgb = of_rgb.data(), p.v_rgb = from_rgb.data(), p.v_coeffs = to_coeffs.data(), p.v_means = pointer_or_null(to_means);
  nb::gil_scoped_release release;
  choice()->backward(p);
}

// One splat after another through the same templates in float64, for the tests of the maths.
template <int D>
void splat_double(const double* coeffs, const double* mean, const double* center, double* rgb, const double* v_rgb,
                  double* v_coeffs, double* v_mean) {
  double u[3] = {mean[0] - center[0], mean[1] - center[1], mean[2] - center[2]}, v_u[3] = {};
  const double inverse = inverse_length(u[0], u[1], u[2]);
  for (double& x : u) x *= inverse;
  harmonics_to_rgb<D>(coeffs, u, rgb);
  if (!v_rgb) return;
  harmonics_to_rgb_vjp<D>(coeffs, u, rgb, v_rgb, v_coeffs, v_u);
  unit_vector_vjp(u, inverse, v_u, v_mean);
}

void harmonics_double(nb::handle splats, nb::handle rgb, nb::handle v_rgb, nb::handle v_coeffs, nb::handle v_means) {
  const Arguments<double> a(Fields(splats, "splats"));
  const auto to_rgb = read<Triples<double>>(rgb, "rgb");
  const auto from_rgb = read_or_none<Triples<const double>>(v_rgb, "v_rgb");
  const auto to_coeffs = read_or_none<Coeffs<double>>(v_coeffs, "v_coeffs");
  const auto to_means = read_or_none<Triples<double>>(v_means, "v_means");
  constexpr decltype(&splat_double<0>) splats_of[4] = {splat_double<0>, splat_double<1>, splat_double<2>, splat_double<3>};
  const size_t row = a.coeffs.shape(1) * 3;
  const bool with_vjp = from_rgb.is_valid();
  for (size_t i = 0; i < a.coeffs.shape(0); ++i)
    splats_of[a.degree](a.coeffs.data() + i * row, a.means.data() + 3 * i, a.center.data(), to_rgb.data() + 3 * i,
                        with_vjp ? from_rgb.data() + 3 * i : nullptr, with_vjp ? to_coeffs.data() + i * row : nullptr,
                        with_vjp ? to_means.data() + 3 * i : nullptr);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_harmonics, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("forward", &forward, nb::arg("splats"), nb::arg("rgb"));
  m.def("backward", &backward, nb::arg("splats"), nb::arg("rgb"), nb::arg("v_rgb"), nb::arg("v_coeffs"),
        nb::arg("v_means").none());
  m.def("harmonics_double", &harmonics_double, nb::arg("splats"), nb::arg("rgb"), nb::arg("v_rgb").none(),
        nb::arg("v_coeffs").none(), nb::arg("v_means").none());
}
