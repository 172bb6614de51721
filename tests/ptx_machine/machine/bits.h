// Registers hold bits; instructions read and write them as their types.
#pragma once

#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

namespace ptx {

struct FloatPair {
  float x, y;
};

// The low bits of a register as T.
template <class T, class Bits>
T read(Bits bits) {
  if constexpr (std::is_integral_v<T>) {
    return static_cast<T>(bits);
  } else {
    static_assert(sizeof(T) == sizeof(Bits), "a register of another width than the instruction's type");
    T value;
    std::memcpy(&value, &bits, sizeof(T));
    return value;
  }
}

// A register wider than T is filled up with T's sign, or with zeros.
template <class T, class Bits>
void write(Bits& place, T value) {
  if constexpr (std::is_integral_v<T>) {
    place = static_cast<Bits>(value);
  } else {
    static_assert(sizeof(T) == sizeof(Bits), "a register of another width than the instruction's type");
    std::memcpy(&place, &value, sizeof(T));
  }
}

template <class T>
T load_bytes(const unsigned char* at, int index) {
  T value;
  std::memcpy(&value, at + size_t(index) * sizeof(T), sizeof(T));
  return value;
}

template <class T>
void store_bytes(unsigned char* at, int index, T value) {
  std::memcpy(at + size_t(index) * sizeof(T), &value, sizeof(T));
}

template <class T>
constexpr int width = int(8 * sizeof(T));

// The integer type of twice T's width and of its sign; of 64 bits, the compiler's own of 128.
__extension__ typedef __int128 Int128;
__extension__ typedef unsigned __int128 UnsignedInt128;
template <class T>
struct Twice;
template <> struct Twice<int16_t> { using Type = int32_t; };
template <> struct Twice<uint16_t> { using Type = uint32_t; };
template <> struct Twice<int32_t> { using Type = int64_t; };
template <> struct Twice<uint32_t> { using Type = uint64_t; };
template <> struct Twice<int64_t> { using Type = Int128; };
template <> struct Twice<uint64_t> { using Type = UnsignedInt128; };

}  // namespace ptx
