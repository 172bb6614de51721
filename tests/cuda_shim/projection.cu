// The 3D branch's projection in two floats alone, in float64 alone, and as it is, for tests to compare.
#include "kernels/gaussians/projection_cuda.h"

struct ProjectionParams {
  mgsr::GaussianProjectParams to;
  int* sights;  // [N]
};

template <class Project>
void project_each(const ProjectionParams& p, const Project& project) {
  using namespace mgsr;
  const GaussianProjectParams& to = p.to;
  const int64_t i = int64_t(blockIdx.x) * kSplatThreads + threadIdx.x;
  if (i >= to.in.count) return;
  GaussianRecord record = {};
  SplatOutline outline = {};
  const Sight sight = project(to.in, i, record, outline);
  const bool seen = sight == Sight::kSeen && on_image(outline, to.in.width, to.in.height);
  p.sights[i] = int(sight);
  to.depths[i] = seen ? record.depth : kCulledDepth;
  to.radii[i] = seen ? fmaxf(outline.ellipse.hx, outline.ellipse.hy) : 0.0f;
  to.tile_counts[i] = seen ? count_touched_tiles(outline, to.in.width, to.in.height) : 0;
  to.records[i] = record, to.outlines[i] = outline;
}

MGSR_KERNEL(in_two_floats, ProjectionParams, mgsr::kSplatThreads) { project_each(p, mgsr::project_as<mgsr::TwoFloats>); }
MGSR_KERNEL(in_double, ProjectionParams, mgsr::kSplatThreads) { project_each(p, mgsr::project_as<double>); }

MGSR_KERNEL(as_projected, ProjectionParams, mgsr::kSplatThreads) {
  using namespace mgsr;
  project_each(p, [](const GaussianSplats& in, int64_t i, GaussianRecord& record, SplatOutline& outline) {
    return project_gaussian_splat(in, i, record, outline) ? Sight::kSeen : Sight::kUnseen;
  });
}
