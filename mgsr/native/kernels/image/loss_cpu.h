// Fused L1 + SSIM with its gradient. The image is cut into tiles. Each tile is processed once from top to bottom, and
// each input row goes through steps that follow each other at a distance of five rows:
//   input row -> moments filtered along the row -> filtered down the column, SSIM and its derivatives (the map row)
//   -> derivatives filtered along the row -> filtered down the column: the gradient row.
// Two rings of 16 rows hold the intermediate rows, and fit the second-level cache. Pixels stay interleaved, so the next
// pixel is 3 floats further. Tiles depend only on the image's size, and their sums are added in order, so any number
// of threads gives the same bytes.
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

constexpr int kRadius = kSsimRadius, kTaps = 2 * kSsimRadius + 1, kRingRows = 16;
constexpr int kTileRows = 64, kTileColumns = 256;
constexpr int kMoments = 4;  // a, b, a^2 + b^2, a b

constexpr float tap(int j) { return kSsimTaps[j <= kRadius ? j : 2 * kRadius - j]; }

// Filters two neighbouring rows at once, with 12 loads instead of 22.
inline void filter_down(const float* const* rows, int i, vfloat out[2]) {
  vfloat first = kSsimTaps[0] * load(rows[0] + i), second = kSsimTaps[0] * load(rows[kTaps] + i);
#pragma GCC unroll 10
  for (int j = 1; j < kTaps; ++j) {
    const vfloat row = load(rows[j] + i);
    first += tap(j) * row;
    second += tap(j - 1) * row;
  }
  out[0] = first, out[1] = second;
}

inline void filter_along(const float* in, float* out, int floats) {
  for (int i = 0; i < floats; i += kWidth) {
    vfloat sum = tap(kRadius) * load(in + i + 3 * kRadius);
#pragma GCC unroll 5
    for (int j = 0; j < kRadius; ++j) sum += tap(j) * (load(in + i + 3 * j) + load(in + i + 3 * (2 * kRadius - j)));
    store(out + i, sum);
  }
}

// 16 rows of `channels` buffers; row y replaces row y - 16. A window consists of the rows that filter_down reads for
// the rows y and y + 1.
struct Ring {
  float* base;
  int channels, stride;
  float* row(int y, int channel) const { return base + ((y & (kRingRows - 1)) * channels + channel) * stride; }
  void window(int y, int channel, const float** rows) const {
    for (int j = 0; j <= kTaps; ++j) rows[j] = row(y + j - kRadius, channel);
  }
  void clear(int y) const { std::fill_n(row(y, 0), channels * stride, 0.0f); }
};

// Rows y0..y1 and columns x0..x1 (ends excluded).
struct Tile {
  int y0, y1, x0, x1;
};

// Derivs: the number of derivative maps for the gradient: 0 for none, 3 for the image, 4 for the target too.
template <int Derivs>
class LossTile {
 public:
  LossTile(const ImageLossParams& p, const Tile& tile) : p_(p), tile_(tile), columns_(tile.x1 - tile.x0) {
    stride_ = (3 * (columns_ + 4 * kRadius) + 2 * kWidth + 15) / 16 * 16;
    constexpr int kRows = 2 * (kMoments + Derivs + 2);
    static thread_local std::vector<float> scratch;
    const size_t needed = size_t(stride_) * (kRingRows * (kMoments + Derivs) + kRows);
    if (scratch.size() < needed) scratch.resize(needed);
    float* next = scratch.data();
    const auto take = [&](int rows) { float* at = next; next += size_t(rows) * stride_; return at; };
    moments_ = {take(kRingRows * kMoments), kMoments, stride_};
    derivs_ = {take(kRingRows * Derivs), Derivs, stride_};
    std::fill_n(next, size_t(stride_) * kRows, 0.0f);
    for (RowBuffers& row : rows_) row = {take(kMoments), take(Derivs), take(1), take(1)};
  }

  // Returns the sum of the weighted losses of the tile. Rows are processed in pairs; an excess row at the end is
  // dropped.
  double run() {
    for (int y = tile_.y0 - 2 * kRadius; y < tile_.y1 + 2 * kRadius; y += 2) {
      add_moments(y, rows_[0]);
      add_moments(y + 1, rows_[1]);
      if (y - kRadius >= tile_.y0 - kRadius) add_maps(y - kRadius);
      if (y - 2 * kRadius >= tile_.y0) add_gradients(y - 2 * kRadius);
    }
    return double(1.0f - p_.l1_weight) * ssim_sum_ + double(p_.l1_weight) * l1_sum_;
  }

