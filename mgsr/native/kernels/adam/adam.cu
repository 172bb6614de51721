// Fused Adam, and the check for finite gradients before it. All groups share one launch. A block updates kAdamFloats
// neighbouring numbers of one group, and a thread every kAdamThreads-th of them. Only one thread reads and writes a
// number.
#include "kernels/adam/group.h"
#include "kernels/common/sums_cuda.h"

namespace mgsr {

constexpr int kAdamGroups = 16, kAdamThreads = 256, kAdamFloats = 1024, kJudgedArrays = 32;

struct AdamParams {
  int groups;
  int ends[kAdamGroups];  // for each group, the first block after its own
  const bool* bad;        // whether gradients count as zero; null means they do not
  AdamGroup group[kAdamGroups];
};

// Arrays whose squares are summed; a block takes kAdamFloats neighbouring numbers.
struct JudgedArray {
  int end;  // the first block after those of the array
  int64_t count;
  const float* values;
};

struct SquaresParams {
  int arrays;
  JudgedArray array[kJudgedArrays];
  PartialSums* sums;  // [blocks]
};

// bad: gets whether the sum of all squares, as a float, is not finite.
struct VerdictParams {
  const PartialSums* sums;
  int blocks;
  bool* bad;
};

__device__ inline void update_number(const AdamGroup& g, int64_t i, float rate, bool bad) {
  float first = g.first[i], second = g.second[i];
  adam_moments(g.step, bad ? 0.0f : g.gradients[i], first, second);
  g.first[i] = first, g.second[i] = second;
  g.values[i] -= adam_change(g.step, rate, first, sqrtf(second));
}

}  // namespace mgsr

MGSR_KERNEL(adam_update, mgsr::AdamParams, mgsr::kAdamThreads) {
  using namespace mgsr;
  const BlockInArrays at(p.groups, [&](int i) { return p.ends[i]; });
  const AdamGroup& g = p.group[at.array];
  const int64_t begin = int64_t(at.block) * kAdamFloats;
  const int64_t left = g.rows * g.columns - begin;
  const int count = left < kAdamFloats ? int(left) : kAdamFloats;
  const int column = int(begin % g.columns);
  for (int i = threadIdx.x; i < count; i += kAdamThreads) {
    const float scale = g.column_scales ? g.column_scales[(column + i) % g.columns] : 1.0f;
    update_number(g, begin + i, g.rate * scale, p.bad && *p.bad);
  }
}

MGSR_KERNEL(adam_squares, mgsr::SquaresParams, mgsr::kAdamThreads) {
  using namespace mgsr;
  const BlockInArrays at(p.arrays, [&](int i) { return p.array[i].end; });
  const JudgedArray& array = p.array[at.array];
  const int64_t begin = int64_t(at.block) * kAdamFloats;
  double total = 0.0;
  for (int64_t i = begin + threadIdx.x; i < begin + kAdamFloats && i < array.count; i += kAdamThreads)
    total += double(array.values[i] * array.values[i]);
  write_block_sums(total, 0.0, &p.sums[blockIdx.x]);
}

MGSR_KERNEL(adam_verdict, mgsr::VerdictParams, mgsr::kAdamThreads) {
  using namespace mgsr;
  double total = 0.0;
  for (int i = threadIdx.x; i < p.blocks; i += kAdamThreads) total += p.sums[i].total;
  __shared__ PartialSums all;
  write_block_sums(total, 0.0, &all);
  if (threadIdx.x != 0) return;
  const float size = float(all.total);
  *p.bad = !(size - size == 0.0f);
}
