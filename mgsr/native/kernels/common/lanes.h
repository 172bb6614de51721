// A vector with the operators of a scalar, so that the maths headers work on several splats at once.
#pragma once

#include <cstring>

#include "kernels/common/simd.h"
#include "math/macros.h"

namespace mgsr {
namespace MGSR_ISA {

// Vector: vfloat or vdouble.
template <class Vector>
struct Lanes {
  using Scalar = decltype(Vector()[0] + 0);
  using Mask = decltype(Vector() < Vector());
  static constexpr int kCount = int(sizeof(Vector) / sizeof(Scalar));

  struct Test {
    Mask mask;
    friend Test operator|(Test a, Test b) { return {a.mask | b.mask}; }
    friend Test operator&(Test a, Test b) { return {a.mask & b.mask}; }
    friend Lanes select(Test test, Lanes a, Lanes b) { return Lanes(test.mask ? a.v : b.v); }
    friend bool any(Test test) { return MGSR_ISA::any((vint)test.mask); }
    bool operator[](int lane) const { return mask[lane] != 0; }
  };

  Vector v;

  Lanes() = default;
  Lanes(Scalar x) : v(x - Vector{}) {}
  explicit Lanes(Vector x) : v(x) {}
  Scalar operator[](int lane) const { return v[lane]; }

  Lanes operator-() const { return Lanes(-v); }
  Lanes& operator+=(Lanes b) { return v += b.v, *this; }
  Lanes& operator-=(Lanes b) { return v -= b.v, *this; }
  friend Lanes operator+(Lanes a, Lanes b) { return Lanes(a.v + b.v); }
  friend Lanes operator-(Lanes a, Lanes b) { return Lanes(a.v - b.v); }
  friend Lanes operator*(Lanes a, Lanes b) { return Lanes(a.v * b.v); }
  friend Lanes operator/(Lanes a, Lanes b) { return Lanes(a.v / b.v); }
  friend Test operator<(Lanes a, Lanes b) { return {a.v < b.v}; }
  friend Test operator>(Lanes a, Lanes b) { return {a.v > b.v}; }
  friend Test operator<=(Lanes a, Lanes b) { return {a.v <= b.v}; }
  friend Test operator>=(Lanes a, Lanes b) { return {a.v >= b.v}; }
  friend Test operator!=(Lanes a, Lanes b) { return {a.v != b.v}; }
  friend Lanes sqrt(Lanes a) { return Lanes(MGSR_ISA::sqrt(a.v)); }
};

using Floats = Lanes<vfloat>;
using Doubles = Lanes<vdouble>;

// Returns the vector whose lanes are of(lane).
template <class L, class Of>
inline L each_lane(const Of& of) {
  typename L::Scalar values[L::kCount];
  for (int lane = 0; lane < L::kCount; ++lane) values[lane] = of(lane);
  L lanes;
  std::memcpy(&lanes.v, values, sizeof(values));
  return lanes;
}

}  // namespace MGSR_ISA
}  // namespace mgsr
