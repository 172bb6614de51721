// Kernels that do wrong, each beside one that does the same rightly.
#include "kernels/common/cuda.h"

struct FaultParams {
  float* out;
  const float* in;
  float* other;
  int offset;
};

using mgsr::kFullWarp;

template <bool kOrdered>
__device__ void reverse_in_shared_memory(const FaultParams& p) {
  __shared__ float values[64];
  values[threadIdx.x] = p.in[threadIdx.x];
  if (kOrdered) __syncthreads();
  p.out[threadIdx.x] = values[63 - threadIdx.x];
}
MGSR_KERNEL(shared_ordered, FaultParams, 64) { reverse_in_shared_memory<true>(p); }
MGSR_KERNEL(shared_race, FaultParams, 64) { reverse_in_shared_memory<false>(p); }

// Each round overwrites what others may still be reading.
template <bool kOrdered>
__device__ void rotate_in_rounds(const FaultParams& p) {
  __shared__ float values[64];
  float x = p.in[threadIdx.x];
  for (int round = 0; round < 3; ++round) {
    values[threadIdx.x] = x;
    __syncthreads();
    x = values[(threadIdx.x + 1) % 64];
    if (kOrdered) __syncthreads();
  }
  p.out[threadIdx.x] = x;
}
MGSR_KERNEL(overwritten_ordered, FaultParams, 64) { rotate_in_rounds<true>(p); }
MGSR_KERNEL(overwritten_race, FaultParams, 64) { rotate_in_rounds<false>(p); }

template <bool kOrdered>
__device__ void reverse_in_global_memory(const FaultParams& p) {
  p.other[threadIdx.x] = p.in[threadIdx.x];
  if (kOrdered) __syncthreads();
  p.out[threadIdx.x] = p.other[63 - threadIdx.x];
}
MGSR_KERNEL(global_ordered, FaultParams, 64) { reverse_in_global_memory<true>(p); }
MGSR_KERNEL(global_race, FaultParams, 64) { reverse_in_global_memory<false>(p); }

MGSR_KERNEL(blocks_apart, FaultParams, 32) { p.out[blockIdx.x * 32 + threadIdx.x] = 1.0f; }
MGSR_KERNEL(blocks_race, FaultParams, 32) { p.out[threadIdx.x] = 1.0f; }
MGSR_KERNEL(blocks_race_after_barrier, FaultParams, 32) {
  const float x = p.other[threadIdx.x];
  __syncthreads();
  if (blockIdx.x == 1) p.other[31 - threadIdx.x] = 2.0f;
  p.out[blockIdx.x * 32 + threadIdx.x] = x;
}

// A vote makes lanes meet, and orders no memory.
template <bool kOrdered>
__device__ void reverse_in_warp(const FaultParams& p) {
  __shared__ float values[64];
  values[threadIdx.x] = p.in[threadIdx.x];
  const bool any = __any_sync(kFullWarp, p.in[threadIdx.x] > 1e30f);
  if (kOrdered) __syncwarp();
  p.out[threadIdx.x] = any ? 0.0f : values[threadIdx.x ^ 31];
}
MGSR_KERNEL(warp_ordered, FaultParams, 64) { reverse_in_warp<true>(p); }
MGSR_KERNEL(warp_race, FaultParams, 64) { reverse_in_warp<false>(p); }

// Half of the warp syncs, and the other half reads what it wrote.
template <bool kOrdered>
__device__ void reverse_in_half_warp(const FaultParams& p) {
  __shared__ float values[32];
  values[threadIdx.x] = p.in[threadIdx.x];
  if (kOrdered) __syncwarp();
  if (threadIdx.x < 16) __syncwarp(0xffffu);
  p.out[threadIdx.x] = values[31 - threadIdx.x];
}
MGSR_KERNEL(half_ordered, FaultParams, 32) { reverse_in_half_warp<true>(p); }
MGSR_KERNEL(half_race, FaultParams, 32) { reverse_in_half_warp<false>(p); }

MGSR_KERNEL(reads_of_another_half, FaultParams, 32) {
  __shared__ float values[16];
  if (threadIdx.x < 16) {
    values[threadIdx.x] = p.in[threadIdx.x];
    __syncwarp(0xffffu);
  } else {
    p.out[threadIdx.x] = values[31 - threadIdx.x];
  }
}