 private:
  // The buffers of one row: inputs and their products, derivatives, the mask repeated for each channel, the loss.
  struct RowBuffers {
    float *input, *derivs, *weights, *losses;
  };

  // Copies `columns` pixels of row y from column x on, with zeros outside the image.
  void copy_pixels(const float* image, int y, int x, int columns, float* out) const {
    const int begin = std::max(x, 0), end = std::min(x + columns, p_.width);
    if (x < begin || end < x + columns) std::fill_n(out, size_t(columns) * 3, 0.0f);
    if (begin < end)
      std::memcpy(out + (begin - x) * 3, image + (int64_t(y) * p_.width + begin) * 3, size_t(end - begin) * 3 * sizeof(float));
  }

  // Copies pixels of the image in the form in which they are compared, which may be clipped.
  void copy_image(int y, int x, int columns, float* out) const {
    copy_pixels(p_.image, y, x, columns, out);
    if (!p_.clip) return;
    for (int i = 0; i < 3 * columns; ++i) out[i] = out[i] > 1.0f ? 1.0f : out[i];
  }

  // Loads the weights of `pixels` pixels of row y from column x on, with zeros outside the image.
  void load_weights(int y, int x, int pixels, float* out) const {
    const bool row_inside = y >= 0 && y < p_.height;
    const int begin = std::max(x, 0), end = std::min(x + pixels, p_.width);
    if (!row_inside || x < begin || end < x + pixels) std::fill_n(out, size_t(pixels) * 3, 0.0f);
    if (!row_inside || begin >= end) return;
    if (!p_.mask) return void(std::fill_n(out + 3 * (begin - x), size_t(end - begin) * 3, 1.0f));
    const float* mask = p_.mask + int64_t(y) * p_.width + begin;
    float* at = out + 3 * (begin - x);
    for (int i = 0; i < end - begin; ++i) at[3 * i] = at[3 * i + 1] = at[3 * i + 2] = mask[i];
  }

  void add_moments(int y, const RowBuffers& row) {
    if (y < 0 || y >= p_.height) return moments_.clear(y);
    const int pixels = columns_ + 4 * kRadius;
    float *a = row.input, *b = a + stride_, *squares = b + stride_, *product = squares + stride_;
    copy_image(y, tile_.x0 - 2 * kRadius, pixels, a);
    copy_pixels(p_.target, y, tile_.x0 - 2 * kRadius, pixels, b);
    for (int i = 0; i < 3 * pixels; i += kWidth) {
      const vfloat va = load(a + i), vb = load(b + i);
      store(squares + i, va * va + vb * vb);
      store(product + i, va * vb);
    }
    for (int m = 0; m < kMoments; ++m)
      filter_along(row.input + m * stride_, moments_.row(y, m), 3 * (columns_ + 2 * kRadius));
  }

  void add_maps(int y) {
    const int left = tile_.x0 - kRadius, pixels = columns_ + 2 * kRadius;
    for (int r = 0; r < 2; ++r) load_weights(y + r, left, pixels, rows_[r].weights);
    const float* windows[kMoments][kTaps + 1];
    for (int m = 0; m < kMoments; ++m) moments_.window(y, m, windows[m]);
    for (int i = 0; i < 3 * pixels; i += kWidth) {
      vfloat a[2], b[2], squares[2], product[2];
      filter_down(windows[0], i, a);
      filter_down(windows[1], i, b);
      filter_down(windows[2], i, squares);
      filter_down(windows[3], i, product);
      for (int r = 0; r < 2; ++r) store_map({a[r], b[r], squares[r], product[r]}, i, rows_[r]);
    }
    for (int r = 0; r < 2; ++r) finish_map(y + r, rows_[r]);
  }

  void store_map(const SsimMoments<vfloat>& m, int i, const RowBuffers& row) const {
    const vfloat weight = load(row.weights + i);
    SsimMoments<vfloat> v;
    const vfloat value = Derivs > 0 ? ssim_vjp(m, -weight, v) : ssim(m);
    store(row.losses + i, weight * (1.0f - value));
    if constexpr (Derivs > 0) {
      store(row.derivs + i, v.a);
      store(row.derivs + stride_ + i, v.squares);
      store(row.derivs + 2 * stride_ + i, v.product);
    }
    if constexpr (Derivs > 3) store(row.derivs + 3 * stride_ + i, v.b);
  }

