// What every maths header needs. No CUDA, torch, standard-library or binding header: NVRTC includes these too.
//
// The scalar T of the maths is float, double, or a class of several lanes that counts like them. For the lanes, a choice
// is written select(condition, a, b), and a condition's type is Condition<T>.
#pragma once

// `static` keeps each compiled variant's copy its own: the linker must never give AVX-512 code to the baseline.
#if defined(__CUDACC__) || defined(__CUDACC_RTC__)
#define MGSR_HD static __host__ __device__ __forceinline__
#define MGSR_MEMBER __host__ __device__ __forceinline__
#else
#include <cmath>
#define MGSR_HD static inline
#define MGSR_MEMBER
namespace mgsr {
using std::exp2;
using std::fma;
using std::log;
using std::log2;
using std::sqrt;
}
#endif
#define MGSR_SQRT(x) sqrt(x)

namespace mgsr {

template <class T>
using Condition = decltype(T() < T());

template <class T>
MGSR_HD T select(bool condition, T a, T b) {
  return condition ? a : b;
}

MGSR_HD bool any(bool condition) { return condition; }

}  // namespace mgsr
