// Fused L1 + SSIM with its gradient. The region is cut into tiles; a tile runs down its rows once, and each input row
// goes through five steps that follow each other at a distance of five rows:
//   input row -> moments filtered along the row -> filtered down the column, SSIM and its derivatives (the map row)
//   -> derivatives filtered along the row -> filtered down the column: the gradient row.
// The rows in between live in two rings of 16, small enough for the second-level cache. Pixels stay interleaved: a tap
// to the right is 3 floats further. Tiles depend on the region alone and their sums are added in order, so that the
// result is the same bytes for any thread count.
#pragma once

#include <algorithm>
#include <vector>

#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"
#include "kernels/image/image.h"
#include "kernels/image/rows.h"
#include "math/ssim.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kRadius = kSsimRadius, kRingRows = 16;
constexpr int kTileRows = 64, kTileColumns = 256;
constexpr int kMoments = 4;  // a, b, a^2 + b^2, a b

template <int Stride>
inline vfloat filter(const float* p) {
  vfloat sum = kSsimTaps[kRadius] * load(p + kRadius * Stride);
#pragma GCC unroll 5
  for (int j = 0; j < kRadius; ++j) sum += kSsimTaps[j] * (load(p + j * Stride) + load(p + (2 * kRadius - j) * Stride));
  return sum;
}

inline vfloat filter_down(const float* const* rows, int i) {
  vfloat sum = kSsimTaps[kRadius] * load(rows[kRadius] + i);
#pragma GCC unroll 5
  for (int j = 0; j < kRadius; ++j) sum += kSsimTaps[j] * (load(rows[j] + i) + load(rows[2 * kRadius - j] + i));
  return sum;
}

inline void filter_along(const float* in, float* out, int floats) {
  for (int i = 0; i < floats; i += kWidth) store(out + i, filter<3>(in + i));
}

// 16 rows of `channels` buffers; row y replaces row y - 16.
struct Ring {
  float* base;
  int channels, stride;
  float* row(int y, int channel) const { return base + ((y & (kRingRows - 1)) * channels + channel) * stride; }
  void window(int y, int channel, const float** rows) const {
    for (int j = 0; j <= 2 * kRadius; ++j) rows[j] = row(y + j - kRadius, channel);
  }
  void clear(int y) const { std::fill_n(row(y, 0), channels * stride, 0.0f); }
};

// Derivs: derivative maps carried to the gradient: 0 none, 3 for the image, 4 for the target too.
template <int Derivs>
class LossTile {
 public:
  // tile: where the gradient is written. counted: where SSIM is summed; it reaches up to 5 pixels past the region's edge.
  LossTile(const ImageLossParams& p, const Region& tile, const Region& counted, const Region& maps)
      : p_(p), tile_(tile), counted_(counted), maps_(maps) {
    columns_ = tile.x1 - tile.x0;
    stride_ = (3 * (columns_ + 4 * kRadius) + 2 * kWidth + 15) / 16 * 16;
    static thread_local std::vector<float> scratch;
    const size_t needed = size_t(stride_) * (kRingRows * (kMoments + Derivs) + kMoments + Derivs + 3);
    if (scratch.size() < needed) scratch.resize(needed);
    float* next = scratch.data();
    const auto take = [&](int rows) { float* rows_at = next; next += size_t(rows) * stride_; return rows_at; };
    moments_ = {take(kRingRows * kMoments), kMoments, stride_};
    derivs_ = {take(kRingRows * Derivs), Derivs, stride_};
    input_ = take(kMoments), map_ = take(Derivs), weight_ = take(1), values_ = take(2);
    std::fill_n(input_, size_t(stride_) * (kMoments + Derivs + 3), 0.0f);
  }

  // Sum of the weighted losses of the tile.
  double run() {
    for (int y = tile_.y0 - 2 * kRadius; y < tile_.y1 + 2 * kRadius; ++y) {
      add_moments(y);
      const int map_row = y - kRadius, gradient_row = y - 2 * kRadius;
      if (map_row >= tile_.y0 - kRadius) add_map(map_row);
      if (gradient_row >= tile_.y0) add_gradient(gradient_row);
    }
    return double(1.0f - p_.l1_weight) * ssim_sum_ + double(p_.l1_weight) * l1_sum_;
  }

