// Fused L1 + SSIM with its gradient, in two passes. In both, a block takes 32x16 pixels, one per thread.
// image_loss processes one channel after the other. It filters the moments of the windows along the rows and then down
// the columns, in shared memory. They give SSIM and its derivatives, which it writes to maps in global memory.
// image_loss_gradient applies the same filter to those maps, which are zero outside, and so finds the gradient.
#pragma once

#include "kernels/common/sums_cuda.h"
#include "math/ssim.h"

namespace mgsr {

constexpr int kLossWidth = 32, kLossHeight = 16, kLossThreads = kLossWidth * kLossHeight;
constexpr int kHaloWidth = kLossWidth + 2 * kSsimRadius, kHaloHeight = kLossHeight + 2 * kSsimRadius;
constexpr int kMoments = 4;  // a, b, a^2 + b^2, a b

struct ImageLossParams {
  int height, width;
  const float *image, *target;  // [height, width, 3]
  const float* mask;            // [height, width] weights, or null for 1 everywhere
  float l1_weight;
  int clip;                     // 1 if image values above 1 count as 1, without gradient
  float* derivatives;           // [3 or 4, 3, height, width] to a, a^2 + b^2, a b and b; or null
  int derivative_count;         // 0 without derivatives, 3 for the image's gradient, 4 for the target's too
  PartialSums* sums;            // [blocks]
  float *v_image, *v_target;    // [height, width, 3], or null
};

// The pixel of a thread in the image. Blocks cover the image row by row.
struct LossPixel {
  int x0, y0, x, y;  // the block's corner, and the pixel
  bool inside;       // whether the image has the pixel

  __device__ explicit LossPixel(const ImageLossParams& p) {
    const int across = (p.width + kLossWidth - 1) / kLossWidth;
    x0 = int(blockIdx.x) % across * kLossWidth, y0 = int(blockIdx.x) / across * kLossHeight;
    x = x0 + int(threadIdx.x) % kLossWidth, y = y0 + int(threadIdx.x) / kLossWidth;
    inside = x < p.width && y < p.height;
  }
};

__device__ inline float ssim_tap(int j) { return kSsimTaps[j <= kSsimRadius ? j : 2 * kSsimRadius - j]; }

// The rows of the halo after the filter along the rows.
template <int Planes>
struct FilteredRows {
  float values[Planes][kHaloHeight][kLossWidth];

