// Gradients of (splat, tile) pairs in the backward pass. Each tile writes them to their slots; then they are added by
// splat.
#pragma once

#include <algorithm>
#include <cstring>
#include <vector>

#include "kernels/common/subtiles.h"

namespace mgsr {
namespace MGSR_ISA {

constexpr int kPairFields = 16;  // floats per pair: one cache line

// Calls walk(sub-tile lists, x0, y0, pairs) for every tile, on all threads. The walk adds to pairs
// [tile's entries, kPairFields], which start at zero. gradients: receives them by slot.
template <class Record, class Walk>
void walk_tiles(const TileLists& lists, const Record* records, std::vector<float>& gradients, const Walk& walk) {
  gradients.resize(size_t(lists.pairs()) * kPairFields);
  for_tiles(lists, records, [&](int tile, const SubTileLists& sub, int x0, int y0) {
    static thread_local std::vector<float> pairs;
    const int64_t first = lists.begin[tile], n = lists.begin[tile + 1] - first;
    pairs.assign(size_t(n) * kPairFields, 0.0f);
    walk(sub, x0, y0, pairs.data());
    for (int64_t e = 0; e < n; ++e)
      std::memcpy(&gradients[size_t(lists.entries[first + e].slot) * kPairFields], &pairs[size_t(e) * kPairFields],
                  sizeof(float) * kPairFields);
  });
}

// Sums the pairs of a splat in the order of their slots, which does not depend on the number of threads.
inline void sum_pairs(const TileLists& lists, const std::vector<float>& gradients, int64_t splat, float sums[kPairFields]) {
  const TileLists::Span span = lists.spans[splat];
  const float* pairs = gradients.data() + size_t(lists.chunk_slots[splat / kSplatChunk]) * kPairFields;
  std::fill_n(sums, kPairFields, 0.0f);
  for (uint32_t slot = span.begin; slot < span.end; ++slot)
    for (int k = 0; k < kPairFields; ++k) sums[k] += pairs[size_t(slot) * kPairFields + k];
}

}  // namespace MGSR_ISA
}  // namespace mgsr
