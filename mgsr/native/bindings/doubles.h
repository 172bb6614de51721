// Conversions for the tests of the maths in float64: structs of doubles from and to lists of numbers.
#pragma once

#include <cstring>
#include <vector>

#include "bindings/arrays.h"
#include "math/camera.h"

namespace mgsr {

using Doubles = Array<const double>;

template <class Struct>
std::vector<double> numbers_of(const Struct& s) {
  std::vector<double> numbers(sizeof(Struct) / sizeof(double));
  std::memcpy(numbers.data(), &s, sizeof(Struct));
  return numbers;
}

template <class Struct>
Struct struct_of(const Doubles& numbers) {
  expect(numbers.size() * sizeof(double) == sizeof(Struct), "expected as many numbers as the struct has");
  Struct s;
  std::memcpy(&s, numbers.data(), sizeof(Struct));
  return s;
}

// camera: R[9], t[3], fx, fy, cx, cy, width, height.
inline Camera<double> double_camera(const Doubles& camera) { return struct_of<Camera<double>>(camera); }

}  // namespace mgsr
