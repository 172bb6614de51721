// The interface of the image kernels on the CPU. Images are [height, width, channels], interleaved.
#pragma once

#include <cstdint>

namespace mgsr {

struct ImageLossParams {
  int height = 0, width = 0;
  const float* image = nullptr;   // [height, width, 3]
  const float* target = nullptr;  // [height, width, 3]
  const float* mask = nullptr;    // [height, width] weights, or null for 1 everywhere
  float l1_weight = 0;
  bool clip = false;              // whether image values above 1 count as 1, without gradient
  float* v_image = nullptr;       // [height, width, 3], or null
  float* v_target = nullptr;      // the same; requires v_image
};

// Sums over the image; the loss is total / weight, and the gradients are those of total.
struct ImageLossSums {
  double total = 0, weight = 0;
};

struct TvParams {
  int height = 0, width = 0, channels = 1;
  const float* values = nullptr;  // [height, width, channels]
  const float* guide = nullptr;   // [height, width, 3]
  const float* mask = nullptr;    // [height, width] weights, or null
  float* v_values = nullptr;      // [height, width, channels], of the sum; or null
};

struct TvSums {
  double total = 0, pairs = 0;
};

struct DepthNormalsParams {
  int height = 0, width = 0;
  const float* depth = nullptr;  // [height, width]
  const float* alpha = nullptr;  // [height, width], or null for 1 everywhere
  float fx = 1, fy = 1, cx = 0, cy = 0;
  float world_from_cam[9] = {};  // rotation, row-major
  float* normals = nullptr;      // [height, width, 3], written by forward
  const float* v_normals = nullptr;
  float* v_depth = nullptr;      // [height, width], overwritten by backward
};

struct ImageTable {
  ImageLossSums (*loss)(const ImageLossParams&);
  TvSums (*tv)(const TvParams&);
  void (*depth_normals)(const DepthNormalsParams&);
  void (*depth_normals_vjp)(const DepthNormalsParams&);
};

namespace avx512 { extern const ImageTable image_table; }
namespace avx2 { extern const ImageTable image_table; }
namespace baseline { extern const ImageTable image_table; }

}  // namespace mgsr
