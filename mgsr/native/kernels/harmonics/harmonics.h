// The interface of the spherical harmonics kernels on the CPU.
#pragma once

#include <cstdint>

namespace mgsr {

struct HarmonicsParams {
  int64_t n = 0;      // splats
  int k = 1;          // coefficients stored per channel: 1, 4, 9 or 16
  int degree = 0;     // highest band in use
  const float* coeffs = nullptr;  // [n, k, 3]
  const float* means = nullptr;   // [n, 3]
  float center[3] = {};           // of the camera
  float* rgb = nullptr;           // [n, 3]: written by forward, read by backward
  const float* v_rgb = nullptr;   // [n, 3]
  float* v_coeffs = nullptr;      // [n, k, 3], overwritten
  float* v_means = nullptr;       // [n, 3], added to; or null
};

struct HarmonicsTable {
  void (*forward)(const HarmonicsParams&);
  void (*backward)(const HarmonicsParams&);
};

namespace avx512 { extern const HarmonicsTable harmonics_table; }
namespace avx2 { extern const HarmonicsTable harmonics_table; }
namespace baseline { extern const HarmonicsTable harmonics_table; }

}  // namespace mgsr
