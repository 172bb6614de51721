// Edge-aware total variation with its gradient. A thread is a pixel, and sums the pairs to its right and below. Its
// gradient is the difference of the fluxes (the derivatives) of its four pairs, so that nothing is scattered.
#pragma once

#include "kernels/common/sums_cuda.h"
#include "math/tv.h"

namespace mgsr {

constexpr int kPixelThreads = 256;

struct TvParams {
  int height, width, channels;
  const float* values;  // [height, width, channels]
  const float* guide;   // [height, width, 3]
  const float* mask;    // [height, width] weights, or null
  float* v_values;      // [height, width, channels], of the sum; or null
  PartialSums* sums;    // [blocks]
};

// A pair of pixels, given the second one's place relative to the first: whether it exists, and its weight.
struct TvPair {
  bool exists;
  float mask, weight;
  int64_t other;

  __device__ TvPair(const TvParams& p, int x, int y, int dx, int dy) {
    const int x1 = x + dx, y1 = y + dy;
    const int64_t here = int64_t(y) * p.width + x;
    other = int64_t(y1) * p.width + x1;
    exists = x1 >= 0 && y1 >= 0 && x1 < p.width && y1 < p.height;
    if (!exists) return;
    float gap = 0.0f;
    for (int c = 0; c < 3; ++c) gap += fabsf(p.guide[3 * other + c] - p.guide[3 * here + c]);
    mask = p.mask ? p.mask[here] * p.mask[other] : 1.0f;
    weight = mask * tv_weight(gap * (1.0f / 3));
  }
};

__device__ inline void tv(const TvParams& p) {
  constexpr int kDx[4] = {1, 0, -1, 0}, kDy[4] = {0, 1, 0, -1};  // the first two are counted here
  const int64_t i = int64_t(blockIdx.x) * kPixelThreads + threadIdx.x;
  double total = 0.0, pairs = 0.0;
  if (i < int64_t(p.height) * p.width) {
    const int x = int(i % p.width), y = int(i / p.width);
    for (int c = 0; c < p.channels && p.v_values; ++c) p.v_values[i * p.channels + c] = 0.0f;
    for (int side = 0; side < 4; ++side) {
      const TvPair pair(p, x, y, kDx[side], kDy[side]);
      if (!pair.exists) continue;
      if (side < 2) pairs += pair.mask;
      for (int c = 0; c < p.channels; ++c) {
        const float difference = p.values[pair.other * p.channels + c] - p.values[i * p.channels + c];
        if (side < 2) total += tv_pair(difference, pair.weight);
        if (p.v_values) p.v_values[i * p.channels + c] -= tv_pair_vjp(difference, pair.weight);
      }
    }
  }
  write_block_sums(total, pairs, &p.sums[blockIdx.x]);
}

}  // namespace mgsr
