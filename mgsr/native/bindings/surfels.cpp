// Python module mgsr.native._surfels: the kernels of the 2D branch.
#include "kernels/surfels/surfels.h"

#include <memory>

#include "bindings/doubles.h"
#include "bindings/fields.h"
#include "bindings/frames.h"
#include "math/surfel.h"

namespace mgsr {
namespace {

IsaChoice<SurfelKernels>& kernels() {
  static IsaChoice<SurfelKernels> choice(MGSR_TABLES(surfel_kernels));
  return choice;
}

SurfelInputs inputs_of(const Fields& splats, const Fields& view) {
  const auto means = splats.array<Array<const float, nb::shape<-1, 3>>>("means");
  const int64_t n = int64_t(means.shape(0));
  SurfelInputs in;
  in.count = n;
  in.means = means.data();
  in.quats = splats.data<const float>("quats", 4 * n);
  in.scales = splats.data<const float>("scales", 2 * n);
  in.opacities = splats.data<const float>("opacities", n);
  in.colors = splats.data<const float>("colors", 3 * n);
  in.background = splats.data<const float>("background", 3);
  in.camera = camera_of(view.get("camera"));
  in.width = int(in.camera.width), in.height = int(in.camera.height);
  in.near = view.value<float>("near"), in.far = view.value<float>("far"), in.low_pass = view.value<float>("low_pass");
  return in;
}

SurfelImages images_of(const Fields& images, int64_t pixels) {
  return {images.data<float>("color", 3 * pixels), images.data<float>("alpha", pixels),
          images.data<float>("depth", pixels),     images.data<float>("median_depth", pixels),
          images.data<float>("normal", 3 * pixels), images.data_or_null<float>("distortion", pixels)};
}

SurfelImages image_gradients_of(const Fields& v_images, int64_t pixels) {
  // The kernels only read these.
  auto at = [&](const char* name, int64_t size) {
    return const_cast<float*>(v_images.data_or_null<const float>(name, size));
  };
  return {at("color", 3 * pixels),  at("alpha", pixels),      at("depth", pixels),
          at("median_depth", pixels), at("normal", 3 * pixels), at("distortion", pixels)};
}

SurfelGradients gradients_of(const Fields& v, int64_t n) {
  return {v.data<float>("means", 3 * n), v.data<float>("quats", 4 * n),  v.data<float>("scales", 2 * n),
          v.data<float>("opacities", n), v.data<float>("colors", 3 * n), v.data<float>("means2d", 2 * n)};
}

Frame<SurfelState>* forward(nb::handle splats, nb::handle view, nb::handle images, nb::handle radii) {
  const Fields of_splats(splats, "splats"), of_view(view, "view"), of_images(images, "images");
  const SurfelInputs in = inputs_of(of_splats, of_view);
  const SurfelImages out = images_of(of_images, int64_t(in.width) * in.height);
  const auto of_radii = read<Array<float, nb::ndim<1>>>(radii, "radii");
  expect(int64_t(of_radii.size()) == in.count, "radii: expected one for each splat");
  auto frame = std::make_unique<Frame<SurfelState>>();
  nb::gil_scoped_release release;
  kernels()->forward(in, **frame, out, of_radii.data());
  return frame.release();
}

void backward(Frame<SurfelState>& frame, nb::handle splats, nb::handle view, nb::handle images, nb::handle v_images,
              nb::handle v_splats) {
  const Fields of_splats(splats, "splats"), of_view(view, "view"), of_images(images, "images");
  const Fields of_v_images(v_images, "v_images"), of_v_splats(v_splats, "v_splats");
  const SurfelInputs in = inputs_of(of_splats, of_view);
  const int64_t pixels = int64_t(in.width) * in.height;
  const SurfelImages out = images_of(of_images, pixels), v_out = image_gradients_of(of_v_images, pixels);
  const SurfelGradients v = gradients_of(of_v_splats, in.count);
  nb::gil_scoped_release release;
  kernels()->backward(in, *frame, out, v_out, v);
}

// Returns a splat's frame in float64. mean, quat and scale must have 3, 4 and 2 numbers.
SurfelFrame<double> frame_double(const Doubles& mean, const Doubles& quat, const Doubles& scale, const Doubles& camera) {
  expect(mean.size() == 3 && quat.size() == 4 && scale.size() == 2, "mean, quat, scale: expected 3, 4 and 2 numbers");
  SurfelFrame<double> f;
  surfel_frame(double_camera(camera), mean.data(), quat.data(), scale.data(), f);
  return f;
}

// Projects in float64, for checks of the derivative. Returns x, y, depth, L[4], g[2], normal[3].
std::vector<double> project_double(const Doubles& mean, const Doubles& quat, const Doubles& scale, const Doubles& camera) {
  return numbers_of(project_surfel(double_camera(camera), frame_double(mean, quat, scale, camera)));
}

// Returns the gradients of mean, quat and scale, given those of the projection.
std::tuple<std::vector<double>, std::vector<double>, std::vector<double>> project_double_vjp(
    const Doubles& mean, const Doubles& quat, const Doubles& scale, const Doubles& camera, const Doubles& v) {
  const SurfelFrame<double> f = frame_double(mean, quat, scale, camera);
  std::vector<double> v_mean(3), v_quat(4), v_scale(2);
  project_surfel_vjp(double_camera(camera), quat.data(), scale.data(), f, struct_of<ProjectedSurfel<double>>(v),
                     v_mean.data(), v_quat.data(), v_scale.data());
  return {v_mean, v_quat, v_scale};
}

// Returns the disk's image at r2 in float64: x, y, cxx, cxy, cyy relative to the projected centre. The result is empty
// if the disk reaches the near plane.
std::vector<double> outline_double(const Doubles& mean, const Doubles& quat, const Doubles& scale, const Doubles& camera,
                                   double r2, double near) {
  SurfelOutline<double> o;
  const SurfelFrame<double> f = frame_double(mean, quat, scale, camera);
  const bool whole = surfel_outline(double_camera(camera), f, scale.data(), r2, near, o);
  return whole ? numbers_of(o) : std::vector<double>();
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_surfels, m) {
  using namespace mgsr;
  nb::class_<Frame<SurfelState>>(m, "Frame");
  m.def("forward", &forward, nb::rv_policy::take_ownership, nb::arg("splats"), nb::arg("view"), nb::arg("images"),
        nb::arg("radii"));
  m.def("backward", &backward, nb::arg("frame"), nb::arg("splats"), nb::arg("view"), nb::arg("images"),
        nb::arg("v_images"), nb::arg("v_splats"));
  m.def("pairs", [](const Frame<SurfelState>& frame) { return frame->lists.pairs(); }, nb::arg("frame"),
        "Number of (splat, tile) pairs of a frame.");
  bind_choices(m, kernels());
  m.def("project_double", &project_double, nb::arg("mean"), nb::arg("quat"), nb::arg("scale"), nb::arg("camera"));
  m.def("project_double_vjp", &project_double_vjp, nb::arg("mean"), nb::arg("quat"), nb::arg("scale"),
        nb::arg("camera"), nb::arg("v"));
  m.def("outline_double", &outline_double, nb::arg("mean"), nb::arg("quat"), nb::arg("scale"), nb::arg("camera"),
        nb::arg("r2"), nb::arg("near"));
}
