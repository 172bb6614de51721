// What the blending loops walk over: tiles over the threads, and in a tile four 4x4 sub-tiles, each with its own list.
#pragma once

#include <cstdint>
#include <vector>

#include "kernels/common/binning.h"
#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {

// An entry of a sub-tile's list: the splat's position in depth order, and the entry's position in the tile's list.
struct SubTileItem {
  uint32_t splat, entry;
};

// For each of a tile's four sub-tiles, the splats that touch it, in depth order.
class SubTileLists {
 public:
  // Also asks for the records of the splats to be brought near, all at once: they lie scattered.
  template <class Record>
  void fill(const TileEntry* entries, int n, const Record* records) {
    if (items_[0].size() < size_t(n) + 1)
      for (auto& items : items_) items.resize(n + 1);
    SubTileItem* end[4];
    for (int s = 0; s < 4; ++s) end[s] = items_[s].data();
    for (int e = 0; e < n; ++e) {
      const uint32_t splat = entries[e].splat_mask >> 4, mask = entries[e].splat_mask;
      __builtin_prefetch(records + splat);
      for (int s = 0; s < 4; ++s) {
        *end[s] = {splat, uint32_t(e)};  // overwritten by the next one unless it counts
        end[s] += mask >> s & 1;
      }
    }
    for (int s = 0; s < 4; ++s) counts_[s] = int(end[s] - items_[s].data());
  }

  const SubTileItem* begin(int s) const { return items_[s].data(); }
  int count(int s) const { return counts_[s]; }

 private:
  std::vector<SubTileItem> items_[4];
  int counts_[4] = {};
};

// Calls work(tile, sub-tile lists, x0, y0 of the tile) for every tile, on all threads.
template <class Record, class Work>
void for_tiles(const TileLists& lists, const Record* records, const Work& work) {
  ThreadPool::instance().run(lists.tiles_x * lists.tiles_y, [&](int tile) {
    static thread_local SubTileLists sub;
    sub.fill(lists.entries.data() + lists.begin[tile], int(lists.begin[tile + 1] - lists.begin[tile]),
             records);
    work(tile, sub, tile % lists.tiles_x * kTile, tile / lists.tiles_x * kTile);
  });
}

// Calls body(s, x, y) for the sub-tiles s = 0..3, at pixel (x, y), of the tile at (x0, y0) that lie on the image.
template <class Body>
void for_subtiles(int x0, int y0, int width, int height, const Body& body) {
  for (int s = 0; s < 4; ++s) {
    const int x = x0 + s % 2 * kSubTile, y = y0 + s / 2 * kSubTile;
    if (x < width && y < height) body(s, x, y);
  }
}

// Calls f(pixel index in the image, p) for the sub-tile's pixels p = 0..15 that lie on the image.
template <class F>
inline void for_pixels(int x0, int y0, int width, int height, const F& f) {
  for (int j = 0; j < kSubTile && y0 + j < height; ++j)
    for (int i = 0; i < kSubTile && x0 + i < width; ++i) f(int64_t(y0 + j) * width + x0 + i, j * kSubTile + i);
}

constexpr int kVectors = kSubTile * kSubTile / kWidth;  // vectors to a sub-tile

// The 16 pixels of a sub-tile as vectors: their centres' offsets from the corner (x0, y0). Every vector holds whole rows,
// so that x is the same in all.
struct Pixels {
  int x0, y0;
  vfloat x, y[kVectors];

  Pixels(int left, int top) : x0(left), y0(top) {
    for (int v = 0; v < kVectors; ++v)
      for (int lane = 0; lane < kWidth; ++lane) {
        x[lane] = float(lane % kSubTile) + 0.5f;
        y[v][lane] = float((v * kWidth + lane) / kSubTile) + 0.5f;
      }
  }
};

}  // namespace MGSR_ISA
}  // namespace mgsr
