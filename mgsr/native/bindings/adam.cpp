// Python module mgsr.native._adam.
#include <cmath>
#include <tuple>

#include "bindings/fields.h"
#include "kernels/adam/adam.h"

namespace mgsr {
namespace {

IsaChoice<AdamTable>& choice() {
  static IsaChoice<AdamTable> current(MGSR_TABLES(adam_table));
  return current;
}

using Matrix = Array<float, nb::ndim<2>>;
using ConstMatrix = Array<const float, nb::ndim<2>>;
using ConstRow = Array<const float, nb::ndim<1>>;

// Groups that Python collects, and that one call then updates.
class AdamBatch {
 public:
  AdamBatch(float beta1, float beta2, float epsilon) : beta1_(beta1), beta2_(beta2), epsilon_(epsilon) {}

  // step: number of this update, counted from 1.
  void add(nb::handle parameter, nb::handle gradients, double rate, int64_t step) {
    const Fields fields(parameter, "parameter");
    const auto values = fields.array<Matrix>("values");
    const auto first = fields.array<Matrix>("first"), second = fields.array<Matrix>("second");
    const auto column_scales = fields.array_or_none<ConstRow>("column_scales");
    const auto of_gradients = read<ConstMatrix>(gradients, "gradients");
    const size_t rows = values.shape(0), columns = values.shape(1);
    const auto fits = [&](const auto& a) { return a.shape(0) == rows && a.shape(1) == columns; };
    expect(fits(of_gradients) && fits(first) && fits(second), "gradients, moments: expected the parameter's shape");
    expect(!column_scales.is_valid() || column_scales.shape(0) == columns, "column_scales: expected one per column");
    expect(step >= 1, "step: expected a count from 1");
    AdamGroup g;
    g.rows = int64_t(rows), g.columns = int(columns);
    g.values = values.data(), g.gradients = of_gradients.data(), g.first = first.data(), g.second = second.data();
    g.column_scales = pointer_or_null(column_scales);
    g.rate = float(rate / (1 - std::pow(double(beta1_), double(step))));
    g.step = {beta1_, beta2_, epsilon_, float(1 / std::sqrt(1 - std::pow(double(beta2_), double(step))))};
    groups_.push_back(g);
  }

  void update() {
    {
      nb::gil_scoped_release release;
      choice()->update(groups_.data(), int(groups_.size()));
    }
    groups_.clear();
  }

 private:
  float beta1_, beta2_, epsilon_;
  std::vector<AdamGroup> groups_;
};

// Applies the same templates to one number in float64, for the tests of the maths. step: beta1, beta2, epsilon and
// root_scale of AdamStep. Returns the new value, first and second moment.
std::tuple<double, double, double> adam_double(double value, double gradient, double first, double second, double rate,
                                               const std::tuple<float, float, float, float>& step) {
  const auto [beta1, beta2, epsilon, root_scale] = step;
  const AdamStep s = {beta1, beta2, epsilon, root_scale};
  adam_moments(s, gradient, first, second);
  return {value - adam_change(s, rate, first, std::sqrt(second)), first, second};
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_adam, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  nb::class_<AdamBatch>(m, "AdamBatch")
      .def(nb::init<float, float, float>(), nb::arg("beta1"), nb::arg("beta2"), nb::arg("epsilon"))
      .def("add", &AdamBatch::add, nb::arg("parameter"), nb::arg("gradients"), nb::arg("rate"), nb::arg("step"),
           "The arrays must stay alive until update returns.")
      .def("update", &AdamBatch::update);
  m.def("adam_double", &adam_double, nb::arg("value"), nb::arg("gradient"), nb::arg("first"), nb::arg("second"),
        nb::arg("rate"), nb::arg("step"));
}
