// The interface of the 3D branch on the CPU: inputs, outputs, and the state that the backward pass needs.
#pragma once

#include <vector>

#include "kernels/common/binning.h"
#include "kernels/common/depth_sort.h"
#include "kernels/gaussians/record.h"
#include "math/camera.h"

namespace mgsr {

struct GaussianInputs {
  int64_t count;
  const float *means, *quats, *scales;         // [N,3], [N,4] wxyz, [N,3]
  const float *opacities, *colors;             // [N], [N,3]: the transmitted part
  const float *refl_opacities, *refl_colors;   // [N], [N,3]: the reflected part, or null for single opacity
  const float* weights;                        // [N]: the reflection weight beta, or null
  const float* background;                     // [3], behind the transmitted part
  Camera<float> camera;
  int width, height;
  float near, low_pass;                        // camera units; px^2
  bool compensate;                             // whether to undo the energy that the low-pass adds
  bool depth;                                  // whether depth is requested
};

struct GaussianImages {
  float *color, *alpha;       // [H,W,3] transmitted with background, [H,W] 1 - transmittance
  float* depth;               // [H,W] mean camera depth, 0 without splats; null if not requested
  float *reflected, *weight;  // [H,W,3], [H,W]; null for single opacity
};

struct GaussianGradients {
  float *means, *quats, *scales, *opacities, *colors, *refl_opacities, *refl_colors, *weights;  // as in GaussianInputs
  float* means2d;  // [N,2] pixels: gradient of the loss to each splat's projected centre
};

// The state between forward and backward. Its vectors keep their memory when it is reused.
struct GaussianState {
  std::vector<GaussianRecord> records;   // [N], set only for visible splats
  std::vector<float> depths;           // [N] of the centres, -1 for culled splats
  DepthSort sort;
  TileLists lists;
  std::vector<float> transmittance;    // [H,W], final
  std::vector<float> pair_gradients;   // [pairs, 16]
};

struct GaussianKernels {
  // radii: [N] pixels, 0 for culled splats.
  void (*forward)(const GaussianInputs&, GaussianState&, const GaussianImages&, float* radii);
  // images: the outputs of the forward pass. A null gradient image means zero. Only gradients of visible splats are
  // written; the caller zeroes them first.
  void (*backward)(const GaussianInputs&, GaussianState&, const GaussianImages& images, const GaussianImages& v_images,
                   const GaussianGradients&);
};

namespace baseline { extern const GaussianKernels gaussian_kernels; }
namespace avx2 { extern const GaussianKernels gaussian_kernels; }
namespace avx512 { extern const GaussianKernels gaussian_kernels; }

}  // namespace mgsr
