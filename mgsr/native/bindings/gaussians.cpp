// Python module mgsr.native._gaussians: the kernels of the 3D branch.
#include "kernels/gaussians/gaussians.h"

#include <memory>

#include "bindings/doubles.h"
#include "bindings/fields.h"
#include "bindings/frames.h"
#include "math/gaussian.h"

namespace mgsr {
namespace {

IsaChoice<GaussianKernels>& kernels() {
  static IsaChoice<GaussianKernels> choice(MGSR_TABLES(gaussian_kernels));
  return choice;
}

GaussianInputs inputs_of(const Fields& splats, const Fields& view) {
  const auto means = splats.array<Array<const float, nb::shape<-1, 3>>>("means");
  const int64_t n = int64_t(means.shape(0));
  GaussianInputs in;
  in.count = n;
  in.means = means.data();
  in.quats = splats.data<const float>("quats", 4 * n);
  in.scales = splats.data<const float>("scales", 3 * n);
  in.opacities = splats.data<const float>("opacities", n);
  in.colors = splats.data<const float>("colors", 3 * n);
  in.refl_opacities = splats.data_or_null<const float>("refl_opacities", n);
  in.refl_colors = splats.data_or_null<const float>("refl_colors", 3 * n);
  in.weights = splats.data_or_null<const float>("weights", n);
  in.background = splats.data<const float>("background", 3);
  in.camera = camera_of(view.get("camera"));
  in.width = int(in.camera.width), in.height = int(in.camera.height);
  in.near = view.value<float>("near"), in.low_pass = view.value<float>("low_pass");
  in.compensate = view.value<bool>("compensate"), in.depth = false;
  return in;
}

GaussianImages images_of(const Fields& images, int64_t pixels) {
  return {images.data<float>("color", 3 * pixels), images.data<float>("alpha", pixels),
          images.data_or_null<float>("depth", pixels), images.data_or_null<float>("reflected", 3 * pixels),
          images.data_or_null<float>("weight", pixels)};
}

GaussianImages image_gradients_of(const Fields& v_images, int64_t pixels) {
  // The kernels only read these.
  auto at = [&](const char* name, int64_t size) {
    return const_cast<float*>(v_images.data_or_null<const float>(name, size));
  };
  return {at("color", 3 * pixels), at("alpha", pixels), at("depth", pixels), at("reflected", 3 * pixels),
          at("weight", pixels)};
}

GaussianGradients gradients_of(const Fields& v, int64_t n) {
  return {v.data<float>("means", 3 * n),
          v.data<float>("quats", 4 * n),
          v.data<float>("scales", 3 * n),
          v.data<float>("opacities", n),
          v.data<float>("colors", 3 * n),
          v.data_or_null<float>("refl_opacities", n),
          v.data_or_null<float>("refl_colors", 3 * n),
          v.data_or_null<float>("weights", n),
          v.data<float>("means2d", 2 * n)};
}

Frame<GaussianState>* forward(nb::handle splats, nb::handle view, nb::handle images, nb::handle radii) {
  const Fields of_splats(splats, "splats"), of_view(view, "view"), of_images(images, "images");
  GaussianInputs in = inputs_of(of_splats, of_view);
  const GaussianImages out = images_of(of_images, int64_t(in.width) * in.height);
  in.depth = out.depth != nullptr;
  const auto of_radii = read<Array<float, nb::ndim<1>>>(radii, "radii");
  expect(int64_t(of_radii.size()) == in.count, "radii: expected one for each splat");
  auto frame = std::make_unique<Frame<GaussianState>>();
  nb::gil_scoped_release release;
  kernels()->forward(in, **frame, out, of_radii.data());
  return frame.release();
}

void backward(Frame<GaussianState>& frame, nb::handle splats, nb::handle view, nb::handle images, nb::handle v_images,
              nb::handle v_splats) {
  const Fields of_splats(splats, "splats"), of_view(view, "view"), of_images(images, "images");
  const Fields of_v_images(v_images, "v_images"), of_v_splats(v_splats, "v_splats");
  const GaussianInputs in = inputs_of(of_splats, of_view);
  const int64_t pixels = int64_t(in.width) * in.height;
  const GaussianImages out = images_of(of_images, pixels), v_out = image_gradients_of(of_v_images, pixels);
  const GaussianGradients v = gradients_of(of_v_splats, in.count);
  nb::gil_scoped_release release;
  kernels()->backward(in, *frame, out, v_out, v);
}

void expect_splat(const Doubles& mean, const Doubles& quat, const Doubles& scale) {
  expect(mean.size() == 3 && quat.size() == 4 && scale.size() == 3, "mean, quat, scale: expected 3, 4 and 3 numbers");
}

// Projects in float64, for checks of the derivative. Returns x, y, depth, cxx, cxy, cyy, compensation.
std::vector<double> project_double(const Doubles& mean, const Doubles& quat, const Doubles& scale, const Doubles& camera,
                                   double low_pass) {
  expect_splat(mean, quat, scale);
  return numbers_of(project_gaussian(double_camera(camera), mean.data(), quat.data(), scale.data(), low_pass));
}

// Returns the gradients of mean, quat and scale, given those of the projection.
std::tuple<std::vector<double>, std::vector<double>, std::vector<double>> project_double_vjp(
    const Doubles& mean, const Doubles& quat, const Doubles& scale, const Doubles& camera, double low_pass,
    const Doubles& v) {
  expect_splat(mean, quat, scale);
  std::vector<double> v_mean(3), v_quat(4), v_scale(3);
  project_gaussian_vjp(double_camera(camera), mean.data(), quat.data(), scale.data(), low_pass,
                       struct_of<ProjectedGaussian<double>>(v), v_mean.data(), v_quat.data(), v_scale.data());
  return {v_mean, v_quat, v_scale};
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_gaussians, m) {
  using namespace mgsr;
  nb::class_<Frame<GaussianState>>(m, "Frame");
  m.def("forward", &forward, nb::rv_policy::take_ownership, nb::arg("splats"), nb::arg("view"), nb::arg("images"),
        nb::arg("radii"));
  m.def("backward", &backward, nb::arg("frame"), nb::arg("splats"), nb::arg("view"), nb::arg("images"),
        nb::arg("v_images"), nb::arg("v_splats"));
  m.def("pairs", [](const Frame<GaussianState>& frame) { return frame->lists.pairs(); }, nb::arg("frame"),
        "Number of (splat, tile) pairs of a frame.");
  bind_choices(m, kernels());
  m.def("project_double", &project_double, nb::arg("mean"), nb::arg("quat"), nb::arg("scale"), nb::arg("camera"),
        nb::arg("low_pass"));
  m.def("project_double_vjp", &project_double_vjp, nb::arg("mean"), nb::arg("quat"), nb::arg("scale"),
        nb::arg("camera"), nb::arg("low_pass"), nb::arg("v"));
}
