// How a CUDA kernel is declared. Kernel files use plain CUDA C++ alone: blocks, shared memory, barriers and warp shuffles
// with full masks, so that the tests' host shim can run them, and no atomics, so that results don't depend on timing.
#pragma once

#include "kernels/common/integers.h"

namespace mgsr {

constexpr int kWarp = 32;
constexpr unsigned kFullWarp = 0xffffffffu;

// What a block works on where several arrays share a launch, each with blocks of its own: which array, and which of the
// array's blocks. end_of(i): the first block behind those of array i.
struct BlockInArrays {
  int array = 0, block;

  template <class EndOf>
  __device__ BlockInArrays(int arrays, const EndOf& end_of) {
    while (array + 1 < arrays && int(blockIdx.x) >= end_of(array)) ++array;
    block = int(blockIdx.x) - (array > 0 ? end_of(array - 1) : 0);
  }
};

}  // namespace mgsr

// A kernel of at most `threads` threads a block that takes one struct by value, as p. The shim has its own.
#ifndef MGSR_KERNEL
#define MGSR_KERNEL(name, Params, threads) \
  extern "C" __global__ void __launch_bounds__(threads) name(const __grid_constant__ Params p)
#endif
