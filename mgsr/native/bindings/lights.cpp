// Python module mgsr.native._lights.
#include <vector>

#include "bindings/fields.h"
#include "kernels/lights/lights.h"

namespace mgsr {
namespace {

IsaChoice<LightsTable>& choice() {
  static IsaChoice<LightsTable> current(MGSR_TABLES(lights_table));
  return current;
}

template <class T>
using Plane = Array<T, nb::ndim<2>>;
template <class T>
using Rgb = Array<T, nb::shape<-1, -1, 3>>;
using Triple = Array<const float, nb::shape<3>>;

// The size of all arrays of a call: that of `plane`.
class Size {
 public:
  explicit Size(const Plane<const float>& plane) : height_(plane.shape(0)), width_(plane.shape(1)) {}

  // Reads an array of this size.
  template <class A>
  A array(nb::handle given, const char* name) const {
    return checked(read<A>(given, name), name);
  }

  // Does the same, and gives null for None.
  template <class A>
  auto* pointer_or_none(nb::handle given, const char* name) const {
    return pointer_or_null(checked(read_or_none<A>(given, name), name));
  }

  template <class A>
  A checked(A array, const char* name) const {
    if (array.is_valid() && (array.shape(0) != height_ || array.shape(1) != width_))
      throw std::invalid_argument(std::string(name) + ": expected the size of the other images");
    return array;
  }

  int64_t pixels() const { return int64_t(height_ * width_); }

 private:
  size_t height_, width_;
};

void add_reflection(nb::handle transmitted, nb::handle weight, nb::handle own, nb::handle environment, nb::handle color,
                    nb::handle reflected) {
  const auto by = read<Plane<const float>>(weight, "weight");
  const Size size(by);
  ReflectionParams p;
  p.pixels = size.pixels(), p.weight = by.data();
  p.transmitted = size.array<Rgb<const float>>(transmitted, "transmitted").data();
  p.own = size.pointer_or_none<Rgb<const float>>(own, "own");
  p.environment = size.pointer_or_none<Rgb<const float>>(environment, "environment");
  expect(p.own || p.environment, "own, environment: expected one of them at least");
  p.color = size.array<Rgb<float>>(color, "color").data();
  p.reflected = size.array<Rgb<float>>(reflected, "reflected").data();
  nb::gil_scoped_release release;
  choice()->reflection(p);
}

void add_reflection_vjp(nb::handle v_color, nb::handle reflected, nb::handle weight, const std::vector<nb::object>& before,
                        const std::vector<nb::object>& out) {
  const auto by = read<Plane<const float>>(weight, "weight");
  const Size size(by);
  expect(before.size() == 3, "before: expected 3 arrays");
  expect(out.size() == 4, "out: expected 4 arrays");
  ReflectionVjpParams p;
  p.pixels = size.pixels(), p.weight = by.data();
  p.v_color = size.array<Rgb<const float>>(v_color, "v_color").data();
  p.reflected = size.array<Rgb<const float>>(reflected, "reflected").data();
  p.add_transmitted = size.pointer_or_none<Rgb<const float>>(before[0], "before");
  p.add_weight = size.pointer_or_none<Plane<const float>>(before[1], "before");
  p.add_own = size.pointer_or_none<Rgb<const float>>(before[2], "before");
  p.v_transmitted = size.array<Rgb<float>>(out[0], "out").data();
  p.v_weight = size.array<Plane<float>>(out[1], "out").data();
  p.v_own = size.array<Rgb<float>>(out[2], "out").data();
  p.v_environment = size.array<Rgb<float>>(out[3], "out").data();
  nb::gil_scoped_release release;
  choice()->reflection_vjp(p);
}

void light_up(nb::handle unlit, nb::handle alpha, nb::handle background, nb::handle shading, float offset,
              nb::handle image) {
  const auto light = read<Plane<const float>>(shading, "shading");
  const auto behind = read<Triple>(background, "background");
  const Size size(light);
  LightUpParams p;
  p.pixels = size.pixels(), p.shading = light.data(), p.background = behind.data(), p.offset = offset;
  p.unlit = size.array<Rgb<const float>>(unlit, "unlit").data();
  p.alpha = size.array<Plane<const float>>(alpha, "alpha").data();
  p.image = size.array<Rgb<float>>(image, "image").data();
  nb::gil_scoped_release release;
  choice()->light_up(p);
}

void light_up_vjp(nb::handle v_image, nb::handle background, nb::handle shading, float offset, nb::handle add_alpha,
                  nb::handle out) {
  const auto light = read<Plane<const float>>(shading, "shading");
  const auto behind = read<Triple>(background, "background");
  const Fields fields(out, "out");
  const Size size(light);
  LightUpVjpParams p;
  p.pixels = size.pixels(), p.shading = light.data(), p.background = behind.data(), p.offset = offset;
  p.v_image = size.array<Rgb<const float>>(v_image, "v_image").data();
  p.add_alpha = size.pointer_or_none<Plane<const float>>(add_alpha, "add_alpha");
  p.v_unlit = size.checked(fields.array<Rgb<float>>("v_unlit"), "v_unlit").data();
  p.v_alpha = size.checked(fields.array<Plane<float>>("v_alpha"), "v_alpha").data();
  nb::gil_scoped_release release;
  choice()->light_up_vjp(p);
}

}  // namespace
}  // namespace mgsr

NB_MODULE(_lights, m) {
  using namespace mgsr;
  bind_choices(m, choice());
  m.def("add_reflection", &add_reflection, nb::arg("transmitted"), nb::arg("weight"), nb::arg("own").none(),
        nb::arg("environment").none(), nb::arg("color"), nb::arg("reflected"));
  m.def("add_reflection_vjp", &add_reflection_vjp, nb::arg("v_color"), nb::arg("reflected"), nb::arg("weight"),
        nb::arg("before"), nb::arg("out"));
  m.def("light_up", &light_up, nb::arg("unlit"), nb::arg("alpha"), nb::arg("background"), nb::arg("shading"),
        nb::arg("offset"), nb::arg("image"));
  m.def("light_up_vjp", &light_up_vjp, nb::arg("v_image"), nb::arg("background"), nb::arg("shading"),
        nb::arg("offset"), nb::arg("add_alpha").none(), nb::arg("out"));
}
