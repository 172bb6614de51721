// The backward pass over buckets of 32 splats, one warp each.
//
// A warp takes the tile's patches one after the other, one pixel per lane, and walks its splats that touch the patch,
// nearest first. The pixels write their contributions to a splat's gradient to the warp's own shared memory. After
// eight splats, the lanes switch roles: each lane takes one splat and one row of eight pixels, and adds them in
// registers. The four rows of a splat are then added to the splat's sums. All orders are fixed. No atomics are needed,
// since the sums of a pair go to its own slot.
#pragma once

#include "kernels/common/tiles_cuda.h"

namespace mgsr {

constexpr int kBucketWarps = 2, kBucketThreads = kBucketWarps * kWarp;
constexpr int kChunk = 8;  // splats whose pixels are added at once
static_assert(kChunk * kPatchHeight == kWarp, "a lane to each row of each splat");
constexpr int kTermsStride = kWarp + 1;  // one more than the pixels of a splat, to avoid bank conflicts

// The bucket of a warp.
struct Bucket {
  int tile = 0, index = 0;  // index: among the buckets of the tile
  int first = 0, count = 0; // its entries
  bool exists = false;

  __device__ Bucket(const Tiles& tiles, int number) {
    exists = number < tiles.bucket_ends[tiles.count - 1];
    if (!exists) return;
    int low = 0, high = tiles.count - 1;  // the tile is the first one whose buckets end after this one
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

// The role of a lane in the addition: its splat within the chunk, and its row of the patch's pixels.
struct ChunkPlace {
  int splat, row;
  __device__ explicit ChunkPlace(int lane) : splat(lane % kChunk), row(lane / kChunk) {}
  __device__ int pixel(int column) const { return row * kPatchWidth + column; }
};

// Walks a bucket through the tile's patches. patches: the patches that the lane's splat touches, as bits.
// walk.enter(patch) assigns the lane a pixel of the patch. It returns false, in all lanes, if all pixels are finished.
// walk.meet(splat, place) computes the contribution of the lane's pixel to a splat of the bucket, and stores it at
// `place`.
// walk.add(splat) adds the stored contributions at the place of the lane's ChunkPlace, over the lane's row. splat: the
// splat at that place, or -1 for none, which adds nothing.
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

// Sums [count] numbers over the rows of each splat of a chunk. Each lane keeps a quarter of the sums as its first
// numbers:
// those from count / 4 times its row on.
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

// Writes the fields [kPairFields] of a pair to its slot.
__device__ inline void write_pair(float* pairs, int slot, const float* fields) {
  float4* to = reinterpret_cast<float4*>(pairs + int64_t(slot) * kPairFields);
  for (int k = 0; k < kPairFields / 4; ++k)
    to[k] = make_float4(fields[4 * k], fields[4 * k + 1], fields[4 * k + 2], fields[4 * k + 3]);
}

}  // namespace mgsr
