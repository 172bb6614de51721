// The declaration of CUDA kernels. Kernel files use only plain CUDA C++: blocks, shared memory, barriers, and warp
// shuffles with full masks. So the host shim of the tests can run them. They use no atomics, so results don't depend on
// timing.
#pragma once

#include "kernels/common/integers.h"

namespace mgsr {

constexpr int kWarp = 32;
constexpr unsigned kFullWarp = 0xffffffffu;

// The work of a block in a launch that several arrays share: its array, and its index among the array's blocks.
// end_of(i): the first block after those of array i.
struct BlockInArrays {
  int array = 0, block;

  template <class EndOf>
  __device__ BlockInArrays(int arrays, const EndOf& end_of) {
    while (array + 1 < arrays && int(blockIdx.x) >= end_of(array)) ++array;
    block = int(blockIdx.x) - (array > 0 ? end_of(array - 1) : 0);
  }
};

}  // namespace mgsr

// Declares a kernel of at most `threads` threads per block that takes one struct by value, as p. The shim has its own
// form.
#ifndef MGSR_KERNEL
#define MGSR_KERNEL(name, Params, threads) \
  extern "C" __global__ void __launch_bounds__(threads) name(const __grid_constant__ Params p)
#endif
