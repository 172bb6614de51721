// What the two rasterizers' bindings share: flat float arrays with their sizes checked, and the camera.
#pragma once

#include <nanobind/stl/optional.h>

#include <optional>

#include "bindings/arrays.h"
#include "math/camera.h"

namespace mgsr {

using In = Array<const float>;
using Out = Array<float>;
using Matrix = Array<const double, nb::ndim<2>>;

// The data of an array that must hold `size` floats. Shapes are checked in Python, where names and letters are; this
// keeps a wrong call from reading past an end.
template <class Array>
auto* data(const Array& array, int64_t size, const char* name) {
  if (int64_t(array.size()) != size)
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(size) + " floats, got " + std::to_string(array.size()));
  return array.data();
}

template <class Array>
auto* data(const std::optional<Array>& array, int64_t size, const char* name) {
  return array ? data(*array, size, name) : nullptr;
}

inline Camera<float> make_camera(const Matrix& K, const Matrix& cam_from_world, int width, int height) {
  if (K.shape(0) != 3 || K.shape(1) != 3) throw std::invalid_argument("K: expected [3, 3]");
  if (cam_from_world.shape(0) != 4 || cam_from_world.shape(1) != 4) throw std::invalid_argument("cam_from_world: expected [4, 4]");
  Camera<float> camera;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) camera.R[3 * i + j] = float(cam_from_world(i, j));
    camera.t[i] = float(cam_from_world(i, 3));
  }
  camera.fx = float(K(0, 0)), camera.fy = float(K(1, 1)), camera.cx = float(K(0, 2)), camera.cy = float(K(1, 2));
  camera.width = float(width), camera.height = float(height);
  return camera;
}

}  // namespace mgsr
