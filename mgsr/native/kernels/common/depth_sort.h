// Sorts splats by depth: a radix sort of the depths' bits, whose order is that of non-negative floats.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

namespace mgsr {

// The buffers of a sort, which keep their memory between sorts.
struct DepthSort {
  struct Item {
    uint32_t key, index;
  };
  std::vector<Item> items, other;
  std::vector<uint32_t> order;  // the result
};

namespace MGSR_ISA {

constexpr int kDigitBits = 11, kDigits = 3;
constexpr uint32_t kDigitValues = 1u << kDigitBits;

// Sorts items by one digit of their keys into `other`. counts [kDigitValues]: the frequency of each value; overwritten.
inline void sort_by_digit(DepthSort& sort, int shift, uint32_t* counts) {
  uint32_t sum = 0;
  for (uint32_t d = 0; d < kDigitValues; ++d) {
    const uint32_t here = counts[d];
    counts[d] = sum;
    sum += here;
  }
  for (const auto& item : sort.items) sort.other[counts[item.key >> shift & (kDigitValues - 1)]++] = item;
  sort.items.swap(sort.other);
}

// Writes to sort.order the indices of all depths that are not negative, from smallest to largest, ties by index.
inline void sort_by_depth(DepthSort& sort, const std::vector<float>& depths) {
  uint32_t counts[kDigits][kDigitValues] = {};
  sort.items.resize(depths.size());
  size_t n = 0;
  for (size_t i = 0; i < depths.size(); ++i) {
    uint32_t bits;
    std::memcpy(&bits, &depths[i], 4);
    sort.items[n] = {bits, uint32_t(i)};  // overwritten by the next one unless it counts
    n += depths[i] >= 0;
  }
  sort.items.resize(n), sort.other.resize(n), sort.order.resize(n);
  for (const auto& item : sort.items)
    for (int d = 0; d < kDigits; ++d) ++counts[d][item.key >> d * kDigitBits & (kDigitValues - 1)];
  for (int d = 0; d < kDigits; ++d) sort_by_digit(sort, d * kDigitBits, counts[d]);
  for (size_t i = 0; i < n; ++i) sort.order[i] = sort.items[i].index;
}

}  // namespace MGSR_ISA
}  // namespace mgsr
