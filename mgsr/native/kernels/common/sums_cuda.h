// Sums on the GPU: each block leaves its own, and the terms family adds those up in a fixed order.
#pragma once

#include "kernels/common/cuda.h"

namespace mgsr {

// What a block adds to a total and to the weight that it is divided by.
struct PartialSums {
  double total, weight;
};

// Writes the block's sums of the threads' values to *out. For blocks of whole warps, at most 1024 threads.
__device__ inline void write_block_sums(double total, double weight, PartialSums* out) {
  __shared__ PartialSums of_warps[kWarp];
  for (int by = kWarp / 2; by > 0; by /= 2) {
    total += __shfl_down_sync(kFullWarp, total, by);
    weight += __shfl_down_sync(kFullWarp, weight, by);
  }
  const int lane = threadIdx.x % kWarp, warp = threadIdx.x / kWarp, warps = blockDim.x / kWarp;
  __syncthreads();
  if (lane == 0) of_warps[warp] = {total, weight};
  __syncthreads();
  if (threadIdx.x != 0) return;
  PartialSums sums = {0.0, 0.0};
  for (int i = 0; i < warps; ++i) sums.total += of_warps[i].total, sums.weight += of_warps[i].weight;
  *out = sums;
}

}  // namespace mgsr