  __device__ float down(int plane) const {
    const int x = threadIdx.x % kLossWidth, y = threadIdx.x / kLossWidth;
    float sum = 0.0f;
    for (int j = 0; j <= 2 * kSsimRadius; ++j) sum = fmaf(ssim_tap(j), values[plane][y + j][x], sum);
    return sum;
  }
};

// Filters a channel's moments along the rows. halo: [2, kHaloHeight, kHaloWidth] of the image and the target.
__device__ inline void filter_moments(const float (*halo)[kHaloHeight][kHaloWidth], FilteredRows<kMoments>& rows) {
  for (int i = threadIdx.x; i < kHaloHeight * kLossWidth; i += kLossThreads) {
    const int x = i % kLossWidth, y = i / kLossWidth;
    float sums[kMoments] = {};
    for (int j = 0; j <= 2 * kSsimRadius; ++j) {
      const float a = halo[0][y][x + j], b = halo[1][y][x + j], tap = ssim_tap(j);
      sums[0] = fmaf(tap, a, sums[0]), sums[1] = fmaf(tap, b, sums[1]);
      sums[2] = fmaf(tap, fmaf(a, a, b * b), sums[2]), sums[3] = fmaf(tap, a * b, sums[3]);
    }
    for (int m = 0; m < kMoments; ++m) rows.values[m][y][x] = sums[m];
  }
}

// Returns a number of the image in the form in which it is compared, which may be clipped.
__device__ inline float compared(const ImageLossParams& p, int64_t at) {
  const float value = p.image[at];
  return p.clip && value > 1.0f ? 1.0f : value;
}

__device__ inline void load_halo(const ImageLossParams& p, const LossPixel& pixel, int channel, float (*halo)[kHaloHeight][kHaloWidth]) {
  for (int i = threadIdx.x; i < kHaloHeight * kHaloWidth; i += kLossThreads) {
    const int x = pixel.x0 + i % kHaloWidth - kSsimRadius, y = pixel.y0 + i / kHaloWidth - kSsimRadius;
    const bool inside = x >= 0 && y >= 0 && x < p.width && y < p.height;
    const int64_t at = (int64_t(y) * p.width + x) * 3 + channel;
    halo[0][i / kHaloWidth][i % kHaloWidth] = inside ? compared(p, at) : 0.0f;
    halo[1][i / kHaloWidth][i % kHaloWidth] = inside ? p.target[at] : 0.0f;
  }
}

// Returns the address of a pixel in the map of one derivative and channel.
__device__ inline float* map_at(const ImageLossParams& p, int derivative, int channel, int x, int y) {
  return p.derivatives + ((int64_t(derivative) * 3 + channel) * p.height + y) * p.width + x;
}

// Returns one channel's loss at the thread's pixel, and writes its derivatives to the maps.
__device__ inline double channel_loss(const ImageLossParams& p, const LossPixel& pixel, int channel, const FilteredRows<kMoments>& rows,
                                      float weight) {
  const SsimMoments<float> m = {rows.down(0), rows.down(1), rows.down(2), rows.down(3)};
  if (!pixel.inside) return 0.0;
  SsimMoments<float> v;
  const float value = ssim_vjp(m, -weight, v), parts[4] = {v.a, v.squares, v.product, v.b};
  for (int d = 0; d < p.derivative_count; ++d) *map_at(p, d, channel, pixel.x, pixel.y) = parts[d];
  const int64_t at = (int64_t(pixel.y) * p.width + pixel.x) * 3 + channel;
  const float l1 = p.l1_weight * fabsf(compared(p, at) - p.target[at]);
  return double(weight) * (double(1.0f - p.l1_weight) * double(1.0f - value) + double(l1));
}

__device__ inline void image_loss(const ImageLossParams& p) {
  __shared__ float halo[2][kHaloHeight][kHaloWidth];
  __shared__ FilteredRows<kMoments> rows;
  const LossPixel pixel(p);
  const float weight = !pixel.inside ? 0.0f : p.mask ? p.mask[int64_t(pixel.y) * p.width + pixel.x] : 1.0f;
  double total = 0.0;
  for (int channel = 0; channel < 3; ++channel) {
    load_halo(p, pixel, channel, halo);
    __syncthreads();
    filter_moments(halo, rows);
    __syncthreads();
    total += channel_loss(p, pixel, channel, rows, weight);
    __syncthreads();
  }
  write_block_sums(total, 0.0, &p.sums[blockIdx.x]);
}

// Filters one map around the block along the rows.
__device__ inline void filter_map(const ImageLossParams& p, const LossPixel& pixel, int derivative, int channel,
                                  float (*halo)[kHaloWidth], FilteredRows<1>& rows) {
  for (int i = threadIdx.x; i < kHaloHeight * kHaloWidth; i += kLossThreads) {
    const int x = pixel.x0 + i % kHaloWidth - kSsimRadius, y = pixel.y0 + i / kHaloWidth - kSsimRadius;
    const bool inside = x >= 0 && y >= 0 && x < p.width && y < p.height;
    halo[i / kHaloWidth][i % kHaloWidth] = inside ? *map_at(p, derivative, channel, x, y) : 0.0f;
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kHaloHeight * kLossWidth; i += kLossThreads) {
    float sum = 0.0f;
    for (int j = 0; j <= 2 * kSsimRadius; ++j) sum = fmaf(ssim_tap(j), halo[i / kLossWidth][i % kLossWidth + j], sum);
    rows.values[0][i / kLossWidth][i % kLossWidth] = sum;
  }
  __syncthreads();
}

__device__ inline void write_gradient(const ImageLossParams& p, const LossPixel& pixel, int channel, const float derivatives[4]) {
  const int64_t at = (int64_t(pixel.y) * p.width + pixel.x) * 3 + channel;
  const float a = compared(p, at), b = p.target[at], difference = a - b, by_ssim = 1.0f - p.l1_weight;
  const float weight = p.mask ? p.mask[int64_t(pixel.y) * p.width + pixel.x] : 1.0f;
  const float sign = difference > 0.0f ? weight * p.l1_weight : difference < 0.0f ? -weight * p.l1_weight : 0.0f;
  const float squares = 2.0f * derivatives[1], product = derivatives[2];
  const bool clipped = p.clip && p.image[at] > 1.0f;
  p.v_image[at] = clipped ? 0.0f : sign + by_ssim * (derivatives[0] + a * squares + b * product);
  if (p.v_target) p.v_target[at] = by_ssim * (derivatives[3] + b * squares + a * product) - sign;
}

__device__ inline void image_loss_gradient(const ImageLossParams& p) {
  __shared__ float halo[kHaloHeight][kHaloWidth];
  __shared__ FilteredRows<1> rows;
  const LossPixel pixel(p);
  for (int channel = 0; channel < 3; ++channel) {
    float derivatives[4] = {};
    for (int d = 0; d < p.derivative_count; ++d) {
      filter_map(p, pixel, d, channel, halo, rows);
      derivatives[d] = rows.down(0);
      __syncthreads();
    }
    if (pixel.inside) write_gradient(p, pixel, channel, derivatives);
  }
}

}  // namespace mgsr
