// Fused Adam. A block updates kAdamFloats neighbouring numbers of one group, a thread every kAdamThreads-th of them; all
// groups go in one launch. A number is read and written by one thread alone.
#include "kernels/adam/group.h"
#include "kernels/common/cuda.h"

namespace mgsr {

constexpr int kAdamGroups = 16, kAdamThreads = 256, kAdamFloats = 1024;

struct AdamParams {
  int groups;
  int ends[kAdamGroups];  // of each group's blocks: the first block behind it
  AdamGroup group[kAdamGroups];
};

__device__ inline void update_number(const AdamGroup& g, int64_t i, float rate) {
  float first = g.first[i], second = g.second[i];
  adam_moments(g.step, g.gradients[i], first, second);
  g.first[i] = first, g.second[i] = second;
  g.values[i] -= adam_change(g.step, rate, first, sqrtf(second));
}

}  // namespace mgsr

MGSR_KERNEL(adam_update, mgsr::AdamParams, mgsr::kAdamThreads) {
  using namespace mgsr;
  const int block = blockIdx.x;
  int index = 0;
  while (index + 1 < p.groups && block >= p.ends[index]) ++index;
  const AdamGroup& g = p.group[index];
  const int64_t begin = int64_t(block - (index > 0 ? p.ends[index - 1] : 0)) * kAdamFloats;
  const int64_t left = g.rows * g.columns - begin;
  const int count = left < kAdamFloats ? int(left) : kAdamFloats;
  const int column = int(begin % g.columns);
  for (int i = threadIdx.x; i < count; i += kAdamThreads) {
    const float scale = g.column_scales ? g.column_scales[(column + i) % g.columns] : 1.0f;
    update_number(g, begin + i, g.rate * scale);
  }
}
