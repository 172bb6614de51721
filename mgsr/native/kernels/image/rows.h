// Functions that the image kernels share: sums in a fixed order, and a division into parts of nearly equal size.
#pragma once

#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

inline double sum_floats(const float* values, int n) {
  vfloat lanes = {};
  int i = 0;
  for (; i + kWidth <= n; i += kWidth) lanes += load(values + i);
  double total = sum(lanes);
  for (; i < n; ++i) total += values[i];
  return total;
}

inline int cut(int begin, int end, int index, int count) { return begin + int(int64_t(end - begin) * index / count); }

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
