// Integer instructions, by PTX's names. Sums and products wrap around.
#pragma once

#include <algorithm>

#include "bits.h"

namespace ptx {

template <class T> constexpr bool is_integer = std::is_integral_v<T>;
template <class T> using IfInteger = std::enable_if_t<is_integer<T>, int>;

template <class T, IfInteger<T> = 0> T add(T a, T b) { return T(uint64_t(a) + uint64_t(b)); }
template <class T, IfInteger<T> = 0> T sub(T a, T b) { return T(uint64_t(a) - uint64_t(b)); }
template <class T, IfInteger<T> = 0> T mul_lo(T a, T b) { return T(uint64_t(a) * uint64_t(b)); }
template <class T> T mul_hi(T a, T b) {
  using Wide = typename Twice<T>::Type;
  return T((Wide(a) * Wide(b)) >> width<T>);
}
template <class T> typename Twice<T>::Type mul_wide(T a, T b) {
  using Wide = typename Twice<T>::Type;
  return Wide(a) * Wide(b);
}
template <class T> T mad_lo(T a, T b, T c) { return add(mul_lo(a, b), c); }
template <class T> T mad_hi(T a, T b, T c) { return add(mul_hi(a, b), c); }
template <class T, class Wide> Wide mad_wide(T a, T b, Wide c) { return add(Wide(mul_wide(a, b)), c); }

inline int32_t clamp_to_int32(int64_t x) { return int32_t(std::clamp<int64_t>(x, INT32_MIN, INT32_MAX)); }
inline int32_t add_sat(int32_t a, int32_t b) { return clamp_to_int32(int64_t(a) + b); }
inline int32_t sub_sat(int32_t a, int32_t b) { return clamp_to_int32(int64_t(a) - b); }

template <class T, IfInteger<T> = 0> T neg(T a) { return T(0 - uint64_t(a)); }
template <class T, IfInteger<T> = 0> T abs(T a) { return a < 0 ? neg(a) : a; }

// What a division by zero gives is left open by PTX; GPUs give all ones.
template <class T, IfInteger<T> = 0> T div(T a, T b) {
  if (b == 0) return T(~T(0));
  if constexpr (std::is_signed_v<T>) if (b == T(-1)) return neg(a);
  return T(a / b);
}
template <class T, IfInteger<T> = 0> T rem(T a, T b) {
  if (b == 0) return a;
  if constexpr (std::is_signed_v<T>) if (b == T(-1)) return 0;
  return T(a % b);
}

template <class T, IfInteger<T> = 0> T min(T a, T b) { return a < b ? a : b; }
template <class T, IfInteger<T> = 0> T max(T a, T b) { return a > b ? a : b; }
template <class T, IfInteger<T> = 0> T min(T a, T b, T c) { return min(min(a, b), c); }
template <class T, IfInteger<T> = 0> T max(T a, T b, T c) { return max(max(a, b), c); }
template <class T> T sad(T a, T b, T c) { return add(c, a < b ? sub(b, a) : sub(a, b)); }

template <class T> T and_(T a, T b) { return T(a & b); }
template <class T> T or_(T a, T b) { return T(a | b); }
template <class T> T xor_(T a, T b) { return T(a ^ b); }
template <class T> T not_(T a) {
  if constexpr (std::is_same_v<T, bool>) return !a;
  else return T(~a);
}
template <class T> T cnot(T a) { return T(a == 0); }

// Of three bits a, b, c, the result is bit 4a + 2b + c of the table.
inline uint32_t lop3(uint32_t a, uint32_t b, uint32_t c, uint32_t table) {
  uint32_t result = 0;
  for (uint32_t row = 0; row < 8; ++row)
    if (table >> row & 1) result |= (row & 4 ? a : ~a) & (row & 2 ? b : ~b) & (row & 1 ? c : ~c);
  return result;
}

// Shifts by the width or more leave nothing but the sign.
template <class T> T shl(T a, uint32_t by) { return by >= width<T> ? T(0) : T(uint64_t(a) << by); }
template <class T> T shr(T a, uint32_t by) {
  if (by >= width<T>) return std::is_signed_v<T> && a < 0 ? T(-1) : T(0);
  return T(a >> by);
}

inline uint32_t funnel_shift_amount(uint32_t by, bool wrap) { return wrap ? by & 31 : std::min<uint32_t>(by, 32); }
inline uint32_t shf_l(uint32_t low, uint32_t high, uint32_t by, bool wrap) {
  const uint64_t both = uint64_t(high) << 32 | low;
  return uint32_t(both << funnel_shift_amount(by, wrap) >> 32);
}
inline uint32_t shf_r(uint32_t low, uint32_t high, uint32_t by, bool wrap) {
  const uint64_t both = uint64_t(high) << 32 | low;
  return uint32_t(both >> funnel_shift_amount(by, wrap));
}

// Each nibble of the selector picks a byte of b:a, or that byte's sign alone.
inline uint32_t prmt(uint32_t a, uint32_t b, uint32_t selector) {
  const uint64_t bytes = uint64_t(b) << 32 | a;
  uint32_t result = 0;
  for (int i = 0; i < 4; ++i) {
    const uint32_t nibble = selector >> (4 * i) & 15;
    uint32_t byte = uint32_t(bytes >> (8 * (nibble & 7))) & 255;
    if (nibble & 8) byte = byte & 128 ? 255 : 0;
    result |= byte << (8 * i);
  }
  return result;
}

template <class T> uint32_t popc(T a) { return uint32_t(__builtin_popcountll(a)); }
template <class T> uint32_t clz(T a) { return a ? uint32_t(__builtin_clzll(a)) - (64 - width<T>) : uint32_t(width<T>); }
template <class T> T brev(T a) {
  T reversed = 0;
  for (int i = 0; i < width<T>; ++i) reversed |= T((a >> i) & 1) << (width<T> - 1 - i);
  return reversed;
}

// The place of the highest bit that is not the sign's, from below or, as shiftamt, from above; all ones for none.
template <class T> uint32_t bfind(T a) {
  using Unsigned = std::make_unsigned_t<T>;
  const Unsigned bits = a < 0 ? Unsigned(~a) : Unsigned(a);
  return bits ? uint32_t(width<T> - 1) - clz(bits) : ~0u;
}
template <class T> uint32_t bfind_shiftamt(T a) {
  const uint32_t place = bfind(a);
  return place == ~0u ? place : uint32_t(width<T> - 1) - place;
}

// Bits [position, position + length) of a, moved down; s types repeat the field's top bit.
template <class T> T bfe(T a, uint32_t position, uint32_t length) {
  position &= 255, length &= 255;
  const auto bit = [a](uint32_t i) { return T(std::make_unsigned_t<T>(a) >> i & 1); };
  const uint32_t top = std::min<uint32_t>(position + length - 1, width<T> - 1);
  const T sign = std::is_unsigned_v<T> || length == 0 ? T(0) : bit(top);
  std::make_unsigned_t<T> result = 0;
  for (uint32_t i = 0; i < width<T>; ++i) {
    const T from = i < length && position + i < width<T> ? bit(position + i) : sign;
    result |= std::make_unsigned_t<T>(from) << i;
  }
  return T(result);
}

// b, with the lowest bits of a in [position, position + length).
template <class T> T bfi(T a, T b, uint32_t position, uint32_t length) {
  position &= 255, length &= 255;
  T result = b;
  for (uint32_t i = 0; i < length && position + i < width<T>; ++i) {
    const T one = T(T(1) << (position + i));
    result = T((result & ~one) | ((a >> i & 1) ? one : T(0)));
  }
  return result;
}

inline uint32_t bmsk(uint32_t position, uint32_t length, bool wrap) {
  if (wrap) position &= 31, length &= 31;
  return bfi<uint32_t>(~0u, 0u, std::min<uint32_t>(position, 32), std::min<uint32_t>(length, 32));
}

}  // namespace ptx
