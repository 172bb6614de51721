// The normals of a depth map, and their gradient. A task is a band of rows. Backward gathers instead of scattering. For
// three rows it keeps the derivatives of the normals with respect to their left, right, upper and lower depths. The
// gradient of a depth is the sum of the four derivatives with respect to it. Both adjacent bands compute the rows just
// outside them, so tasks share nothing.
#pragma once

#include <algorithm>
#include <vector>

#include "kernels/common/parallel.h"
#include "kernels/image/image.h"
#include "kernels/image/rows.h"
#include "math/depth_normal.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kNormalBandRows = 32;

// The camera's numbers as locals of a row's loop. Read through the parameters, they would be loaded again at each
// pixel.
struct RowCamera {
  RowCamera(const DepthNormalsParams& p, int y)
      : fx(p.fx), fy(p.fy), per_pixel(1 / p.fx), offset((0.5f - p.cx) / p.fx), ry((float(y) + 0.5f - p.cy) / p.fy) {
    std::copy_n(p.world_from_cam, 9, R);
  }
  PixelRay<float> ray(int x) const { return {fx, fy, float(x) * per_pixel + offset, ry}; }

  float fx, fy, per_pixel, offset, ry, R[9];
};

// Writes the depths around (x, y), or 1 for all of them if one of them or the pixel's own is not a valid depth. Returns
// whether all are valid.
inline bool neighbours(const float* row, int width, int x, DepthNeighbours<float>& d) {
  d = {row[x - 1], row[x + 1], row[x - width], row[x + width]};
  const bool valid = (row[x] > 0) & (d.left > 0) & (d.right > 0) & (d.up > 0) & (d.down > 0);
  d.left = valid ? d.left : 1, d.right = valid ? d.right : 1, d.up = valid ? d.up : 1, d.down = valid ? d.down : 1;
  return valid;
}

void normals_row(const DepthNormalsParams& p, int y) {
  float* out = p.normals + int64_t(y) * p.width * 3;
  std::fill_n(out, 3 * p.width, 0.0f);
  if (y == 0 || y == p.height - 1) return;
  const float *row = p.depth + int64_t(y) * p.width, *alpha = p.alpha ? p.alpha + int64_t(y) * p.width : nullptr;
  const RowCamera camera(p, y);
  const float* R = camera.R;
#pragma GCC ivdep
  for (int x = 1; x < p.width - 1; ++x) {
    DepthNeighbours<float> d;
    float n[3];
    const bool valid = neighbours(row, p.width, x, d);
    depth_normal(d, camera.ray(x), n);
    const float scale = !valid ? 0.0f : alpha ? alpha[x] : 1.0f;
    for (int i = 0; i < 3; ++i) out[3 * x + i] = scale * (R[3 * i] * n[0] + R[3 * i + 1] * n[1] + R[3 * i + 2] * n[2]);
  }
}

// The derivatives with respect to the neighbours of one row's pixels: four rows of `width`.
struct NeighbourRows {
  float *left, *right, *up, *down;
};

void derivative_row(const DepthNormalsParams& p, int y, const NeighbourRows& v) {
  std::fill_n(v.left, 4 * p.width, 0.0f);
  if (y <= 0 || y >= p.height - 1) return;
  const float *row = p.depth + int64_t(y) * p.width, *alpha = p.alpha ? p.alpha + int64_t(y) * p.width : nullptr;
  const float* v_normals = p.v_normals + int64_t(y) * p.width * 3;
  const RowCamera camera(p, y);
  const float* R = camera.R;
#pragma GCC ivdep
  for (int x = 1; x < p.width - 1; ++x) {
    DepthNeighbours<float> d;
    const bool valid = neighbours(row, p.width, x, d);
    const float* g = v_normals + 3 * x;
    const float scale = !valid ? 0.0f : alpha ? alpha[x] : 1.0f;
    const float v_n[3] = {scale * (R[0] * g[0] + R[3] * g[1] + R[6] * g[2]),
                          scale * (R[1] * g[0] + R[4] * g[1] + R[7] * g[2]),
                          scale * (R[2] * g[0] + R[5] * g[1] + R[8] * g[2])};
    const DepthNeighbours<float> v_d = depth_normal_vjp(d, camera.ray(x), v_n);
    v.left[x] = v_d.left, v.right[x] = v_d.right, v.up[x] = v_d.up, v.down[x] = v_d.down;
  }
}

void v_depth_band(const DepthNormalsParams& p, int y0, int y1) {
  static thread_local std::vector<float> scratch;
  const size_t w = size_t(p.width);
  if (scratch.size() < 12 * w) scratch.resize(12 * w);
  NeighbourRows rows[3];
  for (int i = 0; i < 3; ++i) {
    float* at = scratch.data() + 4 * w * size_t(i);
    rows[i] = {at, at + w, at + 2 * w, at + 3 * w};
  }
  derivative_row(p, y0 - 1, rows[0]);
  derivative_row(p, y0, rows[1]);
  for (int y = y0; y < y1; ++y) {
    const NeighbourRows &above = rows[(y - y0) % 3], &here = rows[(y - y0 + 1) % 3], &below = rows[(y - y0 + 2) % 3];
    derivative_row(p, y + 1, below);
    float* out = p.v_depth + int64_t(y) * p.width;
    for (int x = 0; x < p.width; ++x) {
      const float from_left = x > 0 ? here.right[x - 1] : 0.0f, from_right = x + 1 < p.width ? here.left[x + 1] : 0.0f;
      out[x] = (from_left + from_right) + (above.down[x] + below.up[x]);
    }
  }
}

void depth_normals(const DepthNormalsParams& p) {
  parallel_chunks(p.height, kNormalBandRows, [&](int64_t begin, int64_t end) {
    for (int64_t y = begin; y < end; ++y) normals_row(p, int(y));
  });
}

void depth_normals_vjp(const DepthNormalsParams& p) {
  parallel_chunks(p.height, kNormalBandRows, [&](int64_t begin, int64_t end) { v_depth_band(p, int(begin), int(end)); });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
