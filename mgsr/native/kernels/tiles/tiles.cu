// The lists of splats for each tile, and the sums over a splat's tiles, for both branches.
//
// An image is processed in one band, or in several if its pairs are too many for the memory.
//
// tiles_count: a thread counts the tiles of a band that one splat touches.
// tiles_emit: a thread writes one splat's (tile, splat) pairs. Splats are in depth order, so after a stable sort by
// tile, each tile's list is nearest first. A pair's place before that sort is its slot, so a splat's slots are
// consecutive.
// tiles_list: a thread writes one entry of the sorted lists, and the range of a tile where it begins or ends.
// tiles_buckets: one block sums the tiles' buckets; a thread takes a range of neighbouring tiles.
// tiles_sum: 16 lanes sum one splat's pair gradients, one field each, in the order of the slots. There are no atomics,
// so every run gives the same bytes.
#include "kernels/common/tiles_cuda.h"

namespace mgsr {

constexpr int kTilesThreads = 256, kBucketsThreads = 1024;

struct CountParams {
  int64_t count;
  int width, height;
  TileRows rows;                 // of the band
  const SplatOutline* outlines;  // [count], set only for visible splats
  const int* in_all;             // [count] number of tiles of the image that each splat touches
  int* tile_counts;              // [count] number of tiles of the band
};

struct EmitParams {
  int64_t count;
  int width, height;
  TileRows rows;                 // of the band
  const SplatOutline* outlines;  // [count]
  const int64_t* order;          // [count] splats, nearest first
  const int* tile_counts;        // [count] number of tiles of the band
  const int64_t* ends;           // [count] inclusive prefix sums of the counts in depth order
  void* keys;                    // [pairs] tiles, of 2 or 4 bytes
  int key_bytes;
  int* owners;                   // [pairs] splats
};

struct ListParams {
  int64_t pairs;
  const void* keys;      // [pairs] sorted
  int key_bytes;
  const int64_t* slots;  // [pairs] the place of each before the sort
  const int* owners;     // [pairs] splats, before the sort
  int2* entries;         // [pairs]
  int2* ranges;          // [tiles], zero at the start
};

struct BucketsParams {
  int tiles;
  const int2* ranges;  // [tiles]
  int* bucket_ends;    // [tiles]
};

struct SumParams {
  int64_t count;
  const int64_t* order;    // as in EmitParams
  const int* tile_counts;
  const int64_t* ends;
  const float* pairs;      // [pairs, kPairFields] by slot
  float* sums;             // [count, kPairFields] by splat
};

__device__ inline int tile_key(const void* keys, int bytes, int64_t i) {
  return bytes == 2 ? static_cast<const int16_t*>(keys)[i] : static_cast<const int*>(keys)[i];
}

__device__ inline int tile_buckets(const BucketsParams& p, int tile) {
  return (p.ranges[tile].y - p.ranges[tile].x + kBucket - 1) / kBucket;
}

}  // namespace mgsr

MGSR_KERNEL(tiles_count, mgsr::CountParams, mgsr::kTilesThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kTilesThreads + threadIdx.x;
  if (i >= p.count) return;
  p.tile_counts[i] = p.in_all[i] > 0 ? count_touched_tiles(p.outlines[i], p.width, p.height, p.rows) : 0;
}

MGSR_KERNEL(tiles_emit, mgsr::EmitParams, mgsr::kTilesThreads) {
  using namespace mgsr;
  const int64_t rank = int64_t(blockIdx.x) * kTilesThreads + threadIdx.x;
  if (rank >= p.count) return;
  const int64_t splat = p.order[rank];
  const int count = p.tile_counts[splat];
  if (count == 0) return;
  int64_t slot = p.ends[rank] - count;
  for_touched_tiles(p.outlines[splat], p.width, p.height, p.rows, [&](int tile) {
    if (p.key_bytes == 2) static_cast<int16_t*>(p.keys)[slot] = int16_t(tile);
    else static_cast<int*>(p.keys)[slot] = tile;
    p.owners[slot++] = int(splat);
  });
}

MGSR_KERNEL(tiles_list, mgsr::ListParams, mgsr::kTilesThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kTilesThreads + threadIdx.x;
  if (i >= p.pairs) return;
  const int slot = int(p.slots[i]), tile = tile_key(p.keys, p.key_bytes, i);
  p.entries[i] = make_int2(p.owners[slot], slot);
  if (i == 0 || tile_key(p.keys, p.key_bytes, i - 1) != tile) p.ranges[tile].x = int(i);
  if (i + 1 == p.pairs || tile_key(p.keys, p.key_bytes, i + 1) != tile) p.ranges[tile].y = int(i + 1);
}

MGSR_KERNEL(tiles_buckets, mgsr::BucketsParams, mgsr::kBucketsThreads) {
  using namespace mgsr;
  __shared__ int sums[kBucketsThreads];
  const int each = (p.tiles + kBucketsThreads - 1) / kBucketsThreads, begin = threadIdx.x * each;
  const int end = begin + each < p.tiles ? begin + each : p.tiles;
  int sum = 0;
  for (int tile = begin; tile < end; ++tile) sum += tile_buckets(p, tile);
  sums[threadIdx.x] = sum;
  for (int by = 1; by < kBucketsThreads; by *= 2) {
    __syncthreads();
    const int before = int(threadIdx.x) >= by ? sums[threadIdx.x - by] : 0;
    __syncthreads();
    sums[threadIdx.x] += before;
  }
  int total = sums[threadIdx.x] - sum;
  for (int tile = begin; tile < end; ++tile) p.bucket_ends[tile] = total += tile_buckets(p, tile);
}

MGSR_KERNEL(tiles_sum, mgsr::SumParams, mgsr::kTilesThreads) {
  using namespace mgsr;
  const int64_t rank = (int64_t(blockIdx.x) * kTilesThreads + threadIdx.x) / kPairFields;
  const int field = threadIdx.x % kPairFields;
  if (rank >= p.count) return;
  const int64_t splat = p.order[rank];
  const int count = p.tile_counts[splat];
  const float* pairs = p.pairs + (p.ends[rank] - count) * kPairFields + field;
  // Four independent sums, which don't wait for one another.
  float sums[4] = {};
  int i = 0;
  for (; i + 4 <= count; i += 4)
    for (int k = 0; k < 4; ++k) sums[k] += pairs[int64_t(i + k) * kPairFields];
  for (; i < count; ++i) sums[0] += pairs[int64_t(i) * kPairFields];
  p.sums[splat * kPairFields + field] = (sums[0] + sums[1]) + (sums[2] + sums[3]);
}
