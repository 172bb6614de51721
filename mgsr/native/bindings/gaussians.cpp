// Python's way to the 3D branch's kernels.
#include "kernels/gaussians/gaussians.h"

#include <memory>

#include "bindings/frames.h"
#include "bindings/raster_arrays.h"
#include "math/gaussian.h"

namespace mgsr {
namespace {

IsaChoice<GaussianKernels>& kernels() {
  static IsaChoice<GaussianKernels> choice(MGSR_TABLES(gaussian_kernels));
  return choice;
}

struct Arguments {
  In means, quats, scales, opacities, colors;
  std::optional<In> refl_opacities, refl_colors, weights;
  In background;
};

GaussianInputs make_inputs(const Arguments& a, const Matrix& K, const Matrix& cam_from_world, int width, int height, float near,
                         float low_pass, bool compensate) {
  const int64_t n = a.means.size() / 3;
  GaussianInputs in;
  in.count = n;
  in.means = data(a.means, 3 * n, "means");
  in.quats = data(a.quats, 4 * n, "quats");
  in.scales = data(a.scales, 3 * n, "scales");
  in.opacities = data(a.opacities, n, "opacities");
  in.colors = data(a.colors, 3 * n, "colors");
  in.refl_opacities = data(a.refl_opacities, n, "refl_opacities");
  in.refl_colors = data(a.refl_colors, 3 * n, "refl_colors");
  in.weights = data(a.weights, n, "weights");
  in.background = data(a.background, 3, "background");
  in.camera = make_camera(K, cam_from_world, width, height);
  in.width = width, in.height = height;
  in.near = near, in.low_pass = low_pass, in.compensate = compensate, in.depth = false;
  return in;
}

template <class Array>
GaussianImages make_images(int64_t pixels, const std::optional<Array>& color, const std::optional<Array>& alpha,
                         const std::optional<Array>& depth, const std::optional<Array>& reflected,
                         const std::optional<Array>& weight) {
  // Gradient images come in as const; the kernels only read those.
  auto at = [](auto* p) { return const_cast<float*>(p); };
  return {at(data(color, 3 * pixels, "color")), at(data(alpha, pixels, "alpha")), at(data(depth, pixels, "depth")),
          at(data(reflected, 3 * pixels, "reflected")), at(data(weight, pixels, "weight"))};
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_gaussians, m) {
  using namespace mgsr;
  nb::class_<Frame<GaussianState>>(m, "Frame");

  m.def("forward",
        [](In means, In quats, In scales, In opacities, In colors, std::optional<In> refl_opacities, std::optional<In> refl_colors,
           std::optional<In> weights, In background, Matrix K, Matrix cam_from_world, int width, int height, float near,
           float low_pass, bool compensate, Out color, Out alpha, std::optional<Out> depth, std::optional<Out> reflected,
           std::optional<Out> weight, Out radii) {
          const Arguments a{means, quats, scales, opacities, colors, refl_opacities, refl_colors, weights, background};
          GaussianInputs in = make_inputs(a, K, cam_from_world, width, height, near, low_pass, compensate);
          in.depth = depth.has_value();
          const GaussianImages out =
              make_images<Out>(int64_t(width) * height, color, alpha, depth, reflected, weight);
          float* r = data(radii, in.count, "radii");
          auto frame = std::make_unique<Frame<GaussianState>>();
          nb::gil_scoped_release release;
          kernels()->forward(in, **frame, out, r);
          return frame.release();
        },
        nb::rv_policy::take_ownership, nb::arg("means"), nb::arg("quats"), nb::arg("scales"), nb::arg("opacities"), nb::arg("colors"),
        nb::arg("refl_opacities").none(), nb::arg("refl_colors").none(), nb::arg("weights").none(), nb::arg("background"),
        nb::arg("K"), nb::arg("cam_from_world"), nb::arg("width"), nb::arg("height"), nb::arg("near"), nb::arg("low_pass"),
        nb::arg("compensate"), nb::arg("color"), nb::arg("alpha"), nb::arg("depth").none(), nb::arg("reflected").none(),
        nb::arg("weight").none(), nb::arg("radii"));

  m.def("backward",
        [](Frame<GaussianState>& frame, In means, In quats, In scales, In opacities, In colors, std::optional<In> refl_opacities,
           std::optional<In> refl_colors, std::optional<In> weights, In background, Matrix K, Matrix cam_from_world, int width,
           int height, float near, float low_pass, bool compensate, In color, In alpha, std::optional<In> depth,
           std::optional<In> reflected, std::optional<In> weight, std::optional<In> v_color, std::optional<In> v_alpha,
           std::optional<In> v_depth, std::optional<In> v_reflected, std::optional<In> v_weight, Out v_means, Out v_quats,
           Out v_scales, Out v_opacities, Out v_colors, std::optional<Out> v_refl_opacities, std::optional<Out> v_refl_colors,
           std::optional<Out> v_weights, Out v_means2d) {
          const Arguments a{means, quats, scales, opacities, colors, refl_opacities, refl_colors, weights, background};
          const GaussianInputs in = make_inputs(a, K, cam_from_world, width, height, near, low_pass, compensate);
          const int64_t n = in.count, pixels = int64_t(width) * height;
          const GaussianImages out = make_images<In>(pixels, color, alpha, depth, reflected, weight);
          const GaussianImages v_out = make_images<In>(pixels, v_color, v_alpha, v_depth, v_reflected, v_weight);
          const GaussianGradients v = {data(v_means, 3 * n, "v_means"),
                                     data(v_quats, 4 * n, "v_quats"),
                                     data(v_scales, 3 * n, "v_scales"),
                                     data(v_opacities, n, "v_opacities"),
                                     data(v_colors, 3 * n, "v_colors"),
                                     data(v_refl_opacities, n, "v_refl_opacities"),
                                     data(v_refl_colors, 3 * n, "v_refl_colors"),
                                     data(v_weights, n, "v_weights"),
                                     data(v_means2d, 2 * n, "v_means2d")};
          nb::gil_scoped_release release;
          kernels()->backward(in, *frame, out, v_out, v);
        },
        nb::arg("frame"), nb::arg("means"), nb::arg("quats"), nb::arg("scales"), nb::arg("opacities"), nb::arg("colors"),
        nb::arg("refl_opacities").none(), nb::arg("refl_colors").none(), nb::arg("weights").none(), nb::arg("background"),
        nb::arg("K"), nb::arg("cam_from_world"), nb::arg("width"), nb::arg("height"), nb::arg("near"), nb::arg("low_pass"),
        nb::arg("compensate"), nb::arg("color"), nb::arg("alpha"), nb::arg("depth").none(), nb::arg("reflected").none(),
        nb::arg("weight").none(), nb::arg("v_color").none(), nb::arg("v_alpha").none(), nb::arg("v_depth").none(),
        nb::arg("v_reflected").none(), nb::arg("v_weight").none(), nb::arg("v_means"), nb::arg("v_quats"), nb::arg("v_scales"),
        nb::arg("v_opacities"), nb::arg("v_colors"), nb::arg("v_refl_opacities").none(), nb::arg("v_refl_colors").none(),
        nb::arg("v_weights").none(), nb::arg("v_means2d"));

  m.def("pairs", [](const Frame<GaussianState>& frame) { return frame->lists.pairs(); }, "Number of (splat, tile) pairs of a frame.");
  bind_choices(m, kernels());

  // The projection in float64, for checks of the derivative: (mean, quat, scale) -> x, y, depth, cxx, cxy, cyy, compensation.
  m.def("project_double", [](Array<const double> mean, Array<const double> quat,
                             Array<const double> scale, Array<const double> camera,
                             double low_pass, Array<double> out) {
    const auto g = project_gaussian(*reinterpret_cast<const Camera<double>*>(camera.data()), mean.data(), quat.data(), scale.data(), low_pass);
    std::memcpy(out.data(), &g, sizeof(g));
  });
  m.def("project_double_vjp",
        [](Array<const double> mean, Array<const double> quat,
           Array<const double> scale, Array<const double> camera, double low_pass,
           Array<const double> v, Array<double> v_mean,
           Array<double> v_quat, Array<double> v_scale) {
          ProjectedGaussian<double> g;
          std::memcpy(&g, v.data(), sizeof(g));
          project_gaussian_vjp(*reinterpret_cast<const Camera<double>*>(camera.data()), mean.data(), quat.data(), scale.data(),
                               low_pass, g, v_mean.data(), v_quat.data(), v_scale.data());
        });
}
