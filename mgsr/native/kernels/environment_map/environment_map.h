// The environment map's family: what its kernels read and write.
#pragma once

#include <cstdint>

namespace mgsr {

struct EnvironmentMapParams {
  int64_t count = 0;                // pixels that are looked at
  const int64_t* pixels = nullptr;  // [count] row * width + column, each once; or null for all
  int width = 0, side = 0;          // of the image; texels along a map's side
  const float* maps = nullptr;      // [2, side, side, 3]: the scene's, the camera's
  const float* normals = nullptr;   // [height * width, 3], world
  float cam_from_world[9] = {};     // rotation, row-major
  float fx = 1, fy = 1, cx = 0, cy = 0;
  float* light = nullptr;           // [height * width, 3], written by forward where it looks
  const float* v_light = nullptr;   // [height * width, 3]
  float* v_maps = nullptr;          // [2, side, side, 3], overwritten by backward; or null
  float* v_normals = nullptr;       // [height * width, 3], written by backward where it looks; or null
};

struct EnvironmentMapTable {
  void (*forward)(const EnvironmentMapParams&);
  void (*backward)(const EnvironmentMapParams&);
};

namespace avx512 { extern const EnvironmentMapTable environment_map_table; }
namespace avx2 { extern const EnvironmentMapTable environment_map_table; }
namespace baseline { extern const EnvironmentMapTable environment_map_table; }

}  // namespace mgsr
