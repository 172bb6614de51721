// Sums on the GPU. Each block writes its own sums, and the terms family adds them in a fixed order.
#pragma once

#include "kernels/common/cuda.h"

namespace mgsr {

// The contribution of a block to a total, and to the weight by which the total is divided.
struct PartialSums {
  double total, weight;
};

// Sums the threads' values over the block, and writes the sums to *out. Blocks must be of whole warps, at most 1024
// threads.
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
