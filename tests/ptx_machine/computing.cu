// Kernels whose results NumPy knows: what no single instruction shows.
#include "kernels/common/cuda.h"

struct ComputingParams {
  float* out;
  const float* in;
  int* counts;
  double* doubles;
};

using mgsr::kFullWarp;

MGSR_KERNEL(vector_loads, ComputingParams, 64) {
  const float4 four = reinterpret_cast<const float4*>(p.in)[threadIdx.x];
  reinterpret_cast<float2*>(p.out)[threadIdx.x] = make_float2(four.x + four.z, four.y * four.w);
}

MGSR_KERNEL(vector_stores, ComputingParams, 64) {
  __shared__ float4 places[64];
  const float x = p.in[threadIdx.x];
  places[63 - threadIdx.x] = make_float4(x, 2 * x, 3 * x, 4 * x);
  __syncthreads();
  reinterpret_cast<float4*>(p.out)[threadIdx.x] = places[threadIdx.x];
}

MGSR_KERNEL(shuffles, ComputingParams, 64) {
  const float x = p.in[threadIdx.x];
  const int lane = threadIdx.x % 32;
  float* out = p.out + threadIdx.x;
  out[0] = __shfl_up_sync(kFullWarp, x, 3);
  out[64] = __shfl_down_sync(kFullWarp, x, 5);
  out[128] = __shfl_xor_sync(kFullWarp, x, 9);
  out[192] = __shfl_sync(kFullWarp, x, (lane * 7) % 32);
  out[256] = __shfl_up_sync(kFullWarp, x, 3, 8);
  out[320] = __shfl_down_sync(kFullWarp, x, 3, 8);
  out[384] = __shfl_xor_sync(kFullWarp, x, 5, 8);
  out[448] = __shfl_sync(kFullWarp, x, lane % 5, 8);
}

MGSR_KERNEL(half_warp, ComputingParams, 32) {
  const float x = p.in[threadIdx.x];
  p.out[threadIdx.x] = x;
  if (threadIdx.x >= 20) return;
  p.out[threadIdx.x] = __shfl_sync(0xfffffu, x, (threadIdx.x + 1) % 20);
}

MGSR_KERNEL(votes, ComputingParams, 64) {
  const bool positive = p.in[threadIdx.x] > 0;
  const int small = int(threadIdx.x) % 5;
  int* out = p.counts + threadIdx.x;
  out[0] = int(__ballot_sync(kFullWarp, positive));
  out[64] = __any_sync(kFullWarp, positive);
  out[128] = __all_sync(kFullWarp, positive);
  out[192] = int(__match_any_sync(kFullWarp, small));
  out[256] = __reduce_add_sync(kFullWarp, int(threadIdx.x) - 40);
  out[320] = __reduce_min_sync(kFullWarp, int(threadIdx.x) - 40);
  out[384] = int(__reduce_max_sync(kFullWarp, threadIdx.x ^ 21u));
  out[448] = int(__reduce_xor_sync(kFullWarp, threadIdx.x * 77u));
}

MGSR_KERNEL(matches, ComputingParams, 64) {
  const int warp = int(threadIdx.x) / 32;
  int all = 0;
  p.counts[threadIdx.x] = int(__match_all_sync(kFullWarp, warp == 0 ? 5 : int(threadIdx.x) / 40, &all));
  p.counts[64 + threadIdx.x] = all;
}

MGSR_KERNEL(counts_of_block, ComputingParams, 64) {
  const bool positive = p.in[threadIdx.x] > 0;
  int* out = p.counts + threadIdx.x;
  out[0] = __syncthreads_count(positive);
  out[64] = __syncthreads_or(positive);
  out[128] = __syncthreads_and(positive);
}

MGSR_KERNEL(sums_of_block, ComputingParams, 64) {
  __shared__ double sums[64];
  sums[threadIdx.x] = double(p.in[threadIdx.x]) * double(p.in[threadIdx.x]);
  for (int half = 32; half > 0; half /= 2) {
    __syncthreads();
    if (threadIdx.x < half) sums[threadIdx.x] += sums[threadIdx.x + half];
  }
  if (threadIdx.x == 0) p.doubles[blockIdx.x] = sums[0] * (blockIdx.x + 1);
}

__constant__ float primes[8] = {2, 3, 5, 7, 11, 13, 17, 19};
__device__ const short squares[8] = {0, 1, 4, 9, 16, 25, 36, -49};

MGSR_KERNEL(tables, ComputingParams, 64) {
  const int i = int(p.in[threadIdx.x] * 0) + int(threadIdx.x % 8);
  p.out[threadIdx.x] = primes[i] + float(squares[7 - i]);
}

MGSR_KERNEL(local_arrays, ComputingParams, 64) {
  float own[16];
  for (int i = 0; i < 16; ++i) own[(i * 5) % 16] = float(i) * p.in[threadIdx.x];
  p.out[threadIdx.x] = own[threadIdx.x % 16];
}

MGSR_KERNEL(branches, ComputingParams, 64) {
  float x = p.in[threadIdx.x];
  for (int i = 0; i < 3; ++i) {
    switch ((threadIdx.x + i) % 7) {
      case 0: x += 1; break;
      case 1: x *= 3; break;
      case 2: x = -x; break;
      case 3: x = x * x; break;
      case 4: x -= 5; break;
      case 5: x = x < 0 ? 2 : x; break;
      default: x *= 0.5f;
    }
  }
  p.out[threadIdx.x] = x;
}

// With arguments this large, the reduction by pi goes through tables and local memory.
MGSR_KERNEL(sines, ComputingParams, 64) { p.out[threadIdx.x] = sinf(p.in[threadIdx.x] * 1e6f); }
