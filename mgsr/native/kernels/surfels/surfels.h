// The interface of the 2D branch on the CPU: inputs, outputs, and the state that the backward pass needs.
#pragma once

#include <vector>

#include "kernels/common/binning.h"
#include "kernels/common/depth_sort.h"
#include "kernels/surfels/record.h"
#include "math/camera.h"

namespace mgsr {

struct SurfelInputs {
  int64_t count;
  const float *means, *quats, *scales;  // [N,3], [N,4] wxyz, [N,2]
  const float *opacities, *colors;      // [N], [N,3]
  const float* background;              // [3]
  Camera<float> camera;
  int width, height;
  float low_pass;                       // px^2, variance of the low-pass around the projected centre
  float near, far;                      // camera units; far only sets the unit of distortion
};

struct SurfelImages {
  float *color, *alpha;         // [H,W,3] with background, [H,W] 1 - transmittance
  float *depth, *median_depth;  // [H,W] mean camera depth; depth at which transmittance falls below 1/2; else 0
  float* normal;                // [H,W,3] world frame, sum of alpha T n
  float* distortion;            // [H,W], or null if not requested
};

struct SurfelGradients {
  float *means, *quats, *scales, *opacities, *colors;  // as in SurfelInputs
  float* means2d;  // [N,2] pixels: gradient of the loss to a shift of each splat in the image plane
};

// The state between forward and backward. Its vectors keep their memory when it is reused.
struct SurfelState {
  std::vector<SurfelRecord> records;  // [N], set only for visible splats
  std::vector<float> depths;          // [N] of the centres, -1 for culled splats
  DepthSort sort;
  TileLists lists;
  std::vector<float> transmittance;   // [H,W], final
  std::vector<float> moments;         // [H,W,2] of depth, for distortion
  std::vector<float> pair_gradients;  // [pairs, 16]
};

struct SurfelKernels {
  // radii: [N] pixels, 0 for culled splats.
  void (*forward)(const SurfelInputs&, SurfelState&, const SurfelImages&, float* radii);
  // images: the outputs of the forward pass. A null gradient image means zero. Only gradients of visible splats are
  // written; the caller zeroes them first.
  void (*backward)(const SurfelInputs&, SurfelState&, const SurfelImages& images, const SurfelImages& v_images,
                   const SurfelGradients&);
};

namespace baseline { extern const SurfelKernels surfel_kernels; }
namespace avx2 { extern const SurfelKernels surfel_kernels; }
namespace avx512 { extern const SurfelKernels surfel_kernels; }

}  // namespace mgsr
