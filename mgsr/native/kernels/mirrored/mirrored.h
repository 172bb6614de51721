// How well tilted normals explain the light that a surface's points mirror from an environment map, on the CPU.
#pragma once

#include <cstdint>

namespace mgsr {

struct TiltParams {
  int64_t points = 0;
  int64_t views = 0;                        // observations of each point
  const float* view_directions = nullptr;   // [points, views, 3] unit, from the point to the camera
  const float* brightness = nullptr;        // [points, views] linear light
  const float* weights = nullptr;           // [points, views] 0 where a point is not visible
  const float* frames = nullptr;            // [points, 3, 3] rows of two tangents and the normal, unit
  int cells = 0;                            // along a side of the table
  const float* table = nullptr;             // [cells, cells, cells] light by direction, over the cube -1..1
  int64_t tilts = 0;
  const float* tangents = nullptr;          // [tilts] tangents of the angles along each tangent of a frame
  float outlier = 1;                        // residual at which an observation's cost is half its limit
  float* costs = nullptr;                   // [points, tilts, tilts] overwritten
};

struct MirroredTable {
  void (*tilt_costs)(const TiltParams&);
};

namespace avx512 { extern const MirroredTable mirrored_table; }
namespace avx2 { extern const MirroredTable mirrored_table; }
namespace baseline { extern const MirroredTable mirrored_table; }

}  // namespace mgsr