 private:
  bool in_image(int y) const { return y >= 0 && y < p_.height; }

  // `columns` pixels of row y from column x on, zero outside the image.
  void copy_pixels(const float* image, int y, int x, int columns, int channels, float* out) const {
    const int begin = std::max(x, 0), end = std::min(x + columns, p_.width);
    std::fill_n(out, size_t(columns) * channels, 0.0f);
    if (begin < end)
      std::memcpy(out + (begin - x) * channels, image + (int64_t(y) * p_.width + begin) * channels,
                  size_t(end - begin) * channels * sizeof(float));
  }

  void add_moments(int y) {
    if (!in_image(y)) return moments_.clear(y);
    const int pixels = columns_ + 4 * kRadius;
    float *a = input_, *b = a + stride_, *squares = b + stride_, *product = squares + stride_;
    copy_pixels(p_.image, y, tile_.x0 - 2 * kRadius, pixels, 3, a);
    copy_pixels(p_.target, y, tile_.x0 - 2 * kRadius, pixels, 3, b);
    for (int i = 0; i < 3 * pixels; i += kWidth) {
      const vfloat va = load(a + i), vb = load(b + i);
      store(squares + i, va * va + vb * vb);
      store(product + i, va * vb);
    }
    for (int m = 0; m < kMoments; ++m)
      filter_along(input_ + m * stride_, moments_.row(y, m), 3 * (columns_ + 2 * kRadius));
  }

  // weight_: the mask at `pixels` pixels of row y from column x on, once a channel; zero outside of `inside`.
  void load_weights(int y, int x, int pixels, const Region& inside) {
    for (int i = 0; i < pixels; ++i) {
      const bool in = x + i >= inside.x0 && x + i < inside.x1;
      const float w = !in ? 0.0f : p_.mask ? p_.mask[int64_t(y) * p_.width + x + i] : 1.0f;
      weight_[3 * i] = weight_[3 * i + 1] = weight_[3 * i + 2] = w;
    }
  }

  void add_map(int y) {
    if (y < maps_.y0 || y >= maps_.y1) {
      if constexpr (Derivs > 0) derivs_.clear(y);
      return;
    }
    const int left = tile_.x0 - kRadius, pixels = columns_ + 2 * kRadius;
    load_weights(y, left, pixels, maps_);
    const float* rows[kMoments][2 * kRadius + 1];
    for (int m = 0; m < kMoments; ++m) moments_.window(y, m, rows[m]);
    for (int i = 0; i < 3 * pixels; i += kWidth) {
      const SsimMoments<vfloat> m = {filter_down(rows[0], i), filter_down(rows[1], i), filter_down(rows[2], i),
                                     filter_down(rows[3], i)};
      const vfloat weight = load(weight_ + i);
      SsimMoments<vfloat> v;
      const vfloat value = Derivs > 0 ? ssim_vjp(m, -weight, v) : ssim(m);
      store(values_ + i, weight * (1.0f - value));
      if constexpr (Derivs > 0) store(map_ + i, v.a), store(map_ + stride_ + i, v.squares), store(map_ + 2 * stride_ + i, v.product);
      if constexpr (Derivs > 3) store(map_ + 3 * stride_ + i, v.b);
    }
    if (y >= counted_.y0 && y < counted_.y1)
      ssim_sum_ += sum_floats(values_ + 3 * (counted_.x0 - left), 3 * (counted_.x1 - counted_.x0));
    for (int d = 0; d < Derivs; ++d) filter_along(map_ + d * stride_, derivs_.row(y, d), 3 * columns_);
  }

