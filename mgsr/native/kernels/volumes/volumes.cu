// 3D Gaussians on the GPU.
//
// Forward: volumes_project (one thread, one splat); then, by mgsr/native/cuda/tiles.py, the sort by depth and the tiles'
// lists; volumes_blend (one block, one tile; one thread, one pixel). Backward: volumes_pixels makes the gradient images
// ready; volumes_backward (one warp, one bucket of 32 splats of a tile) leaves each (splat, tile) pair's gradient in the
// pair's own slot; tiles_sum adds a splat's slots in their order; volumes_gradients (one thread, one splat) takes the sums
// back to the parameters.
#include "kernels/volumes/backward_cuda.h"
#include "kernels/volumes/blending_cuda.h"
#include "kernels/volumes/projection_cuda.h"

MGSR_KERNEL(volumes_project, mgsr::VolumeProjectParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i >= p.in.count) return;
  VolumeRecord record = {};
  SplatOutline outline = {};
  const bool seen = project_volume(p.in, i, record, outline) && on_image(outline, p.in.width, p.in.height);
  p.depths[i] = seen ? record.depth : kCulledDepth;
  p.radii[i] = seen ? fmaxf(outline.ellipse.hx, outline.ellipse.hy) : 0.0f;
  p.tile_counts[i] = seen ? count_touched_tiles(outline, p.in.width, p.in.height) : 0;
  if (seen) p.records[i] = record, p.outlines[i] = outline;
}

MGSR_KERNEL(volumes_blend_single, mgsr::VolumeBlendParams, mgsr::kTilePixels) { mgsr::blend_volumes<false>(p); }
MGSR_KERNEL(volumes_blend_dual, mgsr::VolumeBlendParams, mgsr::kTilePixels) { mgsr::blend_volumes<true>(p); }

MGSR_KERNEL(volumes_pixels_single, mgsr::VolumePixelParams, mgsr::kTilePixels) { mgsr::prepare_pixel<false>(p); }
MGSR_KERNEL(volumes_pixels_dual, mgsr::VolumePixelParams, mgsr::kTilePixels) { mgsr::prepare_pixel<true>(p); }

MGSR_KERNEL(volumes_backward_single, mgsr::VolumeBackwardParams, mgsr::kBucketThreads) { mgsr::walk_bucket<false>(p); }
MGSR_KERNEL(volumes_backward_dual, mgsr::VolumeBackwardParams, mgsr::kBucketThreads) { mgsr::walk_bucket<true>(p); }

MGSR_KERNEL(volumes_gradients, mgsr::VolumeGradientParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i < p.in.count) volume_gradients(p, i);
}
