// Python module mgsr.native._mirrored.
#include "bindings/fields.h"
#include "kernels/mirrored/mirrored.h"

namespace mgsr {
namespace {

IsaChoice<MirroredTable>& choice() {
  static IsaChoice<MirroredTable> current(MGSR_TABLES(mirrored_table));
  return current;
}

using Row = Array<const float, nb::ndim<1>>;
using Rows = Array<const float, nb::ndim<2>>;
using Cube = Array<const float, nb::ndim<3>>;

void tilt_costs(nb::handle observations, nb::handle table, nb::handle frames, nb::handle tilts, float outlier,
                nb::handle costs) {
  const Fields fields(observations, "observations");
  const auto weights = fields.array<Rows>("weights");
  const auto light = read<Cube>(table, "table");
  const auto of_points = read<Array<const float, nb::shape<-1, 3, 3>>>(frames, "frames");
  const auto angles = read<Row>(tilts, "tilts");
  const auto to_costs = read<Array<float, nb::ndim<3>>>(costs, "costs");
  expect(outlier > 0, "outlier: expected more than 0");
  expect(light.shape(0) > 0 && light.shape(0) == light.shape(1) && light.shape(0) == light.shape(2) &&
             light.shape(0) <= 1024,
         "table: expected a cube of at most 1024 cells a side");
  expect(of_points.shape(0) == weights.shape(0), "frames: expected one for each point");
  expect(to_costs.shape(0) == weights.shape(0) && to_costs.shape(1) == angles.shape(0) &&
             to_costs.shape(2) == angles.shape(0),
         "costs: expected a grid of all tilts for each point");
  TiltParams p;
  p.points = int64_t(weights.shape(0)), p.views = int64_t(weights.shape(1)), p.weights = weights.data();
  p.view_directions = fields.data<const float>("view_directions", 3 * p.points * p.views);
  p.brightness = fields.data<const float>("brightness", p.points * p.views);
  p.frames = of_points.data(), p.cells = int(light.shape(0)), p.table = light.data();
  p.tilts = int64_t(angles.shape(0)), p.tangents = angles.data(), p.outlier = outlier, p.costs = to_costs.data();
  nb::gil_scoped_release release;
  choice()->tilt_costs(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_mirrored, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("tilt_costs", &tilt_costs, nb::arg("observations"), nb::arg("table"), nb::arg("frames"), nb::arg("tilts"),
        nb::arg("outlier"), nb::arg("costs"));
}
