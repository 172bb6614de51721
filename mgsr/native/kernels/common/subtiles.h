// The structure of the blending loops: tiles over the threads, and in a tile its 4x4 sub-tiles, each with its own list.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

#include "kernels/common/binning.h"
#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {

// For each of a tile's sub-tiles, the entries of the tile that touch it, in depth order.
class SubTileLists {
 public:
  // Also prefetches the records of all splats of the tile at once, because they lie scattered in memory.
  template <class Record>
  void fill(const TileEntry* entries, int n, const Record* records) {
    splats_.resize(n), masks_.resize(n + kWidth);
    for (int e = 0; e < n; ++e) {
      __builtin_prefetch(records + entries[e].splat);
      splats_[e] = entries[e].splat, masks_[e] = int32_t(entries[e].mask);
    }
    std::fill(masks_.begin() + n, masks_.end(), 0);
    for (int s = 0; s < kSubTiles; ++s) pick(s, n);
  }

  const uint32_t* begin(int s) const { return entries_[s].data(); }
  int count(int s) const { return counts_[s]; }
  // Returns the splat of an entry.
  uint32_t splat(uint32_t entry) const { return splats_[entry]; }

 private:
  void pick(int s, int n) {
    auto& picked = entries_[s];
    if (picked.size() < size_t(n + kWidth)) picked.resize(n + kWidth);
    int count = 0;
    for (int e = 0; e < n; e += kWidth) {
      vint mask;
      std::memcpy(&mask, &masks_[e], sizeof(mask));
      count += pack_lanes((mask & 1 << s) != 0, uint32_t(e), &picked[count]);
    }
    counts_[s] = count;
  }

  std::vector<uint32_t> splats_;
  std::vector<int32_t> masks_;
  std::vector<uint32_t> entries_[kSubTiles];
  int counts_[kSubTiles] = {};
};

// Prefetches the records of the entries list[begin..end).
template <class Record>
inline void prefetch_records(const Record* records, const SubTileLists& sub, const uint32_t* list, int begin, int end) {
  for (int e = begin; e < end; ++e) __builtin_prefetch(records + sub.splat(list[e]));
}

// Calls work(tile, sub-tile lists, x0, y0) for every tile at (x0, y0), on all threads.
template <class Record, class Work>
void for_tiles(const TileLists& lists, const Record* records, const Work& work) {
  ThreadPool::instance().run(lists.tiles_x * lists.tiles_y, [&](int tile) {
    static thread_local SubTileLists sub;
    sub.fill(lists.entries.data() + lists.begin[tile], int(lists.begin[tile + 1] - lists.begin[tile]), records);
    work(tile, sub, tile % lists.tiles_x * kTile, tile / lists.tiles_x * kTile);
  });
}

// Calls body(s, x, y) for each sub-tile s at pixel (x, y) that lies on the image, of the tile at (x0, y0).
template <class Body>
void for_subtiles(int x0, int y0, int width, int height, const Body& body) {
  for (int s = 0; s < kSubTiles; ++s) {
    const int x = x0 + s % kSubTilesAcross * kSubTile, y = y0 + s / kSubTilesAcross * kSubTile;
    if (x < width && y < height) body(s, x, y);
  }
}

// Calls f(pixel index in the image, p) for the sub-tile's pixels p = 0..15 that lie on the image.
template <class F>
inline void for_pixels(int x0, int y0, int width, int height, const F& f) {
  for (int j = 0; j < kSubTile && y0 + j < height; ++j)
    for (int i = 0; i < kSubTile && x0 + i < width; ++i) f(int64_t(y0 + j) * width + x0 + i, j * kSubTile + i);
}

constexpr int kVectors = kSubTile * kSubTile / kWidth;  // vectors per sub-tile

// The 16 pixels of a sub-tile, as vectors of their centres' offsets from the corner (x0, y0). Every vector holds whole
// rows, so x is the same in all of them.
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
