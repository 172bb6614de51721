// The projection of the 2D branch's surfels to the image, and the gradients of the parameters, given the sums over the
// tiles.
// One thread per splat.
#pragma once

#include "kernels/common/tiles_cuda.h"
#include "kernels/surfels/precise.h"
#include "math/surfel_bounds.h"

namespace mgsr {

constexpr int kSplatThreads = 128;

// The 2D branch's parameters and the view of them.
struct SurfelSplats {
  int64_t count;
  const float *means, *quats, *scales;  // [N,3], [N,4] wxyz, [N,2]
  const float *opacities, *colors;      // [N], [N,3]
  Camera<float> camera;
  int width, height;
  float near, far, low_pass;            // camera units; far only sets the unit of distortion; px^2
};

struct SurfelProjectParams {
  SurfelSplats in;
  SurfelRecord* records;    // [N], set only for visible splats
  SplatOutline* outlines;   // [N], likewise
  float* depths;            // [N] of the centres, kCulledDepth for culled splats
  int* tile_counts;         // [N]
  float* radii;             // [N] pixels, 0 for culled splats
};

struct SurfelGradientParams {
  SurfelSplats in;
  const SurfelRecord* records;
  const float* sums;        // [N, kPairFields], set only for splats that touch a tile
  const int* tile_counts;
  float *means, *quats, *scales, *opacities, *colors, *means2d;  // outputs
};

// Fills the record and the outline of a splat. Returns false if it is invisible or not finite.
__device__ inline bool project_surfel_splat(const SurfelSplats& in, int64_t i, SurfelRecord& record, SplatOutline& outline) {
  const float opacity = in.opacities[i], *scale = in.scales + 2 * i;
  SurfelFrame<float> f;
  surfel_frame(in.camera, in.means + 3 * i, in.quats + 4 * i, scale, f);
  if (!(f.p[2] > in.near) || !(opacity >= kMinAlpha) || !(scale[0] > 0) || !(scale[1] > 0)) return false;
  ProjectedSurfel<float> s = project_surfel(in.camera, f);
  if (is_needle(s.L)) s = project_needle(in.camera, in.means + 3 * i, in.quats + 4 * i, scale, f.edge_on);
  record = surfel_record(s, f.edge_on, opacity);
  for (int k = 0; k < 3; ++k) record.color[k] = in.colors[3 * i + k];
  if (!finite(&record.x, 2) || !finite(record.L, 4) || !finite(record.g, 2) || !finite(&record.signed_depth, 2) ||
      !finite(record.color, 3) || !finite(record.normal, 3) || !finite(scale, 2))
    return false;
  const SurfelImage image = {in.near, in.low_pass, float(in.width), float(in.height)};
  const SurfelBounds b = surfel_bounds(in.camera, image, f, s, scale, opacity);
  if (b.radius > 0 || b.clipped || record.needle()) record.signed_depth = -s.depth;
  outline.ellipse = b.disk, outline.x = b.x, outline.y = b.y, outline.radius = b.radius, outline.unused = 0.0f;
  return true;
}

__device__ inline void surfel_splat_gradients(const SurfelGradientParams& p, int64_t i) {
  const SurfelSplats& in = p.in;
  SurfelGeometryGradients g = {};
  float color[3] = {}, opacity = 0.0f;
  if (p.tile_counts[i] > 0) {
    const float *mean = in.means + 3 * i, *quat = in.quats + 4 * i, *scale = in.scales + 2 * i;
    const SurfelRecord& s = p.records[i];
    float total[kPairFields];
    for (int k = 0; k < kPairFields; ++k) total[k] = p.sums[i * kPairFields + k];
    g = s.plain() ? surfel_geometry_gradients(in.camera, mean, quat, scale, s, total)
                  : surfel_geometry_gradients(camera_as<double>(in.camera), mean, quat, scale, s, total);
    for (int k = 0; k < 3; ++k) color[k] = total[kColor + k];
    opacity = total[kOpacity] / in.opacities[i];
  }
  for (int k = 0; k < 3; ++k) p.means[3 * i + k] = g.mean[k], p.colors[3 * i + k] = color[k];
  for (int k = 0; k < 4; ++k) p.quats[4 * i + k] = g.quat[k];
  for (int k = 0; k < 2; ++k) p.scales[2 * i + k] = g.scale[k], p.means2d[2 * i + k] = g.center[k];
  p.opacities[i] = opacity;
}

}  // namespace mgsr
