// The colours of spherical harmonics on the GPU. A block takes 64 splats. Their rows of coefficients pass through
// shared memory, so that global memory is accessed in whole lines although each thread works on its own splat. No sums
// over splats are needed.
#include "kernels/common/cuda.h"
#include "math/harmonics.h"

namespace mgsr {

constexpr int kHarmonicsThreads = 64, kMostFloats = 48;

struct HarmonicsParams {
  int64_t n;            // splats
  int k, degree;        // coefficients stored per channel: 1, 4, 9 or 16; highest band in use
  const float* coeffs;  // [n, k, 3]
  const float* means;   // [n, 3]
  float center[3];      // of the camera
  float* rgb;           // [n, 3]: written by forward, read by backward
  const float* v_rgb;   // [n, 3]
  float* v_coeffs;      // [n, k, 3], overwritten
  float* v_means;       // [n, 3], added to; or null
};

// The stride of a splat's row in shared memory: one float more than needed, so that neighbouring threads use different
// banks.
constexpr int kRowStride = kMostFloats + 1;
using HarmonicsRows = float[kHarmonicsThreads * kRowStride];

__device__ inline int block_splats(const HarmonicsParams& p, int64_t first) {
  return p.n - first < kHarmonicsThreads ? int(p.n - first) : kHarmonicsThreads;
}

__device__ inline void load_rows(const HarmonicsParams& p, int64_t first, float* rows) {
  const int floats = 3 * p.k, total = block_splats(p, first) * floats;
  for (int i = threadIdx.x; i < total; i += kHarmonicsThreads) rows[i / floats * kRowStride + i % floats] = p.coeffs[first * floats + i];
  __syncthreads();
}

__device__ inline void store_rows(const HarmonicsParams& p, int64_t first, const float* rows) {
  __syncthreads();
  const int floats = 3 * p.k, total = block_splats(p, first) * floats;
  for (int i = threadIdx.x; i < total; i += kHarmonicsThreads) p.v_coeffs[first * floats + i] = rows[i / floats * kRowStride + i % floats];
}

// Writes the unit vector from the camera to a splat, and returns the inverse length.
__device__ inline float direction(const HarmonicsParams& p, int64_t splat, float u[3]) {
  for (int c = 0; c < 3; ++c) u[c] = p.means[3 * splat + c] - p.center[c];
  const float inverse = inverse_length(u[0], u[1], u[2]);
  for (int c = 0; c < 3; ++c) u[c] *= inverse;
  return inverse;
}

template <int D>
__device__ void harmonics_forward(const HarmonicsParams& p) {
  __shared__ HarmonicsRows rows;
  const int64_t first = int64_t(blockIdx.x) * kHarmonicsThreads, splat = first + threadIdx.x;
  load_rows(p, first, rows);
  if (splat >= p.n) return;
  float u[3], rgb[3];
  direction(p, splat, u);
  harmonics_to_rgb<D>(rows + threadIdx.x * kRowStride, u, rgb);
  for (int c = 0; c < 3; ++c) p.rgb[3 * splat + c] = rgb[c];
}

template <int D>
__device__ void harmonics_backward(const HarmonicsParams& p) {
  __shared__ HarmonicsRows rows;
  const int64_t first = int64_t(blockIdx.x) * kHarmonicsThreads, splat = first + threadIdx.x;
  load_rows(p, first, rows);
  if (splat < p.n) {
    float* row = rows + threadIdx.x * kRowStride;
    float u[3], v_u[3] = {}, v_mean[3] = {}, v_coeffs[3 * (D + 1) * (D + 1)];
    const float inverse = direction(p, splat, u);
    harmonics_to_rgb_vjp<D>(row, u, p.rgb + 3 * splat, p.v_rgb + 3 * splat, v_coeffs, v_u);
    for (int j = 0; j < 3 * (D + 1) * (D + 1); ++j) row[j] = v_coeffs[j];
    for (int j = 3 * (D + 1) * (D + 1); j < 3 * p.k; ++j) row[j] = 0.0f;
    unit_vector_vjp(u, inverse, v_u, v_mean);
    for (int c = 0; c < 3 && p.v_means; ++c) p.v_means[3 * splat + c] += v_mean[c];
  }
  store_rows(p, first, rows);
}

}  // namespace mgsr

MGSR_KERNEL(harmonics_forward_0, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_forward<0>(p); }
MGSR_KERNEL(harmonics_forward_1, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_forward<1>(p); }
MGSR_KERNEL(harmonics_forward_2, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_forward<2>(p); }
MGSR_KERNEL(harmonics_forward_3, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_forward<3>(p); }
MGSR_KERNEL(harmonics_backward_0, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_backward<0>(p); }
MGSR_KERNEL(harmonics_backward_1, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_backward<1>(p); }
MGSR_KERNEL(harmonics_backward_2, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_backward<2>(p); }
MGSR_KERNEL(harmonics_backward_3, mgsr::HarmonicsParams, mgsr::kHarmonicsThreads) { mgsr::harmonics_backward<3>(p); }
