// Python module mgsr.native._fusion.
#include "bindings/arrays.h"
#include "kernels/fusion/fusion.h"

namespace mgsr {
namespace {

IsaChoice<FusionTable>& choice() {
  static IsaChoice<FusionTable> current(MGSR_TABLES(fusion_table));
  return current;
}

template <class T>
using Grid = Array<T, nb::ndim<3>>;

void regularise(const Array<const float, nb::ndim<2>>& votes, const Array<const int64_t, nb::ndim<1>>& voxels,
                const Grid<const float>& most, float strength, int rounds, const Grid<float>& field) {
  FusionParams p;
  for (size_t axis = 0; axis < 3; ++axis) {
    expect(most.shape(axis) == field.shape(axis), "most: expected the field's size");
    p.shape[axis] = int64_t(field.shape(axis));
  }
  expect(votes.shape(0) == voxels.shape(0) && votes.shape(1) > 0, "votes: expected a histogram for each voxel");
  expect(strength > 0 && rounds >= 0, "strength, rounds: expected more than 0, and 0 or more");
  p.count = int64_t(voxels.shape(0)), p.voxels = voxels.data(), p.bins = int(votes.shape(1)), p.votes = votes.data();
  bool inside = true;
  for (int64_t i = 0; i < p.count; ++i) inside &= uint64_t(p.voxels[i]) < uint64_t(field.size());
  expect(inside, "voxels: expected numbers of voxels inside the grid");
  p.most = most.data(), p.strength = strength, p.rounds = rounds, p.field = field.data();
  nb::gil_scoped_release release;
  choice()->regularise(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_fusion, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("regularise", &regularise, nb::arg("votes"), nb::arg("voxels"), nb::arg("most"), nb::arg("strength"),
        nb::arg("rounds"), nb::arg("field").noconvert());
}
