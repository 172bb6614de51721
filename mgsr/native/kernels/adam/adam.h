// The Adam family: what its kernels read and write.
#pragma once

#include <cstdint>

#include "math/adam.h"

namespace mgsr {

// One packed parameter [rows, columns] with its own rate and step count.
struct AdamGroup {
  int64_t rows = 0;
  int columns = 0;
  float* values = nullptr;
  const float* gradients = nullptr;
  float* first = nullptr;
  float* second = nullptr;
  const float* column_scales = nullptr;  // [columns], multiplies the rate; or null for 1 everywhere
  float rate = 0;                        // learning rate / (1 - beta1^t)
  AdamStep step = {};
};

struct AdamTable {
  void (*update)(const AdamGroup* groups, int count);
};

namespace avx512 { extern const AdamTable adam_table; }
namespace avx2 { extern const AdamTable adam_table; }
namespace baseline { extern const AdamTable adam_table; }

}  // namespace mgsr