  void add_gradient(int y) {
    load_weights(y, tile_.x0, columns_, tile_);
    float *a = input_, *b = a + stride_;
    copy_pixels(p_.image, y, tile_.x0, columns_, 3, a);
    copy_pixels(p_.target, y, tile_.x0, columns_, 3, b);
    float *v_a = input_ + 2 * stride_, *v_b = input_ + 3 * stride_;
    const float* rows[Derivs + 1][2 * kRadius + 1];
    for (int d = 0; d < Derivs; ++d) derivs_.window(y, d, rows[d]);
    const float l1 = p_.l1_weight, by_ssim = 1.0f - l1;
    for (int i = 0; i < 3 * columns_; i += kWidth) {
      const vfloat va = load(a + i), vb = load(b + i), weight = load(weight_ + i), difference = va - vb;
      store(values_ + i, weight * max(difference, -difference));
      if constexpr (Derivs > 0) {
        const vfloat squares = 2.0f * filter_down(rows[1], i), product = filter_down(rows[2], i);
        const vfloat sign = keep(difference > 0.0f, weight * l1) - keep(difference < 0.0f, weight * l1);
        store(v_a + i, sign + by_ssim * (filter_down(rows[0], i) + va * squares + vb * product));
        if constexpr (Derivs > 3) store(v_b + i, by_ssim * (filter_down(rows[3], i) + vb * squares + va * product) - sign);
      }
    }
    l1_sum_ += sum_floats(values_, 3 * columns_);
    const int64_t at = (int64_t(y) * p_.width + tile_.x0) * 3;
    if constexpr (Derivs > 0) std::memcpy(p_.v_image + at, v_a, size_t(3 * columns_) * sizeof(float));
    if constexpr (Derivs > 3) std::memcpy(p_.v_target + at, v_b, size_t(3 * columns_) * sizeof(float));
  }

  const ImageLossParams& p_;
  Region tile_, counted_, maps_;
  int columns_, stride_;
  Ring moments_, derivs_;
  float *input_, *map_, *weight_, *values_;
  double ssim_sum_ = 0, l1_sum_ = 0;
};

double weight_sum(const ImageLossParams& p) {
  const int64_t n = int64_t(p.height) * p.width;
  if (!p.mask) return 3.0 * double(n);
  double lanes[8] = {};
  for (int64_t i = 0; i < n; ++i) lanes[i & 7] += double(p.mask[i]);
  return 3.0 * (((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7])));
}

double tile_loss(const ImageLossParams& p, const Region& tile, const Region& counted, const Region& maps) {
  if (p.v_target) return LossTile<4>(p, tile, counted, maps).run();
  if (p.v_image) return LossTile<3>(p, tile, counted, maps).run();
  return LossTile<0>(p, tile, counted, maps).run();
}

ImageLossSums image_loss(const ImageLossParams& p) {
  const Region& r = p.region;
  ImageLossSums sums;
  sums.weight = weight_sum(p);
  if (r.y0 >= r.y1 || r.x0 >= r.x1) return sums;
  // Windows reach past the region, so the SSIM map differs from 1 there too.
  const Region maps = {std::max(r.y0 - kRadius, 0), std::min(r.y1 + kRadius, p.height), std::max(r.x0 - kRadius, 0),
                       std::min(r.x1 + kRadius, p.width)};
  const int bands = (r.y1 - r.y0 + kTileRows - 1) / kTileRows, strips = (r.x1 - r.x0 + kTileColumns - 1) / kTileColumns;
  std::vector<double> totals(size_t(bands) * strips);
  ThreadPool::instance().run(bands * strips, [&](int t) {
    const int band = t / strips, strip = t % strips;
    const Region tile = {cut(r.y0, r.y1, band, bands), cut(r.y0, r.y1, band + 1, bands),
                         cut(r.x0, r.x1, strip, strips), cut(r.x0, r.x1, strip + 1, strips)};
    const Region counted = {band == 0 ? maps.y0 : tile.y0, band == bands - 1 ? maps.y1 : tile.y1,
                            strip == 0 ? maps.x0 : tile.x0, strip == strips - 1 ? maps.x1 : tile.x1};
    totals[size_t(t)] = tile_loss(p, tile, counted, maps);
  });
  for (double total : totals) sums.total += total;
  return sums;
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
