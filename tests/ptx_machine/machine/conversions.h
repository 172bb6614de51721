// Conversions between types, with PTX's rules for what doesn't fit.
#pragma once

#include "floats.h"

namespace ptx {

// Between integers, and from a wider float to a narrower in the usual rounding.
template <class To, class From> To convert(From x) { return static_cast<To>(x); }
template <class To, class From> To convert(int direction, From x) {
  return in_direction<To>(direction, [](volatile From& from) { return static_cast<To>(from); }, x);
}

template <class To, class From> To convert_sat(From x) {
  if constexpr (is_float<To>) {
    return saturate(static_cast<To>(x));
  } else {
    using Limits = std::numeric_limits<To>;
    if (Int128(x) < Int128(Limits::min())) return Limits::min();
    return Int128(x) > Int128(Limits::max()) ? Limits::max() : To(x);
  }
}

// To a whole number, of the same type or another; named by PTX's modifiers.
template <class T> T rni(T x) { return std::nearbyint(x); }
template <class T> T rzi(T x) { return std::trunc(x); }
template <class T> T rmi(T x) { return std::floor(x); }
template <class T> T rpi(T x) { return std::ceil(x); }

// A whole float as an integer: beyond the range its end; NaN is 0 in 32 bits and the top bit in 64.
template <class To, class From> To to_integer(From whole) {
  using Limits = std::numeric_limits<To>;
  constexpr bool wide = sizeof(From) == 8 || sizeof(To) == 8;
  if (std::isnan(whole)) return wide ? To(std::make_unsigned_t<To>(1) << (width<To> - 1)) : To(0);
  if (whole <= From(Limits::min())) return Limits::min();
  if (whole >= std::ldexp(From(1), Limits::digits)) return Limits::max();
  return static_cast<To>(whole);
}

}  // namespace ptx
