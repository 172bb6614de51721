// Kernels that show what the shim finds: races, and barriers that not all threads reach.
#include "kernels/common/cuda.h"

struct MisuseParams {
  float* out;
};

// Sums a block's numbers through shared memory, with the barrier that this needs.
MGSR_KERNEL(reversed, MisuseParams, 64) {
  __shared__ float values[64];
  values[threadIdx.x] = float(threadIdx.x);
  __syncthreads();
  p.out[threadIdx.x] = values[63 - threadIdx.x];
}

MGSR_KERNEL(races, MisuseParams, 64) {
  __shared__ float values[64];
  values[threadIdx.x] = float(threadIdx.x);
  p.out[threadIdx.x] = values[63 - threadIdx.x];
}

MGSR_KERNEL(sums_of_warps, MisuseParams, 64) {
  float sum = float(threadIdx.x);
  for (int by = 16; by > 0; by /= 2) sum += __shfl_down_sync(mgsr::kFullWarp, sum, by);
  sum = __shfl_sync(mgsr::kFullWarp, sum, 0);
  p.out[threadIdx.x] = sum + float(__syncthreads_count(threadIdx.x < 10));
}

MGSR_KERNEL(leaves_early, MisuseParams, 64) {
  if (threadIdx.x == 5) return;
  __syncthreads();
  p.out[threadIdx.x] = 1.0f;
}

MGSR_KERNEL(half_a_warp, MisuseParams, 64) {
  if (threadIdx.x < 16) p.out[threadIdx.x] = __shfl_down_sync(mgsr::kFullWarp, 1.0f, 1);
}
