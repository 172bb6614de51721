// Edge-aware total variation with its gradient. A band of rows is one task. It keeps the flux (the derivative of each
// pair) of the row above, so a pixel's gradient is the difference of four fluxes. The sums of the bands are added in
// order.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"
#include "kernels/image/image.h"
#include "kernels/image/rows.h"
#include "math/tv.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kTvBandRows = 32;

class TvBand {
 public:
  TvBand(const TvParams& p, int y0, int y1) : p_(p), y0_(y0), y1_(y1), floats_(p.width * p.channels) {
    const size_t row = size_t(std::max(3, p.channels)) * (p.width + 1) + 2 * kWidth;
    static thread_local std::vector<float> scratch;
    if (scratch.size() < 6 * row) scratch.resize(6 * row);
    float* next = scratch.data();
    const auto take = [&] { float* at = next; next += row; return at; };
    gaps_ = take(), weights_ = take(), terms_ = take(), across_ = take(), above_ = take(), below_ = take();
  }

  TvSums run() {
    std::fill_n(above_, floats_, 0.0f);
    if (y0_ > 0) pairs_down(y0_ - 1, above_, false);
    for (int y = y0_; y < y1_; ++y) {
      pairs_across(y);
      std::fill_n(below_, floats_, 0.0f);
      if (y + 1 < p_.height) pairs_down(y, below_, true);
      if (p_.v_values) write_gradient(y);
      std::swap(above_, below_);
    }
    return sums_;
  }

 private:
  const float* values(int y) const { return p_.values + int64_t(y) * floats_; }
  const float* guide(int y) const { return p_.guide + int64_t(y) * p_.width * 3; }
  const float* mask(int y) const { return p_.mask ? p_.mask + int64_t(y) * p_.width : nullptr; }

  // Finds weights_ of `pairs` pairs of pixels, repeated for all channels. The arguments give the first and the second
  // pixel of each pair.
  void find_weights(const float* g0, const float* g1, const float* m0, const float* m1, int pairs, bool counted) {
    for (int i = 0; i < 3 * pairs; ++i) gaps_[i] = std::fabs(g1[i] - g0[i]);
    float* weights = p_.channels == 1 ? weights_ : terms_;
    for (int i = 0; i < pairs; ++i) weights[i] = (gaps_[3 * i] + gaps_[3 * i + 1] + gaps_[3 * i + 2]) * (1.0f / 3);
    for (int i = 0; i < pairs; i += kWidth)  // e^-x = 2^(-x log2 e)
      store(weights + i, exp2_nonpositive(load(weights + i) * -1.44269504f));
    if (m0) {
      for (int i = 0; i < pairs; ++i) gaps_[i] = m0[i] * m1[i];
      for (int i = 0; i < pairs; ++i) weights[i] *= gaps_[i];
    }
    if (counted) sums_.pairs += m0 ? sum_floats(gaps_, pairs) : double(pairs);
    if (p_.channels == 1) return;
    for (int i = 0; i < pairs; ++i)
      for (int c = 0; c < p_.channels; ++c) weights_[i * p_.channels + c] = weights[i];
  }

  void find_flux(const float* v0, const float* v1, int pairs, float* flux, bool counted) {
    const int n = pairs * p_.channels;
    for (int i = 0; i < n; ++i) {
      const float difference = v1[i] - v0[i];
      terms_[i] = tv_pair(difference, weights_[i]);
      flux[i] = tv_pair_vjp(difference, weights_[i]);
    }
    if (counted) sums_.total += sum_floats(terms_, n);
  }

  // Fills across_: zeros for the pair left of the first pixel, the row's pairs, zeros for the pair right of the last
  // one.
  void pairs_across(int y) {
    const int channels = p_.channels, pairs = p_.width - 1;
    const float *g = guide(y), *v = values(y), *m = mask(y);
    std::fill_n(across_, channels, 0.0f);
    find_weights(g, g + 3, m, m ? m + 1 : nullptr, pairs, true);
    find_flux(v, v + channels, pairs, across_ + channels, true);
    std::fill_n(across_ + floats_, channels, 0.0f);
  }

  void pairs_down(int y, float* flux, bool counted) {
    find_weights(guide(y), guide(y + 1), mask(y), mask(y + 1), p_.width, counted);
    find_flux(values(y), values(y + 1), p_.width, flux, counted);
  }

  void write_gradient(int y) {
    float* out = p_.v_values + int64_t(y) * floats_;
    const float* right = across_ + p_.channels;
    for (int i = 0; i < floats_; ++i) out[i] = (across_[i] - right[i]) + (above_[i] - below_[i]);
  }

  const TvParams& p_;
  int y0_, y1_, floats_;
  float *gaps_, *weights_, *terms_, *across_, *above_, *below_;
  TvSums sums_;
};

TvSums tv(const TvParams& p) {
  const int bands = (p.height + kTvBandRows - 1) / kTvBandRows;
  std::vector<TvSums> parts(static_cast<size_t>(bands));
  ThreadPool::instance().run(bands, [&](int b) {
    parts[size_t(b)] = TvBand(p, cut(p.height, b, bands), cut(p.height, b + 1, bands)).run();
  });
  TvSums sums;
  for (const TvSums& part : parts) sums.total += part.total, sums.pairs += part.pairs;
  return sums;
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
