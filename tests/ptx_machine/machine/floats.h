// Floating-point instructions, by PTX's names.
#pragma once

#include <cfenv>
#include <cmath>

#include "integers.h"

namespace ptx {

template <class T> constexpr bool is_float = std::is_floating_point_v<T>;
template <class T> using IfFloat = std::enable_if_t<is_float<T>, int>;

// Within its life, results are rounded in a direction. Operands must be volatile: the compiler takes operations on
// others for independent of it.
class Rounding {
 public:
  explicit Rounding(int direction) : before_(std::fegetround()) { std::fesetround(direction); }
  ~Rounding() { std::fesetround(before_); }
  Rounding(const Rounding&) = delete;
  Rounding& operator=(const Rounding&) = delete;

 private:
  int before_;
};

template <class T, IfFloat<T> = 0> T add(T a, T b) { return a + b; }
template <class T, IfFloat<T> = 0> T sub(T a, T b) { return a - b; }
template <class T, IfFloat<T> = 0> T mul(T a, T b) { return a * b; }
template <class T, IfFloat<T> = 0> T div(T a, T b) { return a / b; }
template <class T, IfFloat<T> = 0> T fma(T a, T b, T c) { return std::fma(a, b, c); }
template <class T, IfFloat<T> = 0> T rcp(T a) { return T(1) / a; }
template <class T, IfFloat<T> = 0> T sqrt(T a) { return std::sqrt(a); }

inline FloatPair add(FloatPair a, FloatPair b) { return {a.x + b.x, a.y + b.y}; }
inline FloatPair sub(FloatPair a, FloatPair b) { return {a.x - b.x, a.y - b.y}; }
inline FloatPair mul(FloatPair a, FloatPair b) { return {a.x * b.x, a.y * b.y}; }
inline FloatPair fma(FloatPair a, FloatPair b, FloatPair c) { return {std::fma(a.x, b.x, c.x), std::fma(a.y, b.y, c.y)}; }

// The same in a direction of rounding.
template <class T, class Operation, class... Rest>
T in_direction(int direction, const Operation& operation, Rest... operands) {
  const Rounding rounding(direction);
  const volatile T result = operation(static_cast<volatile Rest&>(operands)...);
  return result;
}
template <class T> T add(int direction, T a, T b) {
  return in_direction<T>(direction, [](volatile T& x, volatile T& y) { return x + y; }, a, b);
}
template <class T> T sub(int direction, T a, T b) { return add(direction, a, -b); }
template <class T> T mul(int direction, T a, T b) {
  return in_direction<T>(direction, [](volatile T& x, volatile T& y) { return x * y; }, a, b);
}
template <class T> T div(int direction, T a, T b) {
  return in_direction<T>(direction, [](volatile T& x, volatile T& y) { return x / y; }, a, b);
}
template <class T> T rcp(int direction, T a) { return div(direction, T(1), a); }
template <class T> T sqrt(int direction, T a) {
  return in_direction<T>(direction, [](volatile T& x) { return std::sqrt(T(x)); }, a);
}
template <class T> T fma(int direction, T a, T b, T c) {
  return in_direction<T>(direction, [](volatile T& x, volatile T& y, volatile T& z) { return std::fma(T(x), T(y), T(z)); },
                         a, b, c);
}

template <class T, IfFloat<T> = 0> T neg(T a) { return -a; }
template <class T, IfFloat<T> = 0> T abs(T a) { return std::fabs(a); }
template <class T> T copysign(T sign, T magnitude) { return std::copysign(magnitude, sign); }

// A NaN gives way to the other operand, and -0 is less than +0; min_nan and max_nan hand NaN on.
template <class T, IfFloat<T> = 0> T min(T a, T b) {
  if (std::isnan(a) || std::isnan(b)) return std::isnan(a) ? b : a;
  return a < b || (a == b && std::signbit(a)) ? a : b;
}
template <class T, IfFloat<T> = 0> T max(T a, T b) {
  if (std::isnan(a) || std::isnan(b)) return std::isnan(a) ? b : a;
  return a > b || (a == b && !std::signbit(a)) ? a : b;
}
template <class T, IfFloat<T> = 0> T min(T a, T b, T c) { return min(min(a, b), c); }
template <class T, IfFloat<T> = 0> T max(T a, T b, T c) { return max(max(a, b), c); }
template <class T, class... Rest> T min_nan(T a, Rest... rest) {
  return std::isnan(a) || (std::isnan(rest) || ...) ? std::numeric_limits<T>::quiet_NaN() : min(a, rest...);
}
template <class T, class... Rest> T max_nan(T a, Rest... rest) {
  return std::isnan(a) || (std::isnan(rest) || ...) ? std::numeric_limits<T>::quiet_NaN() : max(a, rest...);
}

template <class T> T flush(T x) { return std::fabs(x) < std::numeric_limits<T>::min() ? std::copysign(T(0), x) : x; }
inline FloatPair flush(FloatPair x) { return {flush(x.x), flush(x.y)}; }
template <class T> T saturate(T x) { return std::isnan(x) ? T(0) : std::fmin(std::fmax(x, T(0)), T(1)); }

// By how many units in the last place approximate instructions are off, one way or the other by the result's bits.
inline int noise_ulps = 0;

inline float approximate(float exact) {
  if (noise_ulps == 0 || !std::isfinite(exact) || exact == 0) return exact;
  uint32_t bits;
  std::memcpy(&bits, &exact, sizeof(bits));
  const bool up = (bits * 2654435761u) >> 31;
  bits = up ? bits + uint32_t(noise_ulps) : bits - uint32_t(noise_ulps);
  std::memcpy(&exact, &bits, sizeof(bits));
  return exact;
}
inline double approximate(double exact) { return exact; }

// The nearest float of what double precision gives, and the noise.
inline float ex2_approx(float a) { return approximate(float(std::exp2(double(a)))); }
inline float lg2_approx(float a) { return approximate(float(std::log2(double(a)))); }
inline float sin_approx(float a) { return approximate(float(std::sin(double(a)))); }
inline float cos_approx(float a) { return approximate(float(std::cos(double(a)))); }
inline float tanh_approx(float a) { return approximate(float(std::tanh(double(a)))); }
template <class T> T rcp_approx(T a) { return approximate(T(1 / double(a))); }
template <class T> T rsqrt_approx(T a) { return approximate(T(1 / std::sqrt(double(a)))); }
inline float sqrt_approx(float a) { return approximate(float(std::sqrt(double(a)))); }
inline float div_full(float a, float b) { return approximate(a / b); }
// It multiplies by b's reciprocal, which is 0 for the largest b.
inline float div_approx(float a, float b) {
  return std::fabs(b) > 0x1p126f && std::isfinite(b) ? a * std::copysign(0.0f, b) : approximate(a / b);
}

}  // namespace ptx
