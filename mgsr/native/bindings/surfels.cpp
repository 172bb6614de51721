// Python's way to the 2D branch's kernels.
#include "kernels/surfels/surfels.h"

#include <cstring>
#include <memory>

#include "bindings/frames.h"
#include "bindings/raster_arrays.h"
#include "math/surfel.h"

namespace mgsr {
namespace {

IsaChoice<SurfelKernels>& kernels() {
  static IsaChoice<SurfelKernels> choice(MGSR_TABLES(surfel_kernels));
  return choice;
}

SurfelInputs make_inputs(const In& means, const In& quats, const In& scales, const In& opacities, const In& colors,
                         const In& background, const Matrix& K, const Matrix& cam_from_world, int width, int height,
                         float near, float far, float low_pass) {
  const int64_t n = means.size() / 3;
  SurfelInputs in;
  in.count = n;
  in.means = data(means, 3 * n, "means");
  in.quats = data(quats, 4 * n, "quats");
  in.scales = data(scales, 2 * n, "scales");
  in.opacities = data(opacities, n, "opacities");
  in.colors = data(colors, 3 * n, "colors");
  in.background = data(background, 3, "background");
  in.camera = make_camera(K, cam_from_world, width, height);
  in.width = width, in.height = height, in.near = near, in.far = far, in.low_pass = low_pass;
  return in;
}

template <class Array>
SurfelImages make_images(int64_t pixels, const std::optional<Array>& color, const std::optional<Array>& alpha,
                         const std::optional<Array>& depth, const std::optional<Array>& median_depth,
                         const std::optional<Array>& normal, const std::optional<Array>& distortion) {
  // Gradient images come in as const; the kernels only read those.
  auto at = [](auto* p) { return const_cast<float*>(p); };
  return {at(data(color, 3 * pixels, "color")), at(data(alpha, pixels, "alpha")), at(data(depth, pixels, "depth")),
          at(data(median_depth, pixels, "median_depth")), at(data(normal, 3 * pixels, "normal")),
          at(data(distortion, pixels, "distortion"))};
}

using Doubles = Array<const double>;
using DoublesOut = Array<double>;

const Camera<double>& double_camera(const Doubles& camera) {
  expect(camera.size() * sizeof(double) == sizeof(Camera<double>), "camera: expected R[9], t[3], fx, fy, cx, cy, width, height");
  return *reinterpret_cast<const Camera<double>*>(camera.data());
}

// The projection in float64, for checks of the derivative: (mean, quat, scale) -> x, y, depth, L[4], g[2], normal[3].
void project_double(Doubles mean, Doubles quat, Doubles scale, Doubles camera, DoublesOut out) {
  expect(out.size() * sizeof(double) == sizeof(ProjectedSurfel<double>), "out: expected [12]");
  SurfelFrame<double> f;
  surfel_frame(double_camera(camera), mean.data(), quat.data(), scale.data(), f);
  const auto s = project_surfel(double_camera(camera), f);
  std::memcpy(out.data(), &s, sizeof(s));
}

void project_double_vjp(Doubles mean, Doubles quat, Doubles scale, Doubles camera, Doubles v, DoublesOut v_mean,
                        DoublesOut v_quat, DoublesOut v_scale) {
  expect(v.size() * sizeof(double) == sizeof(ProjectedSurfel<double>), "v: expected [12]");
  SurfelFrame<double> f;
  surfel_frame(double_camera(camera), mean.data(), quat.data(), scale.data(), f);
  ProjectedSurfel<double> g;
  std::memcpy(&g, v.data(), sizeof(g));
  project_surfel_vjp(double_camera(camera), quat.data(), scale.data(), f, g, v_mean.data(), v_quat.data(), v_scale.data());
}

// The disk's image in float64: (mean, quat, scale), r2, near -> x, y, cxx, cxy, cyy relative to the projected centre.
bool outline_double(Doubles mean, Doubles quat, Doubles scale, Doubles camera, double r2, double near, DoublesOut out) {
  expect(out.size() * sizeof(double) == sizeof(SurfelOutline<double>), "out: expected [5]");
  SurfelFrame<double> f;
  surfel_frame(double_camera(camera), mean.data(), quat.data(), scale.data(), f);
  SurfelOutline<double> o;
  const bool whole = surfel_outline(double_camera(camera), f, scale.data(), r2, near, o);
  std::memcpy(out.data(), &o, sizeof(o));
  return whole;
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_surfels, m) {
  using namespace mgsr;
  nb::class_<Frame<SurfelState>>(m, "Frame");

  m.def("forward",
        [](In means, In quats, In scales, In opacities, In colors, In background, Matrix K, Matrix cam_from_world, int width,
           int height, float near, float far, float low_pass, Out color, Out alpha, Out depth, Out median_depth, Out normal,
           std::optional<Out> distortion, Out radii) {
          const SurfelInputs in =
              make_inputs(means, quats, scales, opacities, colors, background, K, cam_from_world, width, height, near, far, low_pass);
          const SurfelImages out =
              make_images<Out>(int64_t(width) * height, color, alpha, depth, median_depth, normal, distortion);
          float* r = data(radii, in.count, "radii");
          auto frame = std::make_unique<Frame<SurfelState>>();
          nb::gil_scoped_release release;
          kernels()->forward(in, **frame, out, r);
          return frame.release();
        },
        nb::rv_policy::take_ownership, nb::arg("means"), nb::arg("quats"), nb::arg("scales"), nb::arg("opacities"),
        nb::arg("colors"), nb::arg("background"), nb::arg("K"), nb::arg("cam_from_world"), nb::arg("width"), nb::arg("height"),
        nb::arg("near"), nb::arg("far"), nb::arg("low_pass"), nb::arg("color"), nb::arg("alpha"), nb::arg("depth"), nb::arg("median_depth"),
        nb::arg("normal"), nb::arg("distortion").none(), nb::arg("radii"));

  m.def("backward",
        [](Frame<SurfelState>& frame, In means, In quats, In scales, In opacities, In colors, In background, Matrix K,
           Matrix cam_from_world, int width, int height, float near, float far, float low_pass, In color, In alpha, In depth, In median_depth,
           In normal, std::optional<In> distortion, std::optional<In> v_color, std::optional<In> v_alpha,
           std::optional<In> v_depth, std::optional<In> v_median_depth, std::optional<In> v_normal,
           std::optional<In> v_distortion, Out v_means, Out v_quats, Out v_scales, Out v_opacities, Out v_colors,
           Out v_means2d) {
          const SurfelInputs in =
              make_inputs(means, quats, scales, opacities, colors, background, K, cam_from_world, width, height, near, far, low_pass);
          const int64_t n = in.count, pixels = int64_t(width) * height;
          const SurfelImages out = make_images<In>(pixels, color, alpha, depth, median_depth, normal, distortion);
          const SurfelImages v_out = make_images<In>(pixels, v_color, v_alpha, v_depth, v_median_depth, v_normal, v_distortion);
          const SurfelGradients v = {data(v_means, 3 * n, "v_means"),         data(v_quats, 4 * n, "v_quats"),
                                     data(v_scales, 2 * n, "v_scales"),       data(v_opacities, n, "v_opacities"),
                                     data(v_colors, 3 * n, "v_colors"),       data(v_means2d, 2 * n, "v_means2d")};
          nb::gil_scoped_release release;
          kernels()->backward(in, *frame, out, v_out, v);
        },
        nb::arg("frame"), nb::arg("means"), nb::arg("quats"), nb::arg("scales"), nb::arg("opacities"), nb::arg("colors"),
        nb::arg("background"), nb::arg("K"), nb::arg("cam_from_world"), nb::arg("width"), nb::arg("height"), nb::arg("near"),
        nb::arg("far"), nb::arg("low_pass"), nb::arg("color"), nb::arg("alpha"), nb::arg("depth"), nb::arg("median_depth"), nb::arg("normal"),
        nb::arg("distortion").none(), nb::arg("v_color").none(), nb::arg("v_alpha").none(), nb::arg("v_depth").none(),
        nb::arg("v_median_depth").none(), nb::arg("v_normal").none(), nb::arg("v_distortion").none(), nb::arg("v_means"),
        nb::arg("v_quats"), nb::arg("v_scales"), nb::arg("v_opacities"), nb::arg("v_colors"), nb::arg("v_means2d"));

  m.def("pairs", [](const Frame<SurfelState>& frame) { return frame->lists.pairs(); }, "Number of (splat, tile) pairs of a frame.");
  bind_choices(m, kernels());
  m.def("project_double", &project_double);
  m.def("project_double_vjp", &project_double_vjp);
  m.def("outline_double", &outline_double);
}
