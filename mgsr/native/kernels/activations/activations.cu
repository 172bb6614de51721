// Converts stored parameters to activated values, for several arrays in one launch. A block takes kActivationFloats
// neighbouring numbers of one array, and a thread every kActivationThreads-th of them.
#include "kernels/common/cuda.h"

namespace mgsr {

constexpr int kActivationArrays = 8, kActivationThreads = 256, kActivationFloats = 1024;

enum class Activation : int { kExp, kSigmoid };

struct ActivatedArray {
  Activation kind;
  int end;             // the first block after those of the array
  int64_t count;
  const float* in;     // the stored parameters; backward: the activated values
  const float* v_out;  // backward: the gradient of the activated values, or null for 0
  float* out;          // the activated values; backward: the gradient of the stored parameters
};

struct ActivationParams {
  int arrays;
  float largest;  // above it the exponential is constant
  ActivatedArray array[kActivationArrays];
};

// Returns the array of this block, and writes the index of the block's first number.
__device__ inline const ActivatedArray& block_array(const ActivationParams& p, int64_t& begin) {
  const BlockInArrays at(p.arrays, [&](int i) { return p.array[i].end; });
  begin = int64_t(at.block) * kActivationFloats;
  return p.array[at.array];
}

}  // namespace mgsr

MGSR_KERNEL(activations_forward, mgsr::ActivationParams, mgsr::kActivationThreads) {
  using namespace mgsr;
  int64_t begin;
  const ActivatedArray& array = block_array(p, begin);
  for (int64_t i = begin + threadIdx.x; i < begin + kActivationFloats && i < array.count; i += kActivationThreads) {
    const float x = array.in[i];
    array.out[i] = array.kind == Activation::kExp ? expf(x > p.largest ? p.largest : x) : 1.0f / (1.0f + expf(-x));
  }
}

MGSR_KERNEL(activations_backward, mgsr::ActivationParams, mgsr::kActivationThreads) {
  using namespace mgsr;
  int64_t begin;
  const ActivatedArray& array = block_array(p, begin);
  const float most = 0.999999f * expf(p.largest);  // less than any rounded value of that exponential
  for (int64_t i = begin + threadIdx.x; i < begin + kActivationFloats && i < array.count; i += kActivationThreads) {
    const float y = array.in[i], v = array.v_out ? array.v_out[i] : 0.0f;
    array.out[i] = array.kind == Activation::kSigmoid ? v * y * (1.0f - y) : y >= most ? 0.0f : v * y;
  }
}
