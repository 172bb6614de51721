// 2D surfels on the GPU.
//
// Forward: surfels_project runs one thread per splat. mgsr/native/cuda/tiles.py then sorts by depth and makes the
// tiles' lists. surfels_blend runs one block per tile and one thread per pixel.
// Backward: surfels_pixels prepares the gradient images. surfels_backward runs one warp per bucket of 32 splats of a
// tile, and writes each (splat, tile) pair's gradient to the pair's own slot. tiles_sum adds a splat's slots in their
// order.
// surfels_gradients runs one thread per splat, and converts the sums to gradients of the parameters.
#include "kernels/surfels/backward_cuda.h"
#include "kernels/surfels/blending_cuda.h"
#include "kernels/surfels/projection_cuda.h"

MGSR_KERNEL(surfels_project, mgsr::SurfelProjectParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i >= p.in.count) return;
  SurfelRecord record = {};
  SplatOutline outline = {};
  const bool seen = project_surfel_splat(p.in, i, record, outline) && on_image(outline, p.in.width, p.in.height);
  p.depths[i] = seen ? record.depth() : kCulledDepth;
  p.radii[i] = seen ? fmaxf(fmaxf(outline.ellipse.hx, outline.ellipse.hy), outline.radius) : 0.0f;
  p.tile_counts[i] = seen ? count_touched_tiles(outline, p.in.width, p.in.height) : 0;
  if (seen) p.records[i] = record, p.outlines[i] = outline;
}

MGSR_KERNEL(surfels_blend_plain, mgsr::SurfelBlendParams, mgsr::kTilePixels) { mgsr::blend_surfels<false>(p); }
MGSR_KERNEL(surfels_blend_distortion, mgsr::SurfelBlendParams, mgsr::kTilePixels) { mgsr::blend_surfels<true>(p); }

MGSR_KERNEL(surfels_pixels_plain, mgsr::SurfelPixelParams, mgsr::kTilePixels) { mgsr::prepare_pixel<false>(p); }
MGSR_KERNEL(surfels_pixels_distortion, mgsr::SurfelPixelParams, mgsr::kTilePixels) { mgsr::prepare_pixel<true>(p); }

MGSR_KERNEL(surfels_backward_plain, mgsr::SurfelBackwardParams, mgsr::kBucketThreads) { mgsr::walk_bucket<false>(p); }
MGSR_KERNEL(surfels_backward_distortion, mgsr::SurfelBackwardParams, mgsr::kBucketThreads) { mgsr::walk_bucket<true>(p); }

MGSR_KERNEL(surfels_gradients, mgsr::SurfelGradientParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i < p.in.count) surfel_splat_gradients(p, i);
}
