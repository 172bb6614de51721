// Python module mgsr.native._fusion.
#include <algorithm>

#include "bindings/fields.h"
#include "kernels/fusion/fusion.h"

namespace mgsr {
namespace {

IsaChoice<FusionTable>& choice() {
  static IsaChoice<FusionTable> current(MGSR_TABLES(fusion_table));
  return current;
}

using Map = Array<const float, nb::ndim<2>>;
// fx, fy, cx, cy, then the rotation and the translation of the pose, world to camera.
using Cameras = Array<const double, nb::shape<-1, 16>>;
template <class T>
using Grid = Array<T, nb::ndim<3>>;

VotingView view_of(const Map& depth, const Map& weights, const double* camera) {
  expect(depth.shape(0) == weights.shape(0) && depth.shape(1) == weights.shape(1), "weights: expected the depths' size");
  VotingView view;
  view.height = int(depth.shape(0)), view.width = int(depth.shape(1));
  view.depth = depth.data(), view.weights = weights.data();
  view.fx = camera[0], view.fy = camera[1], view.cx = camera[2], view.cy = camera[3];
  std::copy(camera + 4, camera + 13, view.rotation);
  std::copy(camera + 13, camera + 16, view.translation);
  return view;
}

void vote(nb::handle points, nb::handle maps, double reach, float solid_weight, float solid_depth, nb::handle votes) {
  const Fields fields(maps, "maps");
  const auto cameras = fields.array<Cameras>("cameras");
  const auto depths = fields.arrays<Map>("depths"), weights = fields.arrays<Map>("weights");
  const auto of_points = read<Array<const double, nb::shape<-1, 3>>>(points, "points");
  const auto to_votes = read<Array<float, nb::ndim<2>>>(votes, "votes");
  expect(cameras.shape(0) == depths.size() && depths.size() == weights.size(),
         "depths, weights: expected one for each camera");
  expect(reach > 0 && solid_depth >= 1, "reach, solid_depth: expected more than 0, and 1 or more");
  expect(to_votes.shape(0) == of_points.shape(0) && to_votes.shape(1) > 0,
         "votes: expected a histogram for each point");
  VotingParams p;
  for (size_t i = 0; i < depths.size(); ++i)
    p.views.push_back(view_of(depths[i], weights[i], cameras.data() + 16 * i));
  p.count = int64_t(of_points.shape(0)), p.points = of_points.data(), p.reach = reach;
  p.solid_weight = solid_weight, p.solid_depth = solid_depth;
  p.bins = int(to_votes.shape(1)), p.votes = to_votes.data();
  nb::gil_scoped_release release;
  choice()->vote(p);
}

void regularise(nb::handle votes, nb::handle voxels, nb::handle most, float strength, int rounds, nb::handle field) {
  const auto of_votes = read<Array<const float, nb::ndim<2>>>(votes, "votes");
  const auto of_voxels = read<Array<const int64_t, nb::ndim<1>>>(voxels, "voxels");
  const auto of_most = read<Grid<const float>>(most, "most");
  const auto to_field = read<Grid<float>>(field, "field");
  FusionParams p;
  for (size_t axis = 0; axis < 3; ++axis) {
    expect(of_most.shape(axis) == to_field.shape(axis), "most: expected the field's size");
    p.shape[axis] = int64_t(to_field.shape(axis));
  }
  expect(of_votes.shape(0) == of_voxels.shape(0) && of_votes.shape(1) > 0,
         "votes: expected a histogram for each voxel");
  expect(strength > 0 && rounds >= 0, "strength, rounds: expected more than 0, and 0 or more");
  p.count = int64_t(of_voxels.shape(0)), p.voxels = of_voxels.data();
  p.bins = int(of_votes.shape(1)), p.votes = of_votes.data();
  bool inside = true;
  for (int64_t i = 0; i < p.count; ++i) inside &= uint64_t(p.voxels[i]) < uint64_t(to_field.size());
  expect(inside, "voxels: expected numbers of voxels inside the grid");
  p.most = of_most.data(), p.strength = strength, p.rounds = rounds, p.field = to_field.data();
  nb::gil_scoped_release release;
  choice()->regularise(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_fusion, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("vote", &vote, nb::arg("points"), nb::arg("maps"), nb::arg("reach"), nb::arg("solid_weight"),
        nb::arg("solid_depth"), nb::arg("votes"));
  m.def("regularise", &regularise, nb::arg("votes"), nb::arg("voxels"), nb::arg("most"), nb::arg("strength"),
        nb::arg("rounds"), nb::arg("field"));
}
