// What every maths header needs. No CUDA, torch, standard-library or binding header: NVRTC includes these too.
#pragma once

// `static` keeps each compiled variant's copy its own: the linker must never give AVX-512 code to the baseline.
#if defined(__CUDACC__) || defined(__CUDACC_RTC__)
#define MGSR_HD static __host__ __device__ __forceinline__
#define MGSR_SQRT(x) sqrt(x)
#else
#include <cmath>
#define MGSR_HD static inline
#define MGSR_SQRT(x) std::sqrt(x)
#endif
