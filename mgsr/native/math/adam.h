// One step of Adam (Kingma and Ba 2015, Algorithm 1). T is float, double or a vector of floats.
#pragma once

#include "math/macros.h"

namespace mgsr {

// The values that all parameters of a step share. The caller folds in the bias corrections 1 / (1 - beta^t):
// rate = lr / (1 - beta1^t), root_scale = 1 / sqrt(1 - beta2^t).
struct AdamStep {
  float beta1, beta2, epsilon, root_scale;
};

// Updates both moments with a gradient.
template <class T>
MGSR_HD void adam_moments(const AdamStep& step, T gradient, T& first, T& second) {
  first = step.beta1 * first + (1.0f - step.beta1) * gradient;
  second = step.beta2 * second + (1.0f - step.beta2) * gradient * gradient;
}

// Returns the change to subtract from the parameter; root is sqrt(second).
template <class T>
MGSR_HD T adam_change(const AdamStep& step, T rate, T first, T root) {
  return rate * first / (root * step.root_scale + step.epsilon);
}

}  // namespace mgsr
