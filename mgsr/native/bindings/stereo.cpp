// Python module mgsr.native._stereo.
#include "bindings/arrays.h"
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

// settings: of StereoSettings, in its order.
StereoSettings settings_of(const std::vector<float>& settings) {
  expect(settings.size() == 11, "settings: expected 11 numbers");
  expect(settings[0] >= 0 && settings[0] <= 4 && settings[5] >= 1,
         "settings: expected a radius of 0 to 4, and a best of 1 at least");
  StereoSettings s;
  s.radius = int(settings[0]), s.spacing = settings[1], s.noise = settings[2], s.alike = settings[3];
  s.reach = settings[4], s.best = int(settings[5]), s.cover = settings[6], s.prior = settings[7];
  s.prior_reach = settings[8], s.search = settings[9], s.rounds = int(settings[10]);
  return s;
}

template <class A>
void expect_size(const A& array, const StereoView& view) {
  expect(int(array.shape(0)) == view.height && int(array.shape(1)) == view.width, "expected images of the view's size");
}

StereoParams params(const std::vector<Pixels>& images, const Cameras& cameras, size_t view,
                    const std::vector<size_t>& neighbours, const Grey<const float>& start_depth,
                    const Vectors<const float>& start_normal, std::tuple<float, float> range,
                    const std::vector<float>& settings) {
  expect(cameras.shape(0) == images.size(), "cameras: expected one for each image");
  expect(view < images.size(), "view: expected an image's number");
  StereoParams p;
  p.settings = settings_of(settings);
  p.view = view_of(images[view], cameras.data() + 16 * view);
  for (const size_t other : neighbours) {
    expect(other < images.size() && other != view, "neighbours: expected other images' numbers");
    p.neighbours.push_back(view_of(images[other], cameras.data() + 16 * other));
  }
  expect_size(start_depth, p.view), expect_size(start_normal, p.view);
  p.start_depth = start_depth.data(), p.start_normal = start_normal.data();
  std::tie(p.nearest, p.farthest) = range;
  expect(p.nearest > 0 && p.farthest > p.nearest, "range: expected 0 < nearest < farthest");
  return p;
}

void search(const std::vector<Pixels>& images, const Cameras& cameras, size_t view,
            const std::vector<size_t>& neighbours, const Grey<const float>& start_depth,
            const Vectors<const float>& start_normal, std::tuple<float, float> range,
            const std::vector<float>& settings, uint32_t seed, const Grey<float>& depth, const Vectors<float>& normal,
            const Grey<float>& score) {
  StereoParams p = params(images, cameras, view, neighbours, start_depth, start_normal, range, settings);
  expect_size(depth, p.view), expect_size(normal, p.view), expect_size(score, p.view);
  p.seed = seed, p.depth = depth.data(), p.normal = normal.data(), p.score = score.data();
  nb::gil_scoped_release release;
  choice()->search(p);
}

void judge(const std::vector<Pixels>& images, const Cameras& cameras, size_t view,
           const std::vector<size_t>& neighbours, const Grey<const float>& depth, const Vectors<const float>& normal,
           std::tuple<float, float> range, const std::vector<float>& settings, const Grey<float>& score) {
  StereoParams p = params(images, cameras, view, neighbours, depth, normal, range, settings);
  expect_size(score, p.view);
  p.score = score.data();
  nb::gil_scoped_release release;
  choice()->judge(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_stereo, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("search", &search, nb::arg("images"), nb::arg("cameras"), nb::arg("view"), nb::arg("neighbours"),
        nb::arg("start_depth"), nb::arg("start_normal"), nb::arg("range"), nb::arg("settings"), nb::arg("seed"),
        nb::arg("depth").noconvert(), nb::arg("normal").noconvert(), nb::arg("score").noconvert());
  m.def("judge", &judge, nb::arg("images"), nb::arg("cameras"), nb::arg("view"), nb::arg("neighbours"),
        nb::arg("depth"), nb::arg("normal"), nb::arg("range"), nb::arg("settings"), nb::arg("score").noconvert());
}
