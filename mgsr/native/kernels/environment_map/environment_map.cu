// The environment map on the GPU.
//
// environment_map_forward: one thread per pixel. A pixel has one sample, or several.
// environment_map_backward: one thread per sample. It writes the gradient of the normal. For each map it also writes the
// cell of four texels that the sample reads, and the sample's place in it. A stable sort in torch then orders the
// samples by cell.
// environment_map_cells: a warp sums the gradients of one cell's corners over its samples. Each lane takes every 32nd
// sample, then the lanes are added in a fixed tree.
// environment_map_texels: a thread sums one channel of a texel over its four cells.
// There are no atomics, so every run gives the same bytes.
#include "kernels/common/cuda.h"
#include "math/environment_map.h"

namespace mgsr {

constexpr int kEnvironmentMapThreads = 128;
constexpr int kCellFields = 12;  // corners, channels

struct EnvironmentMapParams {
  int64_t count;           // number of pixels to process
  const int64_t* pixels;   // [count] row * width + column, each once; or null for all
  int width, side;         // the width of the image; texels along a side of a map
  int samples;             // rows and columns of samples in a pixel; 0: one at its centre, of weight 1
  const float* maps;       // [2, side, side, 3]: the scene's, the camera's
  const float* normals;    // world; [height * width, 3], or [count, samples, samples, 3] as long as weights
  float cam_from_world[9]; // rotation, row-major
  float fx, fy, cx, cy;
  float* light;            // [height * width, 3]; forward writes the chosen pixels
  const float* v_light;    // [height * width, 3]
  float* v_normals;        // [height * width, 3]; backward writes the chosen pixels; or null; not of samples
  int* cells;              // [2, all samples] the upper left texel of each sample's cell, per map; or null
  float2* places;          // [2, all samples] the place in the cell, 0..1; null if cells is
  float* weights;          // [all samples]; null if cells is
};

struct CellParams {
  int64_t count;          // number of all samples
  int side, per_pixel;    // texels along a side of a map; number of a pixel's samples
  const int64_t* pixels;  // as in EnvironmentMapParams
  const float* v_light;
  const float* weights;   // [count]
  const float2* places;
  const int* cells;       // [2 * count] sorted
  const int64_t* slots;   // [2 * count] the index of each before sorting
  float* sums;            // [2, side, side, kCellFields]
};

struct TexelParams {
  int side;
  const float* sums;  // as in CellParams
  float* v_maps;      // [2, side, side, 3]
};

__device__ inline int64_t environment_map_pixel(const int64_t* pixels, int64_t i) { return pixels ? pixels[i] : i; }

__device__ inline int64_t samples_of_pixel(const EnvironmentMapParams& p) {
  return p.samples ? int64_t(p.samples) * p.samples : 1;
}

// A sample: its pixel, its weight, and the reflected line of sight.
struct Sample {
  __device__ Sample(const EnvironmentMapParams& p, int64_t i) {
    const int64_t at = i / samples_of_pixel(p);
    const int rows = p.samples ? p.samples : 1, sub = int(i % samples_of_pixel(p));
    pixel = environment_map_pixel(p.pixels, at);
    const float* normal = p.normals + 3 * (p.samples ? i : pixel);
    const float column = float(pixel % p.width) + (float(sub % rows) + 0.5f) / float(rows);
    const float row = float(pixel / p.width) + (float(sub / rows) + 0.5f) / float(rows);
    const float ray[2] = {(column - p.cx) / p.fx, (row - p.cy) / p.fy};
    sight = reflect_sight(p.cam_from_world, ray, normal);
    weight = p.samples ? sqrtf(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]) : 1.0f;
  }

  int64_t pixel;
  float weight;
  EnvironmentMapSight<float> sight;
};

// The four texels around a place -1..1 on a map.
struct Cell {
  __device__ Cell(const EnvironmentMapParams& p, int which, const float place[2]) : side(p.side) {
    for (int k = 0; k < 2; ++k) texel[k] = texel_of(place[k], float(side));
    column = int(texel[0]), line = int(texel[1]);
    x = texel[0] - float(column), y = texel[1] - float(line);
    index = (which * side + line) * side + column;
  }
  __device__ Corners<float> load(const float* maps, int channel) const {
    const float* at = maps + 3 * int64_t(index) + channel;
    const int right = column + 1 < side ? 3 : 0, down = line + 1 < side ? 3 * side : 0;
    return {at[0], at[right], at[down], at[down + right]};
  }

  int side, column, line, index;
  float texel[2], x, y;
};

// Writes the gradient of a place -1..1, given that of the light [3].
__device__ inline void place_gradient(const EnvironmentMapParams& p, const Cell& cell, const float* v_light, float v_place[2]) {
  v_place[0] = v_place[1] = 0.0f;
  for (int channel = 0; channel < 3; ++channel) {
    float by_x, by_y;
    bilinear_slopes(cell.load(p.maps, channel), cell.x, cell.y, by_x, by_y);
    v_place[0] += by_x * v_light[channel], v_place[1] += by_y * v_light[channel];
  }
  for (int k = 0; k < 2; ++k) v_place[k] *= texel_slope(cell.texel[k], float(p.side));
}

