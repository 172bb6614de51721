// Tiles of 16x16 pixels on the GPU: the tiles that a splat touches, and the buckets of their lists.
//
// A tile's list is processed in buckets of 32 splats, as many as a warp has lanes. The forward pass stores each pixel's
// state at the beginning of every bucket. So the backward pass can process each bucket on its own, one splat per lane.
#pragma once

#include "kernels/common/cuda.h"
#include "math/ellipse.h"

namespace mgsr {

constexpr int kTile = 16, kTilePixels = kTile * kTile;
constexpr int kBucket = kWarp;
constexpr float kCulledDepth = 3e38f;  // sorts after every visible splat
constexpr int kPairFields = 16;  // floats per gradient of a (splat, tile) pair

// The region in which a splat can count: inside its ellipse, and inside the circle if its radius is not 0.
struct alignas(16) SplatOutline {
  EllipseForm<float> ellipse;
  float x, y, radius;
  float unused;  // pads the struct to 48 bytes
};

// Rows of tiles, of the whole image or of a band of it; the end is excluded.
struct TileRows {
  int first, end;
};

__device__ inline TileRows all_rows(int height) { return {0, (height + kTile - 1) / kTile}; }

// The lists of all tiles of a band. Tiles are numbered from the band's first row on.
struct Tiles {
  int width, height;        // of the image, pixels
  int across, count;        // tiles in a row, and in the band
  TileRows rows;            // of the band
  const int2* ranges;       // [tiles] begin and end in entries
  const int2* entries;      // [pairs] splat and slot, grouped by tile, nearest first
  const int* bucket_ends;   // [tiles] for each tile, the first bucket after its own
};

__device__ inline int first_bucket(const Tiles& tiles, int tile) { return tile > 0 ? tiles.bucket_ends[tile - 1] : 0; }

// A pixel within its tile, by its number. The 32 pixels of a warp form a patch of 8x4, since neighbours have the same
// splats.
constexpr int kPatchWidth = 8, kPatchHeight = 4, kPatches = kTilePixels / kWarp;
struct TilePlace {
  int x, y;

  __device__ explicit TilePlace(int number) {
    const int patch = number / kWarp, place = number % kWarp;
    x = patch % 2 * kPatchWidth + place % kPatchWidth, y = patch / 2 * kPatchHeight + place / kPatchWidth;
  }
};

// A pixel of a tile, in the image; number 0 is the tile's corner.
struct TilePixel {
  int x, y;

  __device__ TilePixel(const Tiles& tiles, int tile, int number) {
    const TilePlace place(number);
    x = tile % tiles.across * kTile + place.x, y = (tiles.rows.first + tile / tiles.across) * kTile + place.y;
  }
  __device__ bool inside(const Tiles& tiles) const { return x < tiles.width && y < tiles.height; }
  __device__ int64_t index(const Tiles& tiles) const { return int64_t(y) * tiles.width + x; }
};

__device__ inline Columns outline_columns(const SplatOutline& s, float y0, float y1) {
  Columns c = ellipse_columns(s.ellipse, y0, y1);
  if (s.radius == 0.0f) return c;
  const float above = y0 - s.y, below = s.y - y1, beside = above > below ? above : below;
  const float dy = beside > 0.0f ? beside : 0.0f, half2 = s.radius * s.radius - dy * dy;
  if (!(half2 > 0.0f)) return c;
  const float half = sqrtf(half2), x0 = s.x - half, x1 = s.x + half;
  if (c.x1 < c.x0) return {x0, x1};
  return {c.x0 < x0 ? c.x0 : x0, c.x1 > x1 ? c.x1 : x1};
}

// Returns, as bits, the patches of a tile in which an outline can contain a pixel's centre. (x, y): the centre of the
// tile's first pixel. cut(y0, y1): returns the outline's columns between two rows, in the same coordinates.
template <class Cut>
__device__ inline unsigned touched_patches(float x, float y, const Cut& cut) {
  unsigned patches = 0;
  for (int row = 0; row < kTile / kPatchHeight; ++row) {
    const float y0 = y + float(row * kPatchHeight);
    const Columns c = cut(y0, y0 + (kPatchHeight - 1));
    if (!(c.x0 <= c.x1)) continue;
    if (c.x0 <= x + (kPatchWidth - 1) && c.x1 >= x) patches |= 1u << 2 * row;
    if (c.x0 <= x + (kTile - 1) && c.x1 >= x + kPatchWidth) patches |= 2u << 2 * row;
  }
  return patches;
}

// Returns, as bits, the patches that a splat touches in the tile with this corner.
__device__ inline unsigned touched_patches(const SplatOutline& s, const TilePixel& corner) {
  return touched_patches(float(corner.x) + 0.5f, float(corner.y) + 0.5f,
                         [&](float y0, float y1) { return outline_columns(s, y0, y1); });
}

__device__ inline bool finite(const float* values, int n) {
  float zero = 0.0f;
  for (int i = 0; i < n; ++i) zero += values[i] * 0.0f;
  return zero == 0.0f;
}

// Whether the box of an outline reaches the image.
__device__ inline bool on_image(const SplatOutline& s, int width, int height) {
  const EllipseForm<float>& e = s.ellipse;
  return fmaxf(e.x + e.hx + kOutlineSlack, s.x + s.radius) >= 0 && fminf(e.x - e.hx - kOutlineSlack, s.x - s.radius) <= width &&
         fmaxf(e.y + e.hy + kOutlineSlack, s.y + s.radius) >= 0 && fminf(e.y - e.hy - kOutlineSlack, s.y - s.radius) <= height;
}

// Calls visit(tile) for every tile of a band in which the outline contains a pixel's centre, row by row.
template <class Visit>
__device__ inline void for_touched_tiles(const SplatOutline& s, int width, int height, TileRows rows, const Visit& visit) {
  const float up = s.ellipse.y - s.ellipse.hy - kOutlineSlack, down = s.ellipse.y + s.ellipse.hy + kOutlineSlack;
  const float top = fmaxf(ceilf(fminf(up, s.y - s.radius) - 0.5f), 0.0f);
  const float bottom = fminf(floorf(fmaxf(down, s.y + s.radius) - 0.5f), height - 1.0f);
  if (!(top <= bottom)) return;
  const int across = (width + kTile - 1) / kTile;
  const int begin = int(top) / kTile, end = int(bottom) / kTile + 1;
  for (int row = begin < rows.first ? rows.first : begin; row < end && row < rows.end; ++row) {
    const float y0 = fmaxf(float(row * kTile), top), y1 = fminf(float(row * kTile + kTile - 1), bottom);
    const Columns c = outline_columns(s, y0 + 0.5f, y1 + 0.5f);
    if (c.x1 < c.x0) continue;
    // Pixel i counts if x0 <= i + 0.5 <= x1. The limits are clamped to the image first, so that truncation rounds down.
    const int first = int(held_between(c.x0 + 0.5f, 0.0f, float(width)));
    const int end = int(held_between(c.x1 + 0.5f, 0.0f, float(width)));
    if (first >= end) continue;
    for (int column = first / kTile; column <= (end - 1) / kTile; ++column) visit((row - rows.first) * across + column);
  }
}

__device__ inline int count_touched_tiles(const SplatOutline& s, int width, int height, TileRows rows) {
  int count = 0;
  for_touched_tiles(s, width, height, rows, [&](int) { ++count; });
  return count;
}

// Counts the tiles of the whole image that a splat touches.
__device__ inline int count_touched_tiles(const SplatOutline& s, int width, int height) {
  return count_touched_tiles(s, width, height, all_rows(height));
}

}  // namespace mgsr
