// The fusion family: a field of distances that agrees with each voxel's votes and varies little in all.
#pragma once

#include <cstdint>

namespace mgsr {

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
  void (*regularise)(const FusionParams&);
};

namespace avx512 { extern const FusionTable fusion_table; }
namespace avx2 { extern const FusionTable fusion_table; }
namespace baseline { extern const FusionTable fusion_table; }

}  // namespace mgsr