  void finish_map(int y, const RowBuffers& row) {
    if (y >= tile_.y0 && y < tile_.y1) ssim_sum_ += sum_floats(row.losses + 3 * kRadius, 3 * columns_);
    for (int d = 0; d < Derivs; ++d) filter_along(row.derivs + d * stride_, derivs_.row(y, d), 3 * columns_);
  }

  void add_gradients(int y) {
    const float* windows[Derivs + 1][kTaps + 1];
    for (int d = 0; d < Derivs; ++d) derivs_.window(y, d, windows[d]);
    for (int i = 0; i < 3 * columns_ && Derivs > 0; i += kWidth)
      for (int d = 0; d < Derivs; ++d) {
        vfloat sums[2];
        filter_down(windows[d], i, sums);
        for (int r = 0; r < 2; ++r) store(rows_[r].derivs + d * stride_ + i, sums[r]);
      }
    for (int r = 0; r < 2; ++r)
      if (y + r < tile_.y1) finish_gradient(y + r, rows_[r]);
  }

  void finish_gradient(int y, const RowBuffers& row) {
    load_weights(y, tile_.x0, columns_, row.weights);
    float *a = row.input, *b = a + stride_, *v_a = b + stride_, *v_b = v_a + stride_;
    copy_image(y, tile_.x0, columns_, a);
    copy_pixels(p_.target, y, tile_.x0, columns_, b);
    const float l1 = p_.l1_weight, by_ssim = 1.0f - l1;
    for (int i = 0; i < 3 * columns_; i += kWidth) {
      const vfloat va = load(a + i), vb = load(b + i), weight = load(row.weights + i), difference = va - vb;
      store(row.losses + i, weight * max(difference, -difference));
      if constexpr (Derivs > 0) {
        const float* derivs = row.derivs + i;
        const vfloat squares = 2.0f * load(derivs + stride_), product = load(derivs + 2 * stride_);
        const vfloat sign = keep(difference > 0.0f, weight * l1) - keep(difference < 0.0f, weight * l1);
        store(v_a + i, sign + by_ssim * (load(derivs) + va * squares + vb * product));
        if constexpr (Derivs > 3)
          store(v_b + i, by_ssim * (load(derivs + 3 * stride_) + vb * squares + va * product) - sign);
      }
    }
    l1_sum_ += sum_floats(row.losses, 3 * columns_);
    const int64_t at = (int64_t(y) * p_.width + tile_.x0) * 3;
    if constexpr (Derivs > 0) {
      for (int i = 0; i < 3 * columns_ && p_.clip; ++i) v_a[i] = p_.image[at + i] > 1.0f ? 0.0f : v_a[i];
      std::memcpy(p_.v_image + at, v_a, size_t(3 * columns_) * sizeof(float));
    }
    if constexpr (Derivs > 3) std::memcpy(p_.v_target + at, v_b, size_t(3 * columns_) * sizeof(float));
  }

  const ImageLossParams& p_;
  Tile tile_;
  int columns_, stride_;
  Ring moments_, derivs_;
  RowBuffers rows_[2];
  double ssim_sum_ = 0, l1_sum_ = 0;
};

double weight_sum(const ImageLossParams& p) {
  const int64_t n = int64_t(p.height) * p.width;
  if (!p.mask) return 3.0 * double(n);
  double lanes[8] = {};
  for (int64_t i = 0; i < n; ++i) lanes[i & 7] += double(p.mask[i]);
  return 3.0 * (((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])) + ((lanes[4] + lanes[5]) + (lanes[6] + lanes[7])));
}

double tile_loss(const ImageLossParams& p, const Tile& tile) {
  if (p.v_target) return LossTile<4>(p, tile).run();
  if (p.v_image) return LossTile<3>(p, tile).run();
  return LossTile<0>(p, tile).run();
}

ImageLossSums image_loss(const ImageLossParams& p) {
  ImageLossSums sums;
  sums.weight = weight_sum(p);
  const int bands = (p.height + kTileRows - 1) / kTileRows, strips = (p.width + kTileColumns - 1) / kTileColumns;
  std::vector<double> totals(size_t(bands) * strips);
  ThreadPool::instance().run(bands * strips, [&](int t) {
    const int band = t / strips, strip = t % strips;
    totals[size_t(t)] = tile_loss(p, {cut(p.height, band, bands), cut(p.height, band + 1, bands),
                                      cut(p.width, strip, strips), cut(p.width, strip + 1, strips)});
  });
  for (double total : totals) sums.total += total;
  return sums;
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