// At offset 0, all of these stay inside.
MGSR_KERNEL(global_read, FaultParams, 64) { p.out[threadIdx.x] = p.in[int(threadIdx.x) + p.offset]; }
MGSR_KERNEL(global_write, FaultParams, 64) { p.out[int(threadIdx.x) + p.offset] = p.in[threadIdx.x]; }
MGSR_KERNEL(shared_read, FaultParams, 64) {
  __shared__ float values[64];
  values[threadIdx.x] = p.in[threadIdx.x];
  __syncthreads();
  p.out[threadIdx.x] = values[63 - int(threadIdx.x) + p.offset];
}
MGSR_KERNEL(shared_write, FaultParams, 64) {
  __shared__ float values[64];
  values[63 - int(threadIdx.x) + p.offset] = p.in[threadIdx.x];
  __syncthreads();
  p.out[threadIdx.x] = values[threadIdx.x];
}
MGSR_KERNEL(local_write, FaultParams, 64) {
  float own[8] = {};
  for (int i = 0; i < 8; ++i) own[(i * 3 + int(threadIdx.x)) % 8 + p.offset] = p.in[threadIdx.x] * i;
  p.out[threadIdx.x] = own[threadIdx.x % 8];
}
MGSR_KERNEL(global_vector, FaultParams, 8) {
  const float4 four = *reinterpret_cast<const float4*>(p.in + 4 * threadIdx.x + p.offset);
  p.out[threadIdx.x] = four.x + four.y + four.z + four.w;
}
MGSR_KERNEL(shared_vector, FaultParams, 8) {
  __shared__ alignas(16) float values[64];
  for (int i = threadIdx.x; i < 64; i += 8) values[i] = p.in[i];
  __syncthreads();
  const float2 two = *reinterpret_cast<const float2*>(values + 2 * threadIdx.x + p.offset);
  p.out[threadIdx.x] = two.x + two.y;
}

MGSR_KERNEL(exited_lanes, FaultParams, 32) {
  if (threadIdx.x == 7) return;
  p.out[threadIdx.x] = __shfl_xor_sync(kFullWarp, p.in[threadIdx.x], 1);
}
MGSR_KERNEL(diverged_lanes, FaultParams, 32) {
  float x = p.in[threadIdx.x];
  if (threadIdx.x < 16) x = __shfl_xor_sync(kFullWarp, x, 1);
  else __syncwarp();
  p.out[threadIdx.x] = x;
}
MGSR_KERNEL(lanes_at_a_barrier, FaultParams, 32) {
  if (threadIdx.x < 16) __syncwarp();
  else __syncthreads();
  p.out[threadIdx.x] = 1.0f;
}
MGSR_KERNEL(not_in_own_mask, FaultParams, 32) {
  p.out[threadIdx.x] = __shfl_xor_sync(0xffffu, p.in[threadIdx.x], 1);
}
MGSR_KERNEL(different_masks, FaultParams, 32) {
  __syncwarp(threadIdx.x < 16 ? kFullWarp : 0xfffffff0u);
  p.out[threadIdx.x] = 1.0f;
}
MGSR_KERNEL(reads_from_outside_the_mask, FaultParams, 32) {
  if (threadIdx.x < 16) p.out[threadIdx.x] = __shfl_xor_sync(0xffffu, p.in[threadIdx.x], 16);
}
MGSR_KERNEL(lanes_that_are_not_there, FaultParams, 64) {
  p.out[threadIdx.x] = __shfl_xor_sync(kFullWarp, p.in[threadIdx.x], 1);
}

MGSR_KERNEL(left_before_a_barrier, FaultParams, 64) {
  if (threadIdx.x == 5) return;
  __syncthreads();
  p.out[threadIdx.x] = 1.0f;
}
MGSR_KERNEL(different_barriers, FaultParams, 64) {
  int count = 0;
  if (threadIdx.x < 32) __syncthreads();
  else count = __syncthreads_count(p.in[threadIdx.x] > 0);
  p.out[threadIdx.x] = float(count);
}

MGSR_KERNEL(unwritten, FaultParams, 64) {
  __shared__ float values[64];
  if (threadIdx.x < 40) values[threadIdx.x] = p.in[threadIdx.x];
  __syncthreads();
  p.out[threadIdx.x] = values[63 - threadIdx.x];
}

MGSR_KERNEL(traps, FaultParams, 64) {
  if (p.in[threadIdx.x] > -1e30f) __trap();
}
