// Definitions for every maths header. They may include no CUDA, torch, standard-library or binding header, because
// NVRTC compiles them too.
//
// The scalar T of the maths is float, double, or a class of several lanes with the same operators. Because of the
// lanes, a choice is written select(condition, a, b), and the type of a condition is Condition<T>.
#pragma once

// `static` gives each compiled variant its own copy: the linker must never give AVX-512 code to the baseline.
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

// Fast functions for uses in which the last two bits don't matter. On a GPU they are the hardware's approximations,
// which treat numbers under 2^-126 as zero. Their relative errors are 2^-23 for the square root and 2^-22 for the
// power. The quotient has 2 ulp, and its divisor must be less than 2^126. On the CPU they are exact.
// rounded_product: a product that no compiler fuses with a sum.
#if defined(__CUDACC_RTC__)
#define MGSR_APPROXIMATE(instruction, x) \
  float y;                               \
  asm(instruction ".approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
MGSR_HD float quick_quotient(float a, float b) {
  MGSR_APPROXIMATE("rcp", b)
  return a * y;
}
MGSR_HD float quick_sqrt(float x) {
  MGSR_APPROXIMATE("sqrt", x)
  return y;
}
MGSR_HD float quick_exp2(float x) {
  MGSR_APPROXIMATE("ex2", x)
  return y;
}
#undef MGSR_APPROXIMATE
MGSR_HD float rounded_product(float a, float b) { return __fmul_rn(a, b); }
#else
MGSR_HD float quick_quotient(float a, float b) { return a / b; }
MGSR_HD float quick_sqrt(float x) { return sqrt(x); }
MGSR_HD float quick_exp2(float x) { return exp2(x); }
MGSR_HD float rounded_product(float a, float b) { return a * b; }
#endif

}  // namespace mgsr
