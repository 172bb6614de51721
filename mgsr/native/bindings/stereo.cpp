// Python module mgsr.native._stereo.
#include <algorithm>
#include <utility>

#include "bindings/fields.h"
#include "kernels/stereo/stereo.h"

namespace mgsr {
namespace {

IsaChoice<StereoTable>& choice() {
  static IsaChoice<StereoTable> current(MGSR_TABLES(stereo_table));
  return current;
}

using Pixels = Array<const float, nb::shape<-1, -1, 4>>;
template <class T>
using Grey = Array<T, nb::shape<-1, -1>>;
template <class T>
using Vectors = Array<T, nb::shape<-1, -1, 3>>;
// fx, fy, cx, cy, then the rotation and the translation of the pose, world to camera.
using Cameras = Array<const float, nb::shape<-1, 16>>;

StereoView view_of(const Pixels& pixels, const float* camera) {
  StereoView view;
  view.pixels = pixels.data(), view.height = int(pixels.shape(0)), view.width = int(pixels.shape(1));
  view.fx = camera[0], view.fy = camera[1], view.cx = camera[2], view.cy = camera[3];
  std::copy(camera + 4, camera + 13, view.rotation);
  std::copy(camera + 13, camera + 16, view.translation);
  return view;
}

StereoSettings settings_of(const Fields& fields) {
  StereoSettings s;
  s.radius = fields.value<int>("radius"), s.spacing = fields.value<float>("spacing");
  s.noise = fields.value<float>("noise"), s.alike = fields.value<float>("alike");
  s.reach = fields.value<float>("reach"), s.best = fields.value<int>("best"), s.cover = fields.value<float>("cover");
  s.prior = fields.value<float>("prior"), s.prior_reach = fields.value<float>("prior_reach");
  s.search = fields.value<float>("search"), s.rounds = fields.value<int>("rounds");
  expect(s.radius >= 0 && s.radius <= 4 && s.best >= 1,
         "settings: expected a radius of 0 to 4, and a best of 1 at least");
  return s;
}

template <class A>
void expect_size(const A& array, const StereoView& view) {
  expect(int(array.shape(0)) == view.height && int(array.shape(1)) == view.width, "expected images of the view's size");
}

// The struct StereoPlanes: the depth and the normal at each pixel of a view.
template <class T>
std::pair<T*, T*> planes_of(const Fields& fields, const StereoView& view) {
  const auto depth = fields.array<Grey<T>>("depth");
  const auto normal = fields.array<Vectors<T>>("normal");
  expect_size(depth, view), expect_size(normal, view);
  return {depth.data(), normal.data()};
}

float* score_of(nb::handle score, const StereoView& view) {
  const auto array = read<Grey<float>>(score, "score");
  expect_size(array, view);
  return array.data();
}

StereoParams params_of(const Fields& views, const Fields& start, const Fields& settings) {
  const auto images = views.arrays<Pixels>("images");
  const auto cameras = views.array<Cameras>("cameras");
  const auto view = views.value<size_t>("view");
  expect(cameras.shape(0) == images.size(), "cameras: expected one for each image");
  expect(view < images.size(), "view: expected an image's number");
  StereoParams p;
  p.settings = settings_of(settings);
  p.view = view_of(images[view], cameras.data() + 16 * view);
  for (const auto other : views.value<std::vector<size_t>>("neighbours")) {
    expect(other < images.size() && other != view, "neighbours: expected other images' numbers");
    p.neighbours.push_back(view_of(images[other], cameras.data() + 16 * other));
  }
  std::tie(p.start_depth, p.start_normal) = planes_of<const float>(start, p.view);
  std::tie(p.nearest, p.farthest) = views.value<std::tuple<float, float>>("range");
  expect(p.nearest > 0 && p.farthest > p.nearest, "range: expected 0 < nearest < farthest");
  return p;
}

void search(nb::handle views, nb::handle start, nb::handle settings, uint32_t seed, nb::handle found, nb::handle score) {
  const Fields of_views(views, "views"), of_start(start, "start"), of_found(found, "found");
  StereoParams p = params_of(of_views, of_start, Fields(settings, "settings"));
  std::tie(p.depth, p.normal) = planes_of<float>(of_found, p.view);
  p.seed = seed, p.score = score_of(score, p.view);
  nb::gil_scoped_release release;
  choice()->search(p);
}

void judge(nb::handle views, nb::handle planes, nb::handle settings, nb::handle score) {
  const Fields of_views(views, "views"), of_planes(planes, "planes");
  StereoParams p = params_of(of_views, of_planes, Fields(settings, "settings"));
  p.score = score_of(score, p.view);
  nb::gil_scoped_release release;
  choice()->judge(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_stereo, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("search", &search, nb::arg("views"), nb::arg("start"), nb::arg("settings"), nb::arg("seed"), nb::arg("found"),
        nb::arg("score"));
  m.def("judge", &judge, nb::arg("views"), nb::arg("planes"), nb::arg("settings"), nb::arg("score"));
}
