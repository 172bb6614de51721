// Depth fusion on the CPU: depth maps vote on the distances of points, and a field of distances is fitted to the votes
// under total variation (Zach, 2008).
#pragma once

#include <cstdint>
#include <vector>

namespace mgsr {

// A depth map (camera z) and the weight of each pixel [height * width], with its pinhole camera: OpenCV axes, pixel
// centres at +0.5. The pose maps the world to the camera, and its rotation is row-major.
struct VotingView {
  int width = 0, height = 0;
  const float *depth = nullptr, *weights = nullptr;
  double fx = 1, fy = 1, cx = 0, cy = 0;
  double rotation[9] = {}, translation[3] = {};
};

struct VotingParams {
  std::vector<VotingView> views;
  int64_t count = 0;                // number of points
  const double* points = nullptr;   // [count, 3] world
  double reach = 1;                 // the distance to a map's surface at the end of the histogram
  float solid_weight = 0;           // share of a map's weight for points farther than `reach` behind its surface
  float solid_depth = 1;            // in units of reach; points this far behind the surface get no vote
  int bins = 0;                     // number of bins, which divide -1..1 evenly; positive is behind the surface
  float* votes = nullptr;           // [count, bins] overwritten
};

struct FusionParams {
  int64_t shape[3] = {};            // of the grid: voxels along x, y, z
  int64_t count = 0;                // voxels whose values are sought
  const int64_t* voxels = nullptr;  // [count] (x * shape[1] + y) * shape[2] + z, each once
  int bins = 0;                     // number of bins, which divide -1..1 evenly
  const float* votes = nullptr;     // [count, bins] weights of the bins' distances, not negative
  const float* most = nullptr;      // [x, y, z] upper limits of the field, -1 or more
  float strength = 0;               // weight of the total variation relative to the votes
  int rounds = 0;
  float* field = nullptr;           // [x, y, z] -1..1; the start, overwritten at `voxels`
};

struct FusionTable {
  void (*vote)(const VotingParams&);
  void (*regularise)(const FusionParams&);
};

namespace avx512 { extern const FusionTable fusion_table; }
namespace avx2 { extern const FusionTable fusion_table; }
namespace baseline { extern const FusionTable fusion_table; }

}  // namespace mgsr
