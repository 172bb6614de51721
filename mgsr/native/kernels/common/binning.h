// Binning: for each 16x16 tile, the list of splats that touch it, nearest first.
// Each entry also tells which of the tile's 4x4 sub-tiles the splat touches. Its slot is the place where the backward
// pass stores the gradient of this (splat, tile) pair. The slots of a splat are consecutive.
//
// While splats are projected, in chunks over the threads, find_tiles() finds their tiles in the order of the splats.
// Once the depth order is known, lay_out_lists() fills the lists in that order.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "kernels/common/ellipse.h"
#include "kernels/common/parallel.h"

namespace mgsr {

constexpr int kTile = 16;
constexpr int kSubTile = 4;
constexpr int kSubTilesAcross = kTile / kSubTile, kSubTiles = kSubTilesAcross * kSubTilesAcross;
constexpr int kSplatChunk = 512;

struct TileEntry {
  uint32_t splat, slot;
  uint32_t mask;  // of sub-tiles: bit kSubTilesAcross * row + column
};

// The lists of all tiles. They keep their memory between frames.
struct TileLists {
  int width = 0, height = 0;  // of the image, pixels
  int tiles_x = 0, tiles_y = 0;
  std::vector<uint32_t> begin;     // [tiles + 1] into entries
  std::vector<TileEntry> entries;  // grouped by tile, in depth order
  int64_t pairs() const { return int64_t(entries.size()); }

