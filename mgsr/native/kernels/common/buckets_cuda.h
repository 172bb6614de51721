// The backward pass over buckets of 32 splats, one warp each.
//
// A warp takes the tile's patches one after the other, a pixel to a lane, and walks those of its splats that touch the
// patch, nearest first. What the pixels say of a splat goes to the warp's own shared memory, and when there are eight
// splats, the lanes change sides: a splat and a row of eight pixels to a lane, which adds them up in registers. Four lanes
// have a splat's rows then, which are added and go to the splat's sums. All orders are fixed, and no atomics are needed: a
// pair's sums go to its own slot.
#pragma once

#include "kernels/common/tiles_cuda.h"

namespace mgsr {

constexpr int kBucketWarps = 2, kBucketThreads = kBucketWarps * kWarp;
constexpr int kChunk = 8;  // splats whose pixels are added up at once
static_assert(kChunk * kPatchHeight == kWarp, "a lane to each row of each splat");
constexpr int kTermsStride = kWarp + 1;  // of a splat's pixels: spreads what lanes read over the banks

// The bucket of a warp.
struct Bucket {
  int tile = 0, index = 0;  // index among the tile's
  int first = 0, count = 0; // its entries
  bool exists = false;

  __device__ Bucket(const Tiles& tiles, int number) {
    exists = number < tiles.bucket_ends[tiles.count - 1];
    if (!exists) return;
    int low = 0, high = tiles.count - 1;  // the tile is the first one whose buckets end behind this one
    while (low < high) {
      const int middle = (low + high) / 2;
      if (tiles.bucket_ends[middle] > number) high = middle;
      else low = middle + 1;
    }
    tile = low, index = number - first_bucket(tiles, tile);
    const int2 range = tiles.ranges[tile];
    first = range.x + index * kBucket;
    count = range.y - first < kBucket ? range.y - first : kBucket;
  }
};

// Where a lane stands when it adds up: which of a chunk's splats, and which row of the patch's pixels.
struct ChunkPlace {
  int splat, row;
  __device__ explicit ChunkPlace(int lane) : splat(lane % kChunk), row(lane / kChunk) {}
  __device__ int pixel(int column) const { return row * kPatchWidth + column; }
};

// Walks a bucket through the tile's patches. patches: those that the lane's splat touches, as bits.
// walk.enter(patch) makes the lane a pixel of the patch; false, for all lanes, when none of them is open.
// walk.meet(splat, place) lets the lane's pixel meet a splat of the bucket, and leaves what comes of it at that place.
// walk.add(splat) adds up, for the lane's row, what the pixels left at the place of its ChunkPlace, where they met that
// splat: -1, and nothing, if there was none.
template <class Walk>
__device__ inline void walk_patches(unsigned patches, Walk& walk) {
  const ChunkPlace mine(threadIdx.x % kWarp);
  for (int patch = 0; patch < kPatches; ++patch) {
    unsigned touching = __ballot_sync(kFullWarp, patches >> patch & 1);
    if (touching == 0 || !walk.enter(patch)) continue;
    while (touching) {
      int place = 0, met = -1;
      for (; touching && place < kChunk; ++place, touching &= touching - 1) {
        const int splat = __ffs(touching) - 1;
        walk.meet(splat, place);
        met = place == mine.splat ? splat : met;
      }
      __syncwarp();
      walk.add(met);
      __syncwarp();
    }
  }
}

// Sums [count] numbers over the rows of each splat of a chunk; a lane keeps a quarter, from count / 4 times its row on, as
// its first ones.
template <int count>
__device__ inline void sum_rows(float* numbers) {
  const int row = ChunkPlace(threadIdx.x % kWarp).row;
  const bool lower_half = row < 2, even = row % 2 == 0;
  for (int k = 0; k < count / 2; ++k) {
    const float low = numbers[k], high = numbers[count / 2 + k];
    const float kept = lower_half ? low : high, given = lower_half ? high : low;
    numbers[k] = kept + __shfl_xor_sync(kFullWarp, given, 2 * kChunk);
  }
  for (int k = 0; k < count / 4; ++k) {
    const float low = numbers[k], high = numbers[count / 4 + k];
    const float kept = even ? low : high, given = even ? high : low;
    numbers[k] = kept + __shfl_xor_sync(kFullWarp, given, kChunk);
  }
}

__device__ inline void add_scaled(float scale, float x, float& sum) { sum = fmaf(scale, x, sum); }

// fields: [kPairFields]
__device__ inline void write_pair(float* pairs, int slot, const float* fields) {
  float4* to = reinterpret_cast<float4*>(pairs + int64_t(slot) * kPairFields);
  for (int k = 0; k < kPairFields / 4; ++k)
    to[k] = make_float4(fields[4 * k], fields[4 * k + 1], fields[4 * k + 2], fields[4 * k + 3]);
}

}  // namespace mgsr