// Returns the index of the first of `count` sorted numbers that is not less than `least`.
__device__ inline int64_t lower_bound(const int* sorted, int64_t count, int least) {
  int64_t begin = 0;
  while (count > 0) {
    const int64_t half = count / 2;
    const bool less = sorted[begin + half] < least;
    begin = less ? begin + half + 1 : begin;
    count = less ? count - half - 1 : half;
  }
  return begin;
}

}  // namespace mgsr

MGSR_KERNEL(environment_map_forward, mgsr::EnvironmentMapParams, mgsr::kEnvironmentMapThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kEnvironmentMapThreads + threadIdx.x;
  if (i >= p.count) return;
  const int64_t first = i * samples_of_pixel(p), end = first + samples_of_pixel(p);
  float light[3] = {};
  for (int64_t at = first; at < end; ++at) {
    const Sample sample(p, at);
    const Cell still(p, 0, sample.sight.still.place), held(p, 1, sample.sight.held.place);
    for (int channel = 0; channel < 3; ++channel)
      light[channel] += sample.weight * (bilinear(still.load(p.maps, channel), still.x, still.y) +
                                         bilinear(held.load(p.maps, channel), held.x, held.y));
  }
  const int64_t pixel = environment_map_pixel(p.pixels, i);
  for (int channel = 0; channel < 3; ++channel) p.light[3 * pixel + channel] = light[channel];
}

MGSR_KERNEL(environment_map_backward, mgsr::EnvironmentMapParams, mgsr::kEnvironmentMapThreads) {
  using namespace mgsr;
  const int64_t i = int64_t(blockIdx.x) * kEnvironmentMapThreads + threadIdx.x, all = p.count * samples_of_pixel(p);
  if (i >= all) return;
  const Sample sample(p, i);
  const Cell still(p, 0, sample.sight.still.place), held(p, 1, sample.sight.held.place);
  if (p.cells) {
    p.cells[i] = still.index, p.places[i] = make_float2(still.x, still.y);
    p.cells[all + i] = held.index, p.places[all + i] = make_float2(held.x, held.y);
    p.weights[i] = sample.weight;
  }
  if (!p.v_normals) return;
  const float* v_light = p.v_light + 3 * sample.pixel;
  float v_still[2], v_held[2], v_normal[3];
  place_gradient(p, still, v_light, v_still);
  place_gradient(p, held, v_light, v_held);
  reflect_sight_vjp(p.cam_from_world, sample.sight, v_still, v_held, v_normal);
  for (int k = 0; k < 3; ++k) p.v_normals[3 * sample.pixel + k] = v_normal[k];
}

MGSR_KERNEL(environment_map_cells, mgsr::CellParams, mgsr::kEnvironmentMapThreads) {
  using namespace mgsr;
  const int lane = threadIdx.x % kWarp, cell = (blockIdx.x * kEnvironmentMapThreads + threadIdx.x) / kWarp;
  if (cell >= 2 * p.side * p.side) return;  // the same for the whole warp
  const int64_t begin = lower_bound(p.cells, 2 * p.count, cell), end = lower_bound(p.cells, 2 * p.count, cell + 1);
  float sums[kCellFields] = {};
  for (int64_t i = begin + lane; i < end; i += kWarp) {
    const int64_t slot = p.slots[i], sample = slot < p.count ? slot : slot - p.count;
    const int64_t pixel = environment_map_pixel(p.pixels, sample / p.per_pixel);
    const float2 place = p.places[slot];
    for (int channel = 0; channel < 3; ++channel) {
      const float v_sample = p.weights[sample] * p.v_light[3 * pixel + channel];
      const Corners<float> v = bilinear_vjp(v_sample, place.x, place.y);
      sums[channel] += v.upper_left, sums[3 + channel] += v.upper_right;
      sums[6 + channel] += v.lower_left, sums[9 + channel] += v.lower_right;
    }
  }
  for (int by = kWarp / 2; by > 0; by /= 2)
    for (int k = 0; k < kCellFields; ++k) sums[k] += __shfl_xor_sync(kFullWarp, sums[k], by);
  for (int k = 0; k < kCellFields; ++k)  // each lane writes its own field; a loop, as registers can't be indexed
    if (lane == k) p.sums[int64_t(cell) * kCellFields + k] = sums[k];
}

MGSR_KERNEL(environment_map_texels, mgsr::TexelParams, mgsr::kEnvironmentMapThreads) {
  using namespace mgsr;
  const int i = blockIdx.x * kEnvironmentMapThreads + threadIdx.x, texel = i / 3, side = p.side;
  if (texel >= 2 * side * side) return;
  const int column = texel % side, line = texel / side % side;
  const float* at = p.sums + int64_t(texel) * kCellFields + i % 3;
  float sum = at[0];
  if (column > 0) sum += at[3 - kCellFields];
  if (line > 0) sum += at[6 - kCellFields * side];
  if (column > 0 && line > 0) sum += at[9 - kCellFields * (side + 1)];
  p.v_maps[i] = sum;
}