  // A tile that a splat touches.
  struct Found {
    uint32_t tile, mask;
  };
  // The tiles of a splat, as positions in its chunk's list.
  struct Span {
    uint32_t begin = 0, end = 0;
  };
  struct Chunk {
    std::vector<Found> items;
    uint32_t count = 0;  // number of items in use
  };
  std::vector<Chunk> found;               // by chunk of splats
  std::vector<Span> spans;                // [splats]
  std::vector<uint32_t> chunk_slots;      // the first slot of each chunk of splats
  std::vector<uint32_t> tile_counts;      // [chunks of the depth order, tiles]; later places in `entries`
};

namespace MGSR_ISA {

inline void start_lists(TileLists& lists, int64_t splats, int width, int height) {
  lists.width = width, lists.height = height;
  lists.tiles_x = (width + kTile - 1) / kTile, lists.tiles_y = (height + kTile - 1) / kTile;
  const size_t chunks = size_t(splats + kSplatChunk - 1) / kSplatChunk;
  lists.found.resize(std::max(lists.found.size(), chunks));
  lists.chunk_slots.resize(chunks);
  lists.spans.resize(splats);
}

// The columns of sub-tiles, [first, end), that an outline touches in each of kWidth bands of kSubTile rows.
struct BandColumns {
  vint first, end;
};

// Cuts an outline into the bands from row y on, without rows above `top` or below `bottom`.
template <class Outline>
inline BandColumns cut_bands(const Outline& outline, int y, float top, float bottom, int width) {
  vfloat start;
  for (int lane = 0; lane < kWidth; ++lane) start[lane] = float(y + kSubTile * lane);
  const vfloat y0 = max(start, splat(top)), y1 = min(start + float(kSubTile - 1), splat(bottom));
  const Intervals cut = outline.cut(y0 + 0.5f, y1 + 0.5f);
  // Pixel i counts if x0 <= i + 0.5 <= x1. The limits are clamped to the image first, so that truncation rounds down.
  const vfloat right = splat(float(width));
  const vint first = __builtin_convertvector(min(max(cut.x0 + 0.5f, vfloat{}), right), vint);
  const vint end = __builtin_convertvector(min(max(cut.x1 + 0.5f, vfloat{}), right), vint);
  const vint any = cut.any & (y0 <= y1) & (first < end);
  return {first / kSubTile, any & (end + (kSubTile - 1)) / kSubTile};
}

// Returns, for each band, the bits of its sub-tiles in the tile whose first column of sub-tiles is `column`.
inline vint sub_tile_bits(const BandColumns& bands, int column) {
  const auto held = [](vint x) {
    x = x > 0 ? x : vint{};
    return x < kSubTilesAcross ? x : vint{} + kSubTilesAcross;
  };
  const vint first = held(bands.first - column), end = held(bands.end - column), one = vint{} + 1;
  vint place;
  for (int lane = 0; lane < kWidth; ++lane) place[lane] = lane % kSubTilesAcross * kSubTilesAcross;
  return (((one << end) - (one << first)) & (first < end)) << place;
}

// Writes the tiles that the bands touch, in the columns [x0, x1] and the rows of tiles from `row` on. Returns the end.
inline TileLists::Found* write_tiles(const BandColumns& bands, const TileLists& lists, int row, int x0, int x1,
                                     TileLists::Found* out) {
  for (int x = x0; x <= x1; ++x) {
    uint32_t bits[kWidth];
    const vint sub_tiles = sub_tile_bits(bands, x * kSubTilesAcross);
    std::memcpy(bits, &sub_tiles, sizeof(bits));
    for (int r = 0; r < kWidth / kSubTilesAcross; ++r) {
      uint32_t mask = 0;
      for (int band = 0; band < kSubTilesAcross; ++band) mask |= bits[r * kSubTilesAcross + band];
      *out = {uint32_t((row + r) * lists.tiles_x + x), mask};  // overwritten by the next one unless it counts
      out += mask != 0;
    }
  }
  return out;
}

// Records the tiles that a splat's outline touches. The splats of a chunk must come in order. An Outline has two
// methods:
// box() returns a PixelBox, and cut(y0, y1) returns Intervals.
template <class Outline>
inline void find_tiles(TileLists& lists, int64_t splat, const Outline& outline) {
  constexpr int kRows = kWidth / kSubTilesAcross;  // rows of tiles per vector of bands
  TileLists::Chunk& chunk = lists.found[splat / kSplatChunk];
  const PixelBox box = outline.box();
  const float top = std::max(std::ceil(box.y0 - 0.5f), 0.0f), bottom = std::min(std::floor(box.y1 - 0.5f), lists.height - 1.0f);
  lists.spans[splat].begin = lists.spans[splat].end = chunk.count;
  if (!(top <= bottom)) return;
  const int x0 = int(std::max(box.x0, 0.0f)) / kTile, x1 = int(std::min(box.x1, lists.width - 1.0f)) / kTile;
  const int y0 = int(top) / kTile, y1 = int(bottom) / kTile;
  const size_t most = chunk.count + size_t(std::max(x1 - x0 + 1, 0)) * (y1 - y0 + kRows) + 1;
  if (chunk.items.size() < most) chunk.items.resize(2 * most);
  TileLists::Found* out = &chunk.items[chunk.count];
  for (int row = y0; row <= y1; row += kRows)
    out = write_tiles(cut_bands(outline, row * kTile, top, bottom, lists.width), lists, row, x0, x1, out);
  lists.spans[splat].end = chunk.count = uint32_t(out - chunk.items.data());
}

inline void number_slots(TileLists& lists) {
  int64_t slot = 0;
  for (size_t c = 0; c < lists.chunk_slots.size(); ++c) {
    lists.chunk_slots[c] = uint32_t(slot);
    slot += lists.found[c].count;
  }
  if (slot >= int64_t(1) << 32) throw std::length_error("more than 2^32 pairs of splats and tiles: fewer or smaller splats are needed");
  lists.entries.resize(slot);
}

// Converts counts to places in the lists: tile by tile, and within a tile chunk by chunk, which is depth order.
inline void place_tiles(TileLists& lists, int chunks) {
  const int tiles = lists.tiles_x * lists.tiles_y;
  lists.begin.resize(tiles + 1);
  uint32_t total = 0;
  for (int t = 0; t < tiles; ++t) {
    lists.begin[t] = total;
    for (int c = 0; c < chunks; ++c) {
      uint32_t& n = lists.tile_counts[size_t(c) * tiles + t];
      const uint32_t here = n;
      n = total;
      total += here;
    }
  }
  lists.begin[tiles] = total;
}

// Fills the lists. order: the splats, nearest first.
inline void lay_out_lists(TileLists& lists, const std::vector<uint32_t>& order) {
  // There are few chunks, since each has a count for every tile. Their number does not depend on the number of threads.
  constexpr int64_t kLeast = 1024, kMost = 16;
  const int64_t count = int64_t(order.size()), size = std::max(kLeast, (count + kMost - 1) / kMost);
  const int chunks = int((count + size - 1) / size), tiles = lists.tiles_x * lists.tiles_y;
  const auto walk = [&](int c, const auto& visit) {
    for (int64_t s = c * size; s < std::min(count, (c + 1) * size); ++s) {
      const uint32_t splat = order[s], chunk = splat / kSplatChunk;
      const TileLists::Span span = lists.spans[splat];
      const TileLists::Found* found = lists.found[chunk].items.data();
      for (uint32_t f = span.begin; f < span.end; ++f) visit(splat, found[f], lists.chunk_slots[chunk] + f);
    }
  };
  number_slots(lists);
  lists.tile_counts.assign(size_t(chunks) * tiles, 0);
  ThreadPool::instance().run(chunks, [&](int c) {
    uint32_t* counts = &lists.tile_counts[size_t(c) * tiles];
    walk(c, [&](uint32_t, const TileLists::Found& f, uint32_t) { ++counts[f.tile]; });
  });
  place_tiles(lists, chunks);
  ThreadPool::instance().run(chunks, [&](int c) {
    uint32_t* places = &lists.tile_counts[size_t(c) * tiles];
    walk(c, [&](uint32_t splat, const TileLists::Found& f, uint32_t slot) {
      lists.entries[places[f.tile]++] = {splat, slot, f.mask};
    });
  });
}

}  // namespace MGSR_ISA
}  // namespace mgsr
