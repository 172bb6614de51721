// A number as the sum of two floats, with some 45 binary digits, for GPUs on which float64 is slow.
//
// Source: Dekker; Knuth; Joldes, Muller and Popescu (2017). The error of products, quotients and roots is less than
// 2^-44 of the result, and that of sums less than 2^-46 of the larger summand. The exponents are those of float: the
// bounds hold from about 1e-25 to 1e38. Outside, results are those of float, or NaN.
#pragma once

#include "math/macros.h"

namespace mgsr {

struct TwoFloats {
  float high, low;  // |low| is at most half a unit in the last place of high

  MGSR_MEMBER TwoFloats() : high(0), low(0) {}
  MGSR_MEMBER TwoFloats(float x) : high(x), low(0) {}
  MGSR_MEMBER TwoFloats(int x) : high(float(x)), low(0) {}
  MGSR_MEMBER TwoFloats(double x) : high(float(x)), low(float(x - float(x))) {}
  MGSR_MEMBER TwoFloats(float h, float l) : high(h), low(l) {}

  MGSR_MEMBER explicit operator float() const { return high; }
  MGSR_MEMBER explicit operator double() const { return double(high) + double(low); }
  MGSR_MEMBER TwoFloats operator-() const { return {-high, -low}; }
  MGSR_MEMBER TwoFloats& operator+=(TwoFloats b) { return *this = *this + b; }

  // Returns the exact sum if |a| is not less than |b|.
  MGSR_MEMBER static TwoFloats ordered_sum(float a, float b) {
    const float sum = a + b;
    return {sum, b - (sum - a)};
  }

  friend MGSR_MEMBER TwoFloats operator+(TwoFloats a, TwoFloats b) {
    const float sum = a.high + b.high, other = sum - a.high;
    const float error = (a.high - (sum - other)) + (b.high - other);
    return ordered_sum(sum, error + (a.low + b.low));
  }
  friend MGSR_MEMBER TwoFloats operator-(TwoFloats a, TwoFloats b) { return a + -b; }

  friend MGSR_MEMBER TwoFloats operator*(TwoFloats a, TwoFloats b) {
    const float product = rounded_product(a.high, b.high);
    const float error = fma(a.high, b.high, -product);
    return ordered_sum(product, error + fma(a.low, b.high, rounded_product(a.high, b.low)));
  }

  friend MGSR_MEMBER TwoFloats operator/(TwoFloats a, TwoFloats b) {
    const float inverse = quick_quotient(1.0f, b.high), first = rounded_product(a.high, inverse);
    const TwoFloats left = a - b * TwoFloats(first);
    return ordered_sum(first, rounded_product(left.high, inverse));
  }

  friend MGSR_MEMBER TwoFloats sqrt(TwoFloats a) {
    if (!(a.high > 0.0f)) return {quick_sqrt(a.high), 0.0f};
    const float root = quick_sqrt(a.high);
    const float product = rounded_product(root, root), error = fma(root, root, -product);
    const TwoFloats left = a - TwoFloats(product, error);
    return ordered_sum(root, quick_quotient(0.5f * left.high, root));
  }

  friend MGSR_MEMBER bool operator<(TwoFloats a, TwoFloats b) {
    return a.high < b.high || (a.high == b.high && a.low < b.low);
  }
  friend MGSR_MEMBER bool operator>(TwoFloats a, TwoFloats b) { return b < a; }
  friend MGSR_MEMBER bool operator==(TwoFloats a, TwoFloats b) { return a.high == b.high && a.low == b.low; }
  friend MGSR_MEMBER bool operator!=(TwoFloats a, TwoFloats b) { return !(a == b); }
};

}  // namespace mgsr
