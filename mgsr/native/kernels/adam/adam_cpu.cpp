// Fused Adam. All groups are cut into chunks of rows, which one run of the thread pool works off. Only one chunk reads
// and writes a number, so the result does not depend on the number of threads.
#include "kernels/adam/adam.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int64_t kChunkFloats = 16384;

struct Chunk {
  const AdamGroup* group;
  int64_t begin, end;  // rows
};

inline vfloat square_root(vfloat x) {
#if defined(MGSR_ISA_avx512)
  return (vfloat)_mm512_maskz_sqrt_ps(__mmask16(-1), (__m512)x);  // masked, as GCC 12 warns about the unmasked form
#elif defined(MGSR_ISA_avx2)
  return (vfloat)_mm256_sqrt_ps((__m256)x);
#elif defined(__SSE2__)
  return (vfloat)_mm_sqrt_ps((__m128)x);
#else
  vfloat root;
  for (int i = 0; i < kWidth; ++i) root[i] = std::sqrt(x[i]);
  return root;
#endif
}

inline void update_vector(const AdamGroup& g, int64_t i, vfloat rate) {
  vfloat first = load(g.first + i), second = load(g.second + i);
  adam_moments(g.step, load(g.gradients + i), first, second);
  store(g.first + i, first);
  store(g.second + i, second);
  store(g.values + i, load(g.values + i) - adam_change(g.step, rate, first, square_root(second)));
}

inline void update_one(const AdamGroup& g, int64_t i, float rate) {
  float first = g.first[i], second = g.second[i];
  adam_moments(g.step, g.gradients[i], first, second);
  g.first[i] = first, g.second[i] = second;
  g.values[i] -= adam_change(g.step, rate, first, std::sqrt(second));
}

void update_floats(const AdamGroup& g, int64_t begin, int64_t end) {
  int64_t i = begin;
  for (; i + kWidth <= end; i += kWidth) update_vector(g, i, splat(g.rate));
  for (; i < end; ++i) update_one(g, i, g.rate);
}

void update_scaled_row(const AdamGroup& g, int64_t row) {
  const int64_t at = row * g.columns;
  int c = 0;
  for (; c + kWidth <= g.columns; c += kWidth) update_vector(g, at + c, g.rate * load(g.column_scales + c));
  for (; c < g.columns; ++c) update_one(g, at + c, g.rate * g.column_scales[c]);
}

void update_chunk(const Chunk& chunk) {
  const AdamGroup& g = *chunk.group;
  if (!g.column_scales) return update_floats(g, chunk.begin * g.columns, chunk.end * g.columns);
  for (int64_t row = chunk.begin; row < chunk.end; ++row) update_scaled_row(g, row);
}

void update(const AdamGroup* groups, int count) {
  std::vector<Chunk> chunks;
  for (int i = 0; i < count; ++i) {
    const AdamGroup& g = groups[i];
    const int64_t rows = std::max<int64_t>(1, kChunkFloats / std::max(1, g.columns));
    for (int64_t begin = 0; begin < g.rows; begin += rows) chunks.push_back({&g, begin, std::min(begin + rows, g.rows)});
  }
  ThreadPool::instance().run(int(chunks.size()), [&](int c) { update_chunk(chunks[size_t(c)]); });
}

}  // namespace

extern const AdamTable adam_table{update};

}  // namespace MGSR_ISA
}  // namespace mgsr
