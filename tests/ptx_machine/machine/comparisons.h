// Comparisons by PTX's names. On floats, eq to ge are false for NaN, and equ to geu true.
#pragma once

#include "floats.h"

namespace ptx {

template <class T> bool is_nan(T x) {
  if constexpr (is_float<T>) return std::isnan(x);
  else return false;
}
template <class T> bool nan(T a, T b) { return is_nan(a) || is_nan(b); }
template <class T> bool num(T a, T b) { return !nan(a, b); }
template <class T> bool eq(T a, T b) { return a == b; }
template <class T> bool ne(T a, T b) { return num(a, b) && a != b; }
template <class T> bool lt(T a, T b) { return a < b; }
template <class T> bool le(T a, T b) { return a <= b; }
template <class T> bool gt(T a, T b) { return a > b; }
template <class T> bool ge(T a, T b) { return a >= b; }
template <class T> bool equ(T a, T b) { return nan(a, b) || a == b; }
template <class T> bool neu(T a, T b) { return nan(a, b) || a != b; }
template <class T> bool ltu(T a, T b) { return nan(a, b) || a < b; }
template <class T> bool leu(T a, T b) { return nan(a, b) || a <= b; }
template <class T> bool gtu(T a, T b) { return nan(a, b) || a > b; }
template <class T> bool geu(T a, T b) { return nan(a, b) || a >= b; }
// Of unsigned numbers.
template <class T> bool lo(T a, T b) { return a < b; }
template <class T> bool ls(T a, T b) { return a <= b; }
template <class T> bool hi(T a, T b) { return a > b; }
template <class T> bool hs(T a, T b) { return a >= b; }

}  // namespace ptx
