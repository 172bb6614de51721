// From splats sorted by depth to, for each 8x8 tile, the list of splats that touch it, nearest first.
// Each entry also says which of the tile's four 4x4 sub-tiles are touched, and owns a slot: the place where the
// backward pass leaves that (splat, tile) pair's gradient. A splat's slots are consecutive.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "kernels/common/parallel.h"

namespace mgsr {

constexpr int kTile = 8;
constexpr int kSubTile = 4;

struct TileEntry {
  uint32_t splat_mask;  // position in depth order << 4 | sub-tile bits (bit 2*row + column)
  uint32_t slot;
};

// A range of pixels on the image, continuous coordinates; empty when x1 < x0 or y1 < y0.
struct PixelBox {
  float x0, x1, y0, y1;
};

struct TileLists {
  int tiles_x = 0, tiles_y = 0;
  std::vector<uint32_t> begin;       // [tiles + 1] into entries
  std::vector<TileEntry> entries;    // grouped by tile, in depth order
  std::vector<uint32_t> slot_begin;  // [splats + 1]
  int64_t pairs() const { return int64_t(entries.size()); }

  // rows(splat, y0, y1, x0, x1): the smallest x interval that holds all of the splat's points with y in [y0, y1];
  // false when there are none. boxes: [count]. Both take the position in depth order.
  template <class Rows>
  void build(int count, int width, int height, const PixelBox* boxes, const Rows& rows) {
    tiles_x = (width + kTile - 1) / kTile;
    tiles_y = (height + kTile - 1) / kTile;
    const int tiles = tiles_x * tiles_y;
    const int chunks = (count + kChunk - 1) / kChunk;
    found_.resize(std::max<size_t>(found_.size(), chunks));
    tile_counts_.assign(size_t(chunks) * tiles, 0);
    slot_begin.resize(count + 1);
    ThreadPool::instance().run(chunks, [&](int c) {
      const int first = c * kChunk, last = std::min(count, first + kChunk);
      found_[c].clear();
      for (int s = first; s < last; ++s) {
        slot_begin[s] = uint32_t(found_[c].size());
        find(s, width, height, boxes[s], rows, found_[c], &tile_counts_[size_t(c) * tiles]);
      }
    });
    const int64_t total = lay_out(chunks, tiles);
    entries.resize(total);
    ThreadPool::instance().run(chunks, [&](int c) {
      const int first = c * kChunk, last = std::min(count, first + kChunk);
      uint32_t* place = &tile_counts_[size_t(c) * tiles];
      uint32_t slot = chunk_slot_[c];
      for (const Found& f : found_[c]) entries[place[f.tile]++] = {f.splat_mask, slot++};
      for (int s = first; s < last; ++s) slot_begin[s] += chunk_slot_[c];
    });
    slot_begin[count] = uint32_t(total);
  }

 private:
  static constexpr int kChunk = 1024;
  struct Found {
    uint32_t tile, splat_mask;
  };

  // Columns of sub-tiles whose pixel centres lie in [x0, x1], as a first one and a number (0 when there are none).
  struct Columns {
    int first, number;
    // Whether column c is one of them, as 0 or 1.
    uint32_t has(int c) const { return uint32_t(c - first) < uint32_t(number); }
  };

  static Columns columns(float x0, float x1, int width) {
    // Pixel i counts when x0 <= i + 0.5 <= x1. Held to the image first, where truncation rounds down.
    const int first = int(std::min(std::max(x0 + 0.5f, 0.0f), float(width)));
    const int last = int(std::min(std::max(x1 + 0.5f, 0.0f), float(width))) - 1;
    if (first > last) return {0, 0};
    return {first / kSubTile, last / kSubTile - first / kSubTile + 1};
  }

  template <class Rows>
  void find(int s, int width, int height, const PixelBox& box, const Rows& rows, std::vector<Found>& out,
            uint32_t* counts) {
    const float top = std::max(std::ceil(box.y0 - 0.5f), 0.0f), bottom = std::min(std::floor(box.y1 - 0.5f), height - 1.0f);
    if (!(top <= bottom)) return;
    const int ty0 = int(top) / kTile, ty1 = int(bottom) / kTile;
    for (int ty = ty0; ty <= ty1; ++ty) {
      Columns span[2] = {{0, 0}, {0, 0}};
      for (int half = 0; half < 2; ++half) {
        const float y0 = std::max(top, float(ty * kTile + half * kSubTile));
        const float y1 = std::min(bottom, float(ty * kTile + half * kSubTile + kSubTile - 1));
        float x0, x1;
        if (y0 <= y1 && rows(s, y0 + 0.5f, y1 + 0.5f, x0, x1)) span[half] = columns(x0, x1, width);
      }
      if (span[0].number == 0 && span[1].number == 0) continue;
      const Columns &upper = span[0].number ? span[0] : span[1], &lower = span[1].number ? span[1] : span[0];
      const int tx0 = std::min(upper.first, lower.first) / 2;
      const int tx1 = (std::max(upper.first + upper.number, lower.first + lower.number) - 1) / 2;
      for (int tx = tx0; tx <= tx1; ++tx) {
        const uint32_t mask = span[0].has(2 * tx) | span[0].has(2 * tx + 1) << 1 | span[1].has(2 * tx) << 2 | span[1].has(2 * tx + 1) << 3;
        if (mask == 0) continue;
        const uint32_t tile = uint32_t(ty * tiles_x + tx);
        out.push_back({tile, uint32_t(s) << 4 | mask});
        ++counts[tile];
      }
    }
  }

