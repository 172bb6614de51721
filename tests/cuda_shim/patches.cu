// The patches that splats touch of one tile, by their records and by their outlines, for tests to compare.
#include "kernels/gaussians/blending_cuda.h"

struct PatchParams {
  int64_t count;
  const mgsr::GaussianRecord* records;    // [N]
  const mgsr::SplatOutline* outlines;   // [N]
  mgsr::Tiles tiles;
  int tile;
  int *of_records, *of_outlines;        // [N]
};

MGSR_KERNEL(touched, PatchParams, 128) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * 128 + threadIdx.x;
  if (i >= p.count) return;
  const TilePixel corner(p.tiles, p.tile, 0);
  p.of_records[i] = int(touched_patches(in_tile(p.records[i], corner)));
  p.of_outlines[i] = int(touched_patches(p.outlines[i], corner));
}
