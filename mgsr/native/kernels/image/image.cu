// The image family on the GPU: the render loss, total variation, normals of depth maps; each file says how it goes.
#include "kernels/image/depth_normals_cuda.h"
#include "kernels/image/loss_cuda.h"
#include "kernels/image/sums_cuda.h"
#include "kernels/image/tv_cuda.h"

namespace mgsr {

constexpr int kMeanThreads = 256;

// The mean from the blocks' totals: mean[0] = total / by, mean[1] = 1 / by, both 0 where that is, by = factor * weight.
enum class WeightFrom : int { kFactorAlone, kSums, kPointer };
struct MeanParams {
  const PartialSums* sums;
  int blocks;
  WeightFrom weight_from;
  double factor;
  const double* weight;  // for kPointer
  float* mean;
};

}  // namespace mgsr

MGSR_KERNEL(image_loss, mgsr::ImageLossParams, mgsr::kLossThreads) { mgsr::image_loss(p); }
MGSR_KERNEL(image_loss_gradient, mgsr::ImageLossParams, mgsr::kLossThreads) { mgsr::image_loss_gradient(p); }
MGSR_KERNEL(image_tv, mgsr::TvParams, mgsr::kPixelThreads) { mgsr::tv(p); }

MGSR_KERNEL(image_mean, mgsr::MeanParams, mgsr::kMeanThreads) {
  using namespace mgsr;
  double total = 0.0, weight = 0.0;
  for (int i = threadIdx.x; i < p.blocks; i += kMeanThreads) total += p.sums[i].total, weight += p.sums[i].weight;
  __shared__ PartialSums all;
  write_block_sums(total, weight, &all);
  if (threadIdx.x != 0) return;
  const double counted = p.weight_from == WeightFrom::kSums ? all.weight : p.weight_from == WeightFrom::kPointer ? *p.weight : 1.0;
  const double by = p.factor * counted, scale = by != 0.0 ? 1.0 / by : 0.0;
  p.mean[0] = float(all.total * scale), p.mean[1] = float(scale);
}

MGSR_KERNEL(image_depth_normals, mgsr::DepthNormalsParams, mgsr::kPixelThreads) {
  const int64_t i = int64_t(blockIdx.x) * mgsr::kPixelThreads + threadIdx.x;
  if (i < int64_t(p.height) * p.width) mgsr::write_normal(p, int(i % p.width), int(i / p.width));
}

MGSR_KERNEL(image_depth_normals_vjp, mgsr::DepthNormalsParams, mgsr::kPixelThreads) {
  const int64_t i = int64_t(blockIdx.x) * mgsr::kPixelThreads + threadIdx.x;
  if (i < int64_t(p.height) * p.width) mgsr::write_depth_gradient(p, int(i % p.width), int(i / p.width));
}
