// The backward pass over buckets of 32 splats, one warp each, a splat to each lane.
//
// The pixels of the tile that still let light through at the bucket's begin are handed through the warp: a pixel enters at
// lane 0, and at each step goes on to the next lane, so that it meets the bucket's splats in their order, while each lane
// adds up the gradient of its own splat in registers. Nothing is summed across lanes and no atomics are needed: a pair's
// sums go to its own slot.
#pragma once

#include "kernels/common/tiles_cuda.h"

namespace mgsr {

constexpr int kBucketWarps = 2, kBucketThreads = kBucketWarps * kWarp;
constexpr int kRing = 2 * kWarp;  // pixels in flight, and those that are loaded next

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

// Lists the numbers of the tile's pixels for which is_open(number); returns how many. list: [256], the warp's own.
template <class IsOpen>
__device__ inline int list_open_pixels(unsigned char* list, const IsOpen& is_open) {
  const int lane = threadIdx.x % kWarp;
  int count = 0;
  for (int first = 0; first < kTilePixels; first += kWarp) {
    const bool open = is_open(first + lane);
    const unsigned all = __ballot_sync(kFullWarp, open);
    if (open) list[count + __popc(all & ((1u << lane) - 1))] = (unsigned char)(first + lane);
    count += __popc(all);
  }
  __syncwarp();
  return count;
}

// Hands `count` pixels through the warp. load(i, place) puts pixel i into that place of the ring; enter(place) takes a
// pixel's state from there into lane 0; hand_on() passes states to the next lane; meet(place) lets the lane's splat act.
template <class Load, class Enter, class HandOn, class Meet>
__device__ inline void hand_through(int count, const Load& load, const Enter& enter, const HandOn& hand_on, const Meet& meet) {
  const int lane = threadIdx.x % kWarp;
  for (int step = 0; step < count + kWarp - 1; ++step) {
    if (step % kWarp == 0) {
      __syncwarp();
      if (step + lane < count) load(step + lane, (step + lane) % kRing);
      __syncwarp();
    }
    hand_on();
    if (lane == 0) enter(step % kRing);
    const int i = step - lane;
    if (i >= 0 && i < count) meet(i % kRing);
  }
}

// fields: [kPairFields]
__device__ inline void write_pair(float* pairs, int slot, const float* fields) {
  float4* to = reinterpret_cast<float4*>(pairs + int64_t(slot) * kPairFields);
  for (int k = 0; k < kPairFields / 4; ++k)
    to[k] = make_float4(fields[4 * k], fields[4 * k + 1], fields[4 * k + 2], fields[4 * k + 3]);
}

}  // namespace mgsr
