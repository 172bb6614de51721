// 3D Gaussians on the GPU.
//
// Forward: gaussians_project runs one thread per splat. mgsr/native/cuda/tiles.py then sorts by depth and makes the
// tiles' lists. gaussians_blend runs one block per tile and one thread per pixel.
// Backward: gaussians_pixels prepares the gradient images. gaussians_backward runs one warp per bucket of 32 splats of
// a tile, and writes each (splat, tile) pair's gradient to the pair's own slot. tiles_sum adds a splat's slots in their
// order. gaussians_gradients runs one thread per splat, and converts the sums to gradients of the parameters.
#include "kernels/gaussians/backward_cuda.h"
#include "kernels/gaussians/blending_cuda.h"
#include "kernels/gaussians/projection_cuda.h"

MGSR_KERNEL(gaussians_project, mgsr::GaussianProjectParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i >= p.in.count) return;
  GaussianRecord record = {};
  SplatOutline outline = {};
  const bool seen = project_gaussian_splat(p.in, i, record, outline) && on_image(outline, p.in.width, p.in.height);
  p.depths[i] = seen ? record.depth : kCulledDepth;
  p.radii[i] = seen ? fmaxf(outline.ellipse.hx, outline.ellipse.hy) : 0.0f;
  p.tile_counts[i] = seen ? count_touched_tiles(outline, p.in.width, p.in.height) : 0;
  if (seen) p.records[i] = record, p.outlines[i] = outline;
}

MGSR_KERNEL(gaussians_blend_single, mgsr::GaussianBlendParams, mgsr::kTilePixels) { mgsr::blend_gaussians<false>(p); }
MGSR_KERNEL(gaussians_blend_dual, mgsr::GaussianBlendParams, mgsr::kTilePixels) { mgsr::blend_gaussians<true>(p); }

MGSR_KERNEL(gaussians_pixels_single, mgsr::GaussianPixelParams, mgsr::kTilePixels) { mgsr::prepare_pixel<false>(p); }
MGSR_KERNEL(gaussians_pixels_dual, mgsr::GaussianPixelParams, mgsr::kTilePixels) { mgsr::prepare_pixel<true>(p); }

MGSR_KERNEL(gaussians_backward_single, mgsr::GaussianBackwardParams, mgsr::kBucketThreads) { mgsr::walk_bucket<false>(p); }
MGSR_KERNEL(gaussians_backward_dual, mgsr::GaussianBackwardParams, mgsr::kBucketThreads) { mgsr::walk_bucket<true>(p); }

MGSR_KERNEL(gaussians_gradients, mgsr::GaussianGradientParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i < p.in.count) gaussian_gradients(p, i);
}
