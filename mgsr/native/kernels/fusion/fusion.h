// The fusion family: what depth maps vote on places, and a field of distances that agrees with each voxel's votes and
// varies little in all.
#pragma once

#include <cstdint>
#include <vector>

namespace mgsr {

// A depth map, camera z, and the weight of each pixel [height * width]; its pinhole camera with OpenCV axes and pixel
// centres at +0.5, and its pose, world to camera, the rotation row-major.
struct VotingView {
  int width = 0, height = 0;
  const float *depth = nullptr, *weights = nullptr;
  double fx = 1, fy = 1, cx = 0, cy = 0;
  double rotation[9] = {}, translation[3] = {};
};

struct VotingParams {
  std::vector<VotingView> views;
  int64_t count = 0;                // of the points
  const double* points = nullptr;   // [count, 3] world
  double reach = 1;                 // distance to a map's surface that is the end of the histogram
  float solid_weight = 0;           // share of its weight with which a map votes on what lies farther behind
  float solid_depth = 1;            // of reach; what lies as far behind is not voted on
  int bins = 0;                     // of the histograms; they part -1..1 evenly, positive is behind the surface
  float* votes = nullptr;           // [count, bins] overwritten
};

struct FusionParams {
  int64_t shape[3] = {};            // of the grid: voxels along x, y, z
  int64_t count = 0;                // voxels whose values are sought
  const int64_t* voxels = nullptr;  // [count] (x * shape[1] + y) * shape[2] + z, each once
  int bins = 0;                     // of the histograms; they part -1..1 evenly
  const float* votes = nullptr;     // [count, bins] weights of the distances in each bin, not negative
  const float* most = nullptr;      // [x, y, z] what the field may be at most, -1 or more
  float strength = 0;               // of the total variation against the votes
  int rounds = 0;
  float* field = nullptr;           // [x, y, z] -1..1; read as the start, and written for the voxels sought
};

struct FusionTable {
  void (*vote)(const VotingParams&);
  void (*regularise)(const FusionParams&);
};

namespace avx512 { extern const FusionTable fusion_table; }
namespace avx2 { extern const FusionTable fusion_table; }
namespace baseline { extern const FusionTable fusion_table; }

}  // namespace mgsr
