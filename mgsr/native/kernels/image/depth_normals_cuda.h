// The normals of a depth map, and their gradient. A thread is a pixel. Backward gathers: the gradient of a depth is the
// sum of the contributions of the normals at its four neighbours.
#pragma once

#include "kernels/common/sums_cuda.h"
#include "math/depth_normal.h"

namespace mgsr {

struct DepthNormalsParams {
  int height, width;
  const float* depth;        // [height, width]
  const float* alpha;        // [height, width], or null for 1 everywhere
  const float* covered;      // [height, width], multiplies alpha; or null for 1 everywhere
  float fx, fy, cx, cy;
  float world_from_cam[9];   // rotation, row-major
  float* normals;            // [height, width, 3], written by forward
  const float* v_normals;
  float* v_depth;            // [height, width], overwritten by backward
};

// The mean over the covered pixels of 1 - n . n_depth. The kernel writes the sums and the normals of the depth, whose
// length is alpha times covered. If v_depth is given, it also writes the gradient of the depth for v_normals = n.
struct AgreementParams {
  DepthNormalsParams of_depth;
  const float* normal;  // [height, width, 3]
  PartialSums* sums;    // [blocks]
};

// Writes the depths around a pixel. Returns false at the image's border, and if one of them or its own is not valid.
__device__ inline bool neighbours(const DepthNormalsParams& p, int x, int y, DepthNeighbours<float>& d) {
  if (x < 1 || y < 1 || x >= p.width - 1 || y >= p.height - 1) return false;
  const float* at = p.depth + int64_t(y) * p.width + x;
  d = {at[-1], at[1], at[-p.width], at[p.width]};
  return at[0] > 0 && d.left > 0 && d.right > 0 && d.up > 0 && d.down > 0;
}

__device__ inline PixelRay<float> pixel_ray(const DepthNormalsParams& p, int x, int y) {
  return {p.fx, p.fy, (float(x) + 0.5f - p.cx) / p.fx, (float(y) + 0.5f - p.cy) / p.fy};
}

__device__ inline float normal_length(const DepthNormalsParams& p, int64_t i) {
  return (p.alpha ? p.alpha[i] : 1.0f) * (p.covered ? p.covered[i] : 1.0f);
}

__device__ inline void write_normal(const DepthNormalsParams& p, int x, int y) {
  const int64_t i = int64_t(y) * p.width + x;
  const float* R = p.world_from_cam;
  DepthNeighbours<float> d;
  float n[3] = {}, scale = 0.0f;
  if (neighbours(p, x, y, d)) {
    depth_normal(d, pixel_ray(p, x, y), n);
    scale = normal_length(p, i);
  }
  for (int k = 0; k < 3; ++k) p.normals[3 * i + k] = scale * (R[3 * k] * n[0] + R[3 * k + 1] * n[1] + R[3 * k + 2] * n[2]);
}

// Returns the contribution of a pixel's normal to the gradients of its neighbours' depths; zero if it has no normal.
__device__ inline DepthNeighbours<float> neighbour_gradients(const DepthNormalsParams& p, int x, int y) {
  DepthNeighbours<float> d;
  if (!neighbours(p, x, y, d)) return {0.0f, 0.0f, 0.0f, 0.0f};
  const int64_t i = int64_t(y) * p.width + x;
  const float *R = p.world_from_cam, *g = p.v_normals + 3 * i, scale = normal_length(p, i);
  const float v_n[3] = {scale * (R[0] * g[0] + R[3] * g[1] + R[6] * g[2]), scale * (R[1] * g[0] + R[4] * g[1] + R[7] * g[2]),
                        scale * (R[2] * g[0] + R[5] * g[1] + R[8] * g[2])};
  return depth_normal_vjp(d, pixel_ray(p, x, y), v_n);
}

__device__ inline void write_depth_gradient(const DepthNormalsParams& p, int x, int y) {
  const float across = neighbour_gradients(p, x - 1, y).right + neighbour_gradients(p, x + 1, y).left;
  const float upright = neighbour_gradients(p, x, y - 1).down + neighbour_gradients(p, x, y + 1).up;
  p.v_depth[int64_t(y) * p.width + x] = across + upright;
}

__device__ inline void normal_agreement(const AgreementParams& p) {
  const int64_t i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  const DepthNormalsParams& d = p.of_depth;
  double total = 0.0, count = 0.0;
  if (i < int64_t(d.height) * d.width) {
    write_normal(d, int(i % d.width), int(i / d.width));
    if (d.v_depth) write_depth_gradient(d, int(i % d.width), int(i / d.width));
    float agreement = 0.0f;
    for (int k = 0; k < 3; ++k) agreement += p.normal[3 * i + k] * d.normals[3 * i + k];
    count = d.covered ? d.covered[i] : 1.0f;
    total = count - double(agreement);
  }
  write_block_sums(total, count, &p.sums[blockIdx.x]);
}

}  // namespace mgsr
