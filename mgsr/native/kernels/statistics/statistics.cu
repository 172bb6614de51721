// Gathers the statistics of densification after a rendering, in one launch with one thread per splat.
#include "kernels/common/cuda.h"

namespace mgsr {

constexpr int kStatisticsThreads = 256;

struct StatisticsParams {
  int64_t count;
  const float* v_means2d;  // [count, 2] per pixel
  const float* radii;      // [count] pixels, 0 for culled splats
  float scale_x, scale_y;  // pixels per unit of the sums
  const bool* bad;         // whether v_means2d counts as zero; null means it does not
  float* gradient_sum;     // [count], added to
  float* seen;             // [count], added to
};

}  // namespace mgsr

MGSR_KERNEL(statistics_gather, mgsr::StatisticsParams, mgsr::kStatisticsThreads) {
  const int64_t i = int64_t(blockIdx.x) * mgsr::kStatisticsThreads + threadIdx.x;
  if (i >= p.count) return;
  const float x = p.v_means2d[2 * i] * p.scale_x, y = p.v_means2d[2 * i + 1] * p.scale_y;
  if (!p.bad || !*p.bad) p.gradient_sum[i] += sqrtf(x * x + y * y);
  if (p.radii[i] > 0.0f) p.seen[i] += 1.0f;
}
