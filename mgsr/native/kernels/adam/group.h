// A packed parameter [rows, columns] with a learning rate and step count of its own.
#pragma once

#include "kernels/common/integers.h"
#include "math/adam.h"

namespace mgsr {

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

}  // namespace mgsr
