// Converts the terms' sums to their values, and their derivatives to the images' gradients.
#pragma once

#include "kernels/common/sums_cuda.h"

namespace mgsr {

constexpr int kMostTerms = 24, kMostImages = 16, kMostParts = 4;
constexpr int kTotalThreads = 256, kGradientThreads = 256, kGradientFloats = 1024;

// value = weight * total / by and scale = weight / by; both are 0 if `by` is. by = factor, times the total that the
// blocks counted if that is used, times *divisor if there is one.
struct TermSums {
  const PartialSums* sums;
  int blocks, counted;
  double factor;
  const float* divisor;
  float weight;
};

// A block takes a term, and adds its sums in a fixed order.
struct TotalsParams {
  TermSums terms[kMostTerms];
  float *values, *scales;  // [terms]
};

__device__ inline void find_value(const TotalsParams& p) {
  const TermSums& term = p.terms[blockIdx.x];
  double total = 0.0, weight = 0.0;
  for (int i = threadIdx.x; i < term.blocks; i += kTotalThreads) total += term.sums[i].total, weight += term.sums[i].weight;
  __shared__ PartialSums all;
  write_block_sums(total, weight, &all);
  if (threadIdx.x != 0) return;
  const double by = term.factor * (term.counted ? all.weight : 1.0) * (term.divisor ? double(*term.divisor) : 1.0);
  const double scale = by != 0.0 ? double(term.weight) / by : 0.0;
  p.values[blockIdx.x] = float(all.total * scale), p.scales[blockIdx.x] = float(scale);
}

// The contribution of one term to an image's gradient: factor * slopes, times the term's scale and the gradient of the
// term.
struct GradientPart {
  const float* slopes;  // the shape of the image, or one number per pixel
  int term, channels;
  float factor;
};

struct ImageGradient {
  float* out;
  int64_t count;
  int channels, parts, end;  // end: the first block after those of the image
  GradientPart part[kMostParts];
};

// A block computes kGradientFloats neighbouring numbers of one image, and a thread every kGradientThreads-th of them.
struct GradientsParams {
  int images;
  const float *v_values, *scales;  // [terms]
  ImageGradient image[kMostImages];
};

__device__ inline float gradient_at(const GradientsParams& p, const ImageGradient& image, int64_t i) {
  const int64_t pixel = i / image.channels;
  float sum = 0.0f;
  for (int k = 0; k < image.parts; ++k) {
    const GradientPart& part = image.part[k];
    const float scale = part.factor * p.scales[part.term] * p.v_values[part.term];
    sum += scale * part.slopes[part.channels == image.channels ? i : pixel];
  }
  return sum;
}

__device__ inline void add_up_gradients(const GradientsParams& p) {
  const BlockInArrays at(p.images, [&](int i) { return p.image[i].end; });
  const ImageGradient& image = p.image[at.array];
  const int64_t begin = int64_t(at.block) * kGradientFloats;
  for (int i = threadIdx.x; i < kGradientFloats && begin + i < image.count; i += kGradientThreads)
    image.out[begin + i] = gradient_at(p, image, begin + i);
}

}  // namespace mgsr