  // Turns the counts into places: tile by tile, and within a tile chunk by chunk, which is depth order.
  int64_t lay_out(int chunks, int tiles) {
    begin.resize(tiles + 1);
    int64_t total = 0;
    for (int t = 0; t < tiles; ++t) {
      begin[t] = uint32_t(total);
      for (int c = 0; c < chunks; ++c) {
        uint32_t& n = tile_counts_[size_t(c) * tiles + t];
        const uint32_t here = n;
        n = uint32_t(total);
        total += here;
      }
    }
    begin[tiles] = uint32_t(total);
    chunk_slot_.resize(chunks);
    int64_t slot = 0;
    for (int c = 0; c < chunks; ++c) {
      chunk_slot_[c] = uint32_t(slot);
      slot += int64_t(found_[c].size());
    }
    if (slot >= int64_t(1) << 32) throw std::length_error("more than 2^32 pairs of splats and tiles: fewer or smaller splats are needed");
    return slot;
  }

  std::vector<std::vector<Found>> found_;
  std::vector<uint32_t> tile_counts_;
  std::vector<uint32_t> chunk_slot_;
};

// The outline of a splat with its centre at (x, y) and covariance (cxx, cxy, cyy), sqrt(r2) standard deviations out, in
// the form that cutting it into bands of rows needs: no division, two square roots a band.
struct Ellipse {
  float x, y;
  float hx, hy;   // half extents
  float at_right; // dy of the rightmost point
  float slope;    // the middle of the row at dy lies at x + slope dy ...
  float w2, k;    // ... and its half width is sqrt(w2 - k dy^2)

  // A hair wider than exact, so that rounding never loses a pixel that the blending would keep.
  static Ellipse make(float x, float y, float cxx, float cxy, float cyy, float r2) {
    const float det = cxx * cyy - cxy * cxy, hx = std::sqrt(r2 * cxx), hy = std::sqrt(r2 * cyy);
    return {x, y, hx + kSlack, hy + kSlack, cxy / cxx * hx, cxy / cyy, r2 * det / cyy, det / (cyy * cyy)};
  }

  PixelBox box() const { return {x - hx, x + hx, y - hy, y + hy}; }

  bool rows(float y0, float y1, float& x0, float& x1) const {
    const float low = std::max(y0 - y - kSlack, -hy), high = std::min(y1 - y + kSlack, hy);
    if (!(low <= high)) return false;
    const float right = std::min(std::max(at_right, low), high), left = std::min(std::max(-at_right, low), high);
    x1 = x + slope * right + std::sqrt(std::max(w2 - k * right * right, 0.0f)) + kSlack;
    x0 = x + slope * left - std::sqrt(std::max(w2 - k * left * left, 0.0f)) - kSlack;
    return true;
  }

 private:
  static constexpr float kSlack = 2e-3f;
};

// order: the indices of `keys` (all >= 0 and finite) from smallest to largest, ties by index.
class DepthSort {
 public:
  void sort(const std::vector<float>& keys, std::vector<uint32_t>& order) {
    const size_t n = keys.size();
    items_.resize(n), other_.resize(n), order.resize(n);
    for (size_t i = 0; i < n; ++i) {
      uint32_t bits;
      std::memcpy(&bits, &keys[i], 4);  // the bits of floats >= 0 are in the order of the floats
      items_[i] = {bits, uint32_t(i)};
    }
    for (int shift = 0; shift < 32; shift += 11) pass(shift);
    for (size_t i = 0; i < n; ++i) order[i] = items_[i].index;
  }

 private:
  struct Item {
    uint32_t key, index;
  };

  void pass(int shift) {
    uint32_t place[2048] = {};
    for (const Item& item : items_) ++place[item.key >> shift & 2047];
    uint32_t sum = 0;
    for (uint32_t& p : place) {
      const uint32_t here = p;
      p = sum;
      sum += here;
    }
    for (const Item& item : items_) other_[place[item.key >> shift & 2047]++] = item;
    items_.swap(other_);
  }

  std::vector<Item> items_, other_;
};

}  // namespace mgsr
