// Edge-aware total variation of one pair of neighbouring pixels.
#pragma once

#include "math/macros.h"

namespace mgsr {

// Returns the weight of a pair, given the mean over channels of the guide's absolute difference.
template <class T>
MGSR_HD T tv_weight(T guide_difference) {
#if defined(__CUDACC__) || defined(__CUDACC_RTC__)
  return exp(-guide_difference);
#else
  return std::exp(-guide_difference);
#endif
}

template <class T>
MGSR_HD T tv_pair(T difference, T weight) {
  return weight * difference * difference;
}

// Returns the derivative of tv_pair with respect to the difference.
template <class T>
MGSR_HD T tv_pair_vjp(T difference, T weight) {
  return 2.0f * weight * difference;
}

}  // namespace mgsr
