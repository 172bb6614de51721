// Loops over pixels in chunks of a fixed size, each in a form that the compiler vectorises. The sums of the chunks are
// added in order.
#include "kernels/terms/terms.h"

#include <algorithm>
#include <vector>

#include "kernels/common/channels.h"
#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"
#include "math/silhouette.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kChunk = 8192;  // pixels or numbers per task

// Returns the sum of body(begin, end) over chunks of [0, n).
template <class Body>
double sum_chunks(int64_t n, const Body& body) {
  std::vector<double> parts(size_t((n + kChunk - 1) / kChunk));
  parallel_chunks(n, kChunk, [&](int64_t begin, int64_t end) { parts[size_t(begin / kChunk)] = body(begin, end); });
  double total = 0;
  for (const double part : parts) total += part;
  return total;
}

void target(const TargetParams& p) {
  float behind[3 * kStrip];
  for (int i = 0; i < 3 * kStrip; ++i) behind[i] = p.background[i % 3];
  parallel_chunks(p.pixels, kChunk, [&](int64_t first, int64_t last) {
    float shares[kStrip], spread[3 * kStrip];
    for (int64_t begin = first; begin < last; begin += kStrip) {
      const int n = int(std::min<int64_t>(kStrip, last - begin));
      for (int i = 0; i < n; ++i) shares[i] = float(p.mask[begin + i]) / 255.0f;
      std::copy(shares, shares + n, p.alpha + begin);
      repeat(shares, n, 3, spread);
      const uint8_t* image = p.image + 3 * begin;
      float* color = p.color + 3 * begin;
      for (int i = 0; i < 3 * n; ++i) color[i] = composited(image[i], behind[i], spread[i]);
    }
    if (p.weights)
      for (int64_t i = first; i < last; ++i) p.weights[i] = float(p.off_edge[i]);
  });
}

void covered(const CoveredParams& p) {
  parallel_chunks(p.pixels, kChunk, [&](int64_t begin, int64_t end) {
    if (p.mask)
      for (int64_t i = begin; i < end; ++i) p.covered[i] = float((p.alpha[i] > 0.5f) & (p.mask[i] > 0.5f));
    else
      for (int64_t i = begin; i < end; ++i) p.covered[i] = float(p.alpha[i] > 0.5f);
  });
}

double silhouette(const SilhouetteParams& p) {
  return sum_chunks(p.pixels, [&](int64_t first, int64_t last) {
    double total = 0;
    float weight[kStrip], slope[kStrip], value[kStrip];
    std::fill(weight, weight + kStrip, 1.0f);
    for (int64_t begin = first; begin < last; begin += kStrip) {
      const int n = int(std::min<int64_t>(kStrip, last - begin));
      const float *alpha = p.alpha + begin, *mask = p.mask + begin;
      if (p.weights) std::copy(p.weights + begin, p.weights + begin + n, weight);
      if (p.entropy) {
        for (int i = 0; i < n; ++i) total += silhouette_entropy(alpha[i] * weight[i], mask[i] * weight[i], slope[i]);
      } else {
        for (int i = 0; i < n; ++i) value[i] = silhouette_gap(alpha[i] * weight[i], mask[i] * weight[i], slope[i]);
        total += sum_floats(value, n);
      }
      if (p.v_alpha)
        for (int i = 0; i < n; ++i) p.v_alpha[begin + i] = slope[i] * weight[i];
    }
    return total;
  });
}

double squares(const SquaresParams& p) {
  return sum_chunks(p.count, [&](int64_t begin, int64_t end) {
    const int n = int(end - begin);
    float squared[kChunk], *out = p.differences + begin;
    std::copy(p.a + begin, p.a + end, out);
    if (p.b)
      for (int i = 0; i < n; ++i) out[i] -= p.b[begin + i];
    for (const float* weights : {p.first, p.second})
      if (weights)
        for (int i = 0; i < n; ++i) out[i] *= weights[begin + i];
    if (p.offset != 0)
      for (int i = 0; i < n; ++i) out[i] -= p.offset;
    for (int i = 0; i < n; ++i) squared[i] = out[i] * out[i];
    return sum_floats(squared, n);
  });
}

double product(const ProductParams& p) {
  return sum_chunks(p.pixels, [&](int64_t begin, int64_t end) {
    float products[kChunk];
    for (int64_t i = begin; i < end; ++i) {
      p.v_weight[i] = p.color[3 * i] + p.color[3 * i + 1] + p.color[3 * i + 2];
      products[i - begin] = p.weight[i] * p.v_weight[i];
    }
    return sum_floats(products, int(end - begin));
  });
}

double steps(const StepsParams& p) {
  const int row = p.side * p.channels;
  std::vector<double> parts(size_t(p.maps) * size_t(p.side));
  ThreadPool::instance().run(int(parts.size()), [&](int line) {
    const int y = line % p.side;
    const float* here = p.values + int64_t(line) * row;
    float* out = p.v_values + int64_t(line) * row;
    double total = 0;
    for (int i = 0; i < row; ++i) {
      const float right = i + p.channels < row ? here[i + p.channels] - here[i] : 0;
      const float left = i >= p.channels ? here[i] - here[i - p.channels] : 0;
      const float down = y + 1 < p.side ? here[i + row] - here[i] : 0, up = y > 0 ? here[i] - here[i - row] : 0;
      total += double(right) * double(right) + double(down) * double(down);
      out[i] = 2 * ((left - right) + (up - down));
    }
    parts[size_t(line)] = total;
  });
  double total = 0;
  for (const double part : parts) total += part;
  return total;
}

void gradient(const GradientParams& p) {
  parallel_chunks(p.pixels, kStrip, [&](int64_t begin, int64_t end) {
    const int n = int(end - begin), floats = n * p.channels;
    float* out = p.out + begin * p.channels;
    float spread[kMostChannels * kStrip];
    std::fill(out, out + floats, 0.0f);
    for (int k = 0; k < p.count; ++k) {
      const GradientPart& part = p.parts[k];
      const float* slopes = part.slopes + begin * (part.all_channels ? 1 : p.channels);
      if (part.all_channels) repeat(slopes, n, p.channels, spread);
      const float* own = part.all_channels ? spread : slopes;
      for (int i = 0; i < floats; ++i) out[i] += part.scale * own[i];
    }
  });
}

}  // namespace

extern const TermsTable terms_table{target, covered, silhouette, squares, product, steps, gradient};

}  // namespace MGSR_ISA
}  // namespace mgsr
