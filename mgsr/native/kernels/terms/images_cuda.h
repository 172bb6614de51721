// The parts of losses outside the image family: the target of a view, the covered pixels, and terms of single numbers.
// A thread is a pixel or a number. Each term writes its derivatives, not yet scaled, and the sums of its blocks.
#pragma once

#include "kernels/common/sums_cuda.h"
#include "math/silhouette.h"

namespace mgsr {

constexpr int kTermThreads = 256;

__device__ inline int64_t term_index() { return int64_t(blockIdx.x) * kTermThreads + threadIdx.x; }

// Composites a photograph in bytes on a colour.
struct TargetParams {
  int64_t pixels;
  const unsigned char* image;     // [pixels, 3], straight colours
  const unsigned char* mask;      // [pixels], or null for 255 everywhere
  const unsigned char* off_edge;  // [pixels] 0 or 1, or null
  const float* background;        // [3], required with a mask
  float* color;                   // [pixels, 3]
  float* alpha;                   // [pixels] 0..1, or null
  float* weights;                 // [pixels], off_edge as floats; required with it
};

__device__ inline void composite(const TargetParams& p) {
  const int64_t i = term_index();
  if (i >= p.pixels) return;
  const float alpha = p.mask ? float(p.mask[i]) / 255.0f : 1.0f;
  for (int c = 0; c < 3; ++c) {
    const unsigned char own = p.image[3 * i + c];
    p.color[3 * i + c] = p.mask ? composited(own, p.background[c], alpha) : float(own) / 255.0f;
  }
  if (p.alpha) p.alpha[i] = alpha;
  if (p.weights) p.weights[i] = p.off_edge[i] ? 1.0f : 0.0f;
}

// Writes 1 where both alphas are over a half, else 0.
struct CoveredParams {
  int64_t pixels;
  const float* alpha;
  const float* mask;  // or null for 1 everywhere
  float* covered;
};

__device__ inline void find_covered(const CoveredParams& p) {
  const int64_t i = term_index();
  if (i >= p.pixels) return;
  p.covered[i] = p.alpha[i] > 0.5f && (!p.mask || p.mask[i] > 0.5f) ? 1.0f : 0.0f;
}

// The difference of two silhouettes: absolute, or the cross entropy with alpha clamped to kLeastAlpha from 0 and 1.
struct SilhouetteParams {
  int64_t pixels;
  const float* alpha;
  const float* mask;
  const float* weights;  // multiplies both silhouettes; or null for 1 everywhere
  int entropy;           // 0 or 1
  float* v_alpha;        // [pixels], or null
  PartialSums* sums;     // [blocks]
};

__device__ inline void compare_silhouettes(const SilhouetteParams& p) {
  const int64_t i = term_index();
  double total = 0.0;
  if (i < p.pixels) {
    const float weight = p.weights ? p.weights[i] : 1.0f, alpha = p.alpha[i] * weight, mask = p.mask[i] * weight;
    float slope;
    total = p.entropy ? silhouette_entropy(alpha, mask, slope) : silhouette_gap(alpha, mask, slope);
    if (p.v_alpha) p.v_alpha[i] = slope * weight;
  }
  write_block_sums(total, 0.0, &p.sums[blockIdx.x]);
}

// The squares of (a - b) * first * second - offset.
struct SquaresParams {
  int64_t count;
  const float* a;
  const float *b, *first, *second;  // each may be null, which means 0, 1 and 1 everywhere
  float offset;
  float* differences;  // [count]
  PartialSums* sums;   // [blocks]
};

__device__ inline void sum_squares(const SquaresParams& p) {
  const int64_t i = term_index();
  double total = 0.0;
  if (i < p.count) {
    const float weight = (p.first ? p.first[i] : 1.0f) * (p.second ? p.second[i] : 1.0f);
    const float difference = (p.a[i] - (p.b ? p.b[i] : 0.0f)) * weight - p.offset;
    total = double(difference) * double(difference);
    p.differences[i] = difference;
  }
  write_block_sums(total, 0.0, &p.sums[blockIdx.x]);
}

// The sum of weight times colour.
struct ProductParams {
  int64_t pixels;
  const float* weight;
  const float* color;  // [pixels, 3]
  float* v_weight;     // [pixels], the sum over the colour's channels; the derivative to the colour is the weight
  PartialSums* sums;   // [blocks]
};

__device__ inline void sum_products(const ProductParams& p) {
  const int64_t i = term_index();
  double total = 0.0;
  if (i < p.pixels) {
    const float sum = p.color[3 * i] + p.color[3 * i + 1] + p.color[3 * i + 2];
    total = double(p.weight[i]) * double(sum);
    p.v_weight[i] = sum;
  }
  write_block_sums(total, 0.0, &p.sums[blockIdx.x]);
}

// The squared steps between neighbouring texels of square maps.
struct StepsParams {
  int maps, side, channels;
  const float* values;  // [maps, side, side, channels]
  float* v_values;      // the same, or null
  PartialSums* sums;    // [blocks]
};

__device__ inline void sum_steps(const StepsParams& p) {
  const int64_t i = term_index();
  const int row = p.side * p.channels;
  double total = 0.0;
  if (i < int64_t(p.maps) * p.side * row) {
    const int column = int(i / p.channels % p.side), line = int(i / row % p.side);
    const float here = p.values[i];
    const float right = column + 1 < p.side ? p.values[i + p.channels] - here : 0.0f;
    const float down = line + 1 < p.side ? p.values[i + row] - here : 0.0f;
    const float left = column > 0 ? here - p.values[i - p.channels] : 0.0f;
    const float up = line > 0 ? here - p.values[i - row] : 0.0f;
    total = double(right) * double(right) + double(down) * double(down);
    if (p.v_values) p.v_values[i] = 2.0f * ((left - right) + (up - down));
  }
  write_block_sums(total, 0.0, &p.sums[blockIdx.x]);
}

}  // namespace mgsr
