// Python module mgsr.native._harmonics.
#include "bindings/arrays.h"
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

template <class T>
void check(const Coeffs<const T>& coeffs, const Triples<const T>& means, int degree) {
  expect(coeffs.shape(0) == means.shape(0), "coeffs and means: expected the same number of splats");
  expect(degree >= 0 && degree <= 3 && size_t((degree + 1) * (degree + 1)) <= coeffs.shape(1) && coeffs.shape(1) <= 16,
         "degree: expected 0 to 3, with (degree + 1)^2 coefficients at least and 16 at most");
}

HarmonicsParams params(const Coeffs<const float>& coeffs, const Triples<const float>& means,
                       const Triple<const float>& center, int degree) {
  check(coeffs, means, degree);
  HarmonicsParams p;
  p.n = int64_t(coeffs.shape(0)), p.k = int(coeffs.shape(1)), p.degree = degree;
  p.coeffs = coeffs.data(), p.means = means.data();
  for (int c = 0; c < 3; ++c) p.center[c] = center.data()[c];
  return p;
}

void forward(const Coeffs<const float>& coeffs, const Triples<const float>& means, const Triple<const float>& center,
             int degree, const Triples<float>& rgb) {
  HarmonicsParams p = params(coeffs, means, center, degree);
  expect(rgb.shape(0) == coeffs.shape(0), "rgb: expected one row per splat");
  p.rgb = rgb.data();
  nb::gil_scoped_release release;
  choice()->forward(p);
}

void backward(const Coeffs<const float>& coeffs, const Triples<const float>& means, const Triple<const float>& center,
              int degree, const Triples<float>& rgb, const Triples<const float>& v_rgb, const Coeffs<float>& v_coeffs,
              const Triples<float>& v_means) {
  HarmonicsParams p = params(coeffs, means, center, degree);
  const size_t n = coeffs.shape(0);
  expect(rgb.shape(0) == n && v_rgb.shape(0) == n && v_coeffs.shape(0) == n && v_coeffs.shape(1) == coeffs.shape(1),
         "rgb, v_rgb, v_coeffs: expected one row per splat");
  expect(!v_means.is_valid() || v_means.shape(0) == n, "v_means: expected one row per splat");
  p.rgb = rgb.data(), p.v_rgb = v_rgb.data(), p.v_coeffs = v_coeffs.data(), p.v_means = pointer_or_null(v_means);
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

void harmonics_double(const Coeffs<const double>& coeffs, const Triples<const double>& means,
                      const Triple<const double>& center, int degree, const Triples<double>& rgb,
                      const Triples<const double>& v_rgb, const Coeffs<double>& v_coeffs,
                      const Triples<double>& v_means) {
  check(coeffs, means, degree);
  constexpr decltype(&splat_double<0>) splats[4] = {splat_double<0>, splat_double<1>, splat_double<2>, splat_double<3>};
  const size_t row = coeffs.shape(1) * 3;
  const bool with_vjp = v_rgb.is_valid();
  for (size_t i = 0; i < coeffs.shape(0); ++i)
    splats[degree](coeffs.data() + i * row, means.data() + 3 * i, center.data(), rgb.data() + 3 * i,
                   with_vjp ? v_rgb.data() + 3 * i : nullptr, with_vjp ? v_coeffs.data() + i * row : nullptr,
                   with_vjp ? v_means.data() + 3 * i : nullptr);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_harmonics, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("forward", &forward, nb::arg("coeffs"), nb::arg("means"), nb::arg("center"), nb::arg("degree"), nb::arg("rgb"));
  m.def("backward", &backward, nb::arg("coeffs"), nb::arg("means"), nb::arg("center"), nb::arg("degree"),
        nb::arg("rgb"), nb::arg("v_rgb"), nb::arg("v_coeffs"), nb::arg("v_means").none());
  m.def("harmonics_double", &harmonics_double, nb::arg("coeffs"), nb::arg("means"), nb::arg("center"),
        nb::arg("degree"), nb::arg("rgb"), nb::arg("v_rgb").none(), nb::arg("v_coeffs").none(),
        nb::arg("v_means").none());
}
