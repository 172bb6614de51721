// The colours of spherical harmonics on the CPU. Each vector lane is a splat. kWidth rows of coefficients are
// transposed in registers when they are read, and their gradients when they are written. No sums over splats are
// needed.
#include "kernels/harmonics/harmonics.h"

#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"
#include "math/harmonics.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int64_t kChunk = 512;
constexpr int kMaxFloats = 48;

// Swaps the off-diagonal blocks of size Step. This is a template, so that the shuffles have constant patterns.
template <int Step>
inline void swap_blocks(vfloat* rows) {
  vint low = {}, high = {};
  for (int l = 0; l < kWidth; ++l) {
    low[l] = l & Step ? kWidth + l - Step : l;
    high[l] = l & Step ? kWidth + l : l + Step;
  }
#pragma GCC unroll 16
  for (int i = 0; i < kWidth; ++i) {
    if (i & Step) continue;
    const vfloat a = rows[i], b = rows[i + Step];
    rows[i] = __builtin_shuffle(a, b, low);
    rows[i + Step] = __builtin_shuffle(a, b, high);
  }
}

// Transposes a square matrix, by blocks of 1, 2, 4 ... lanes.
inline void transpose(vfloat* data) {
  vfloat rows[kWidth];
#pragma GCC unroll 16
  for (int i = 0; i < kWidth; ++i) rows[i] = data[i];
  swap_blocks<1>(rows);
  swap_blocks<2>(rows);
  if constexpr (kWidth > 4) swap_blocks<4>(rows);
  if constexpr (kWidth > 8) swap_blocks<8>(rows);
#pragma GCC unroll 16
  for (int i = 0; i < kWidth; ++i) data[i] = rows[i];
}

// Loads kWidth rows of `stride` floats from row `first` on, transposed to columns [stride rounded up][lane]. Rows past
// n repeat the last one.
inline void load_columns(const float* data, int64_t first, int64_t n, int stride, int used, vfloat* columns) {
  for (int j = 0; j < used; j += kWidth) {
    for (int i = 0; i < kWidth; ++i) {
      const int64_t row = first + i < n ? first + i : n - 1;
      const float* p = data + row * stride + j;
      if (j + kWidth <= stride) {
        columns[j + i] = load(p);
      } else {
        columns[j + i] = vfloat{};
        std::memcpy(&columns[j + i], p, size_t(stride - j) * sizeof(float));
      }
    }
    transpose(columns + j);
  }
}

inline void store_columns(float* data, int64_t first, int64_t n, int stride, vfloat* columns) {
  const int rows = int(n - first < kWidth ? n - first : kWidth);
  for (int j = 0; j < stride; j += kWidth) {
    transpose(columns + j);
    const int width = stride - j < kWidth ? stride - j : kWidth;
    for (int i = 0; i < rows; ++i) {
      float* p = data + (first + i) * stride + j;
      if (width == kWidth)
        store(p, columns[j + i]);
      else
        std::memcpy(p, &columns[j + i], size_t(width) * sizeof(float));
    }
  }
}

inline void load_triples(const float* data, int64_t first, int64_t n, vfloat out[3]) {
  for (int i = 0; i < kWidth; ++i) {
    const int64_t row = first + i < n ? first + i : n - 1;
    for (int c = 0; c < 3; ++c) out[c][i] = data[3 * row + c];
  }
}

inline void store_triples(float* data, int64_t first, int64_t n, const vfloat values[3]) {
  for (int i = 0; i < kWidth && first + i < n; ++i)
    for (int c = 0; c < 3; ++c) data[3 * (first + i) + c] = values[c][i];
}

// Writes the unit vectors from the camera to the splats, and returns the inverse lengths.
inline vfloat load_directions(const HarmonicsParams& p, int64_t first, vfloat u[3]) {
  load_triples(p.means, first, p.n, u);
  vfloat inverse;
  for (int c = 0; c < 3; ++c) u[c] -= p.center[c];
  for (int i = 0; i < kWidth; ++i) inverse[i] = inverse_length(u[0][i], u[1][i], u[2][i]);
  for (int c = 0; c < 3; ++c) u[c] *= inverse;
  return inverse;
}

template <int D>
void forward_block(const HarmonicsParams& p, int64_t first) {
  constexpr int used = 3 * (D + 1) * (D + 1);
  vfloat coeffs[kMaxFloats + kWidth], u[3], rgb[3];
  load_columns(p.coeffs, first, p.n, 3 * p.k, used, coeffs);
  load_directions(p, first, u);
  harmonics_to_rgb<D>(coeffs, u, rgb);
  store_triples(p.rgb, first, p.n, rgb);
}

template <int D>
void backward_block(const HarmonicsParams& p, int64_t first) {
  constexpr int used = 3 * (D + 1) * (D + 1);
  vfloat coeffs[kMaxFloats + kWidth], v_coeffs[kMaxFloats + kWidth];
  vfloat u[3], rgb[3], v_rgb[3], v_u[3] = {}, v_means[3] = {};
  load_columns(p.coeffs, first, p.n, 3 * p.k, used, coeffs);
  const vfloat inverse = load_directions(p, first, u);
  load_triples(p.rgb, first, p.n, rgb);
  load_triples(p.v_rgb, first, p.n, v_rgb);
  harmonics_to_rgb_vjp<D>(coeffs, u, rgb, v_rgb, v_coeffs, v_u);
  for (int j = used; j < 3 * p.k + kWidth && j < kMaxFloats + kWidth; ++j) v_coeffs[j] = vfloat{};
  store_columns(p.v_coeffs, first, p.n, 3 * p.k, v_coeffs);
  if (!p.v_means) return;
  unit_vector_vjp(u, inverse, v_u, v_means);
  vfloat before[3];
  load_triples(p.v_means, first, p.n, before);
  for (int c = 0; c < 3; ++c) v_means[c] += before[c];
  store_triples(p.v_means, first, p.n, v_means);
}

using Block = void (*)(const HarmonicsParams&, int64_t);

void run(const HarmonicsParams& p, const Block blocks[4]) {
  const Block block = blocks[p.degree];
  parallel_chunks(p.n, kChunk, [&](int64_t begin, int64_t end) {
    for (int64_t first = begin; first < end; first += kWidth) block(p, first);
  });
}

void forward(const HarmonicsParams& p) {
  constexpr Block blocks[4] = {forward_block<0>, forward_block<1>, forward_block<2>, forward_block<3>};
  run(p, blocks);
}

void backward(const HarmonicsParams& p) {
  constexpr Block blocks[4] = {backward_block<0>, backward_block<1>, backward_block<2>, backward_block<3>};
  run(p, blocks);
}

}  // namespace

extern const HarmonicsTable harmonics_table{forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
