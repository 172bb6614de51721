// The image family on the GPU: the render loss, total variation, the normals of depth maps, and their agreement with
// other normals. The headers describe the kernels.
#include "kernels/image/depth_normals_cuda.h"
#include "kernels/image/loss_cuda.h"
#include "kernels/common/sums_cuda.h"
#include "kernels/image/tv_cuda.h"

MGSR_KERNEL(image_loss, mgsr::ImageLossParams, mgsr::kLossThreads) { mgsr::image_loss(p); }
MGSR_KERNEL(image_loss_gradient, mgsr::ImageLossParams, mgsr::kLossThreads) { mgsr::image_loss_gradient(p); }
MGSR_KERNEL(image_tv, mgsr::TvParams, mgsr::kPixelThreads) { mgsr::tv(p); }

MGSR_KERNEL(image_depth_normals, mgsr::DepthNormalsParams, mgsr::kPixelThreads) {
  const int64_t i = int64_t(blockIdx.x) * mgsr::kPixelThreads + threadIdx.x;
  if (i < int64_t(p.height) * p.width) mgsr::write_normal(p, int(i % p.width), int(i / p.width));
}

MGSR_KERNEL(image_normal_agreement, mgsr::AgreementParams, mgsr::kPixelThreads) { mgsr::normal_agreement(p); }

MGSR_KERNEL(image_depth_normals_vjp, mgsr::DepthNormalsParams, mgsr::kPixelThreads) {
  const int64_t i = int64_t(blockIdx.x) * mgsr::kPixelThreads + threadIdx.x;
  if (i < int64_t(p.height) * p.width) mgsr::write_depth_gradient(p, int(i % p.width), int(i / p.width));
}
