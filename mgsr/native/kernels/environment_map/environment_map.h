// The interface of the environment map's kernels on the CPU.
#pragma once

#include <cstdint>

namespace mgsr {

struct EnvironmentMapParams {
  int64_t count = 0;                // number of pixels to process
  const int64_t* pixels = nullptr;  // [count] row * width + column, each once; or null for all
  int width = 0, side = 0;          // the width of the image; texels along a side of a map
  int samples = 0;                  // rows and columns of samples in a pixel; 0: one at its centre, of weight 1
  const float* maps = nullptr;      // [2, side, side, 3]: the scene's, the camera's
  const float* normals = nullptr;   // world; [height * width, 3], or [count, samples, samples, 3] as long as weights
  float cam_from_world[9] = {};     // rotation, row-major
  float fx = 1, fy = 1, cx = 0, cy = 0;
  float* light = nullptr;           // [height * width, 3]; forward writes the chosen pixels
  const float* v_light = nullptr;   // [height * width, 3]
  float* v_maps = nullptr;          // [2, side, side, 3], overwritten by backward; or null
  float* v_normals = nullptr;       // [height * width, 3]; backward writes the chosen pixels; or null; not of samples
};

struct EnvironmentMapTable {
  void (*forward)(const EnvironmentMapParams&);
  void (*backward)(const EnvironmentMapParams&);
};

namespace avx512 { extern const EnvironmentMapTable environment_map_table; }
namespace avx2 { extern const EnvironmentMapTable environment_map_table; }
namespace baseline { extern const EnvironmentMapTable environment_map_table; }

}  // namespace mgsr
