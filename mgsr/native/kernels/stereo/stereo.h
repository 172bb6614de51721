// The stereo family on the CPU: PatchMatch stereo of one photograph with its neighbours, and the score of a given
// surface.
#pragma once

#include <cstdint>
#include <vector>

namespace mgsr {

// A photograph: pixels [height * width, 4], which are sRGB 0..1 and the share of the pixel that shows the object. Its
// pinhole camera has OpenCV axes and pixel centres at +0.5. The pose maps the world to the camera, and its rotation is
// row-major.
struct StereoView {
  int width = 0, height = 0;
  const float* pixels = nullptr;
  float fx = 1, fy = 1, cx = 0, cy = 0;
  float rotation[9] = {}, translation[3] = {};
};

struct StereoSettings {
  int radius = 2;            // samples of a patch on each side of its middle
  float spacing = 1.25f;     // pixels between samples
  float noise = 0.012f;      // standard deviation, sRGB; patches of less contrast correlate with nothing
  float alike = 0.3f;        // sRGB difference from the middle's colour at which the weight is 0.6
  float reach = 4;           // pixels from the middle at which the weight is 0.6
  int best = 3;              // the number of best agreeing neighbours whose mean correlation is the score
  float cover = 0.6f;        // the least share of a patch that must show the object in a neighbour
  float prior = 0.1f;        // the score that a depth loses if it differs from the start by `prior_reach` or more
  float prior_reach = 3.5f;  // pixels, on the surface
  float search = 7;          // pixels, the variation of depths in the first round
  int rounds = 3;            // number of rounds of propagation and refinement
};

struct StereoParams {
  StereoView view;
  std::vector<StereoView> neighbours;
  StereoSettings settings;
  const float* start_depth = nullptr;   // [height * width] camera z, 0 where it is unknown
  const float* start_normal = nullptr;  // [height * width, 3] camera axes
  float nearest = 0, farthest = 0;      // camera z, the range of the search
  uint32_t seed = 0;
  float* depth = nullptr;   // [height * width] camera z, 0 where nothing is found; only search writes it
  float* normal = nullptr;  // [height * width, 3] unit, camera axes, towards the camera; only search writes it
  float* score = nullptr;   // [height * width] -1..1, -1 where nothing is found
};

struct StereoTable {
  void (*search)(const StereoParams&);
  void (*judge)(const StereoParams&);
};

namespace avx512 { extern const StereoTable stereo_table; }
namespace avx2 { extern const StereoTable stereo_table; }
namespace baseline { extern const StereoTable stereo_table; }

}  // namespace mgsr
