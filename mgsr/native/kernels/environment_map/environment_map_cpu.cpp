// The environment map on the CPU. Samples, one or several in a pixel, are processed in blocks. To reflect the line of
// sight, each lane takes a sample. To read the maps, a vector takes the three channels of a texel. Backward cuts the
// samples into parts, whose number never depends on the threads. Each part adds to a map of its own, and these maps are
// added in order.
#include "kernels/environment_map/environment_map.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "kernels/common/lanes.h"
#include "kernels/common/parallel.h"
#include "math/environment_map.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kBlock = 64;                   // samples
constexpr int64_t kChunk = 16 * kBlock;      // pixels, in forward
constexpr int64_t kLeastPart = 32 * kBlock;  // samples, in backward; parts are larger if there would be over kMostParts
constexpr int64_t kMostParts = 16;

// The three channels of a texel, and a zero.
typedef float vtexel __attribute__((vector_size(16)));

inline vtexel load_texel(const float* p) {
  vtexel texel;
  std::memcpy(&texel, p, sizeof(texel));
  return texel;
}
inline void add_texel(float* p, vtexel by) {
  const vtexel sum = load_texel(p) + by;
  std::memcpy(p, &sum, sizeof(sum));
}
inline vtexel load_channels(const float* p) { return vtexel{p[0], p[1], p[2], 0.0f}; }

// Returns the sum of the lanes of each vector.
inline vtexel sums(vtexel a, vtexel b, vtexel c, vtexel d) {
  const vtexel ab = __builtin_shufflevector(a, b, 0, 4, 1, 5) + __builtin_shufflevector(a, b, 2, 6, 3, 7);
  const vtexel cd = __builtin_shufflevector(c, d, 0, 4, 1, 5) + __builtin_shufflevector(c, d, 2, 6, 3, 7);
  return __builtin_shufflevector(ab, cd, 0, 1, 4, 5) + __builtin_shufflevector(ab, cd, 2, 3, 6, 7);
}

// The layout of both maps, [2, stride, stride, 4], with one more texel at the right and below, so that every texel has
// all its neighbours.
struct PaddedMaps {
  explicit PaddedMaps(int side) : side(side), stride(side + 1), row(4 * size_t(stride)), map(row * size_t(stride)) {}
  size_t floats() const { return 2 * map; }
  size_t at(int which, int y, int x) const { return size_t(which) * map + size_t(y) * row + 4 * size_t(x); }

  int side, stride;
  size_t row, map;
};

// Returns the maps in that layout, with the border repeated. The memory is valid until this thread's next call.
const float* pad(const EnvironmentMapParams& p, const PaddedMaps& layout) {
  static thread_local std::vector<float> padded;
  padded.resize(layout.floats());
  for (int which = 0; which < 2; ++which)
    for (int y = 0; y < layout.stride; ++y) {
      const float* from = p.maps + 3 * int64_t(p.side) * (int64_t(which) * p.side + std::min(y, p.side - 1));
      float* to = padded.data() + layout.at(which, y, 0);
      for (int x = 0; x < layout.stride; ++x) {
        const vtexel texel = load_channels(from + 3 * std::min(x, p.side - 1));
        std::memcpy(to + 4 * x, &texel, sizeof(texel));
      }
    }
  return padded.data();
}

// The intermediate values of a block of samples. Coordinates are in texels: [map][x, y].
struct Block {
  int count;
  int64_t pixel[kBlock];
  float ray[2][kBlock], normal[3][kBlock];
  bool first[kBlock];    // whether it is its pixel's first sample; set only for samples with weights
  float weight[kBlock];  // likewise
  EnvironmentMapSight<Floats> sight[kBlock / kWidth];
  float texel[2][2][kBlock], v_texel[2][2][kBlock];
};

// Goes through consecutive samples, with divisions only at the beginning and at that of an image row.
// kWeighted: whether the normals are samples with weights, not one in each pixel.
template <bool kWeighted>
class Samples {
 public:
  Samples(const EnvironmentMapParams& p, int64_t first)
      : p_(p), rows_(kWeighted ? p.samples : 1), at_(first / (rows_ * rows_)),
        row_(int(first % (rows_ * rows_)) / rows_), column_(int(first % rows_)), per_x_(1 / p.fx), per_y_(1 / p.fy),
        left_((0.5f / float(rows_) - p.cx) / p.fx), top_((0.5f / float(rows_) - p.cy) / p.fy),
        step_x_(per_x_ / float(rows_)), step_y_(per_y_ / float(rows_)) {
    find_pixel();
  }

  // Writes the sample to the block's lane i and goes on to the next one.
  void write(Block& b, int i) {
    b.pixel[i] = pixel_, b.ray[0][i] = x_, b.ray[1][i] = y_;
    if constexpr (kWeighted) {
      b.first[i] = row_ == 0 && column_ == 0;
      b.ray[0][i] += float(column_) * step_x_, b.ray[1][i] += float(row_) * step_y_;
    }
    const int64_t normal = kWeighted ? (at_ * rows_ + row_) * rows_ + column_ : pixel_;
    for (int c = 0; c < 3; ++c) b.normal[c][i] = p_.normals[3 * normal + c];
    if constexpr (kWeighted) {
      if (++column_ < rows_) return;
      column_ = 0;
      if (++row_ < rows_) return;
      row_ = 0;
    }
    if (++at_ < p_.count) find_pixel();
  }

 private:
  // Computes the ray through the pixel's first sample.
  void find_pixel() {
    pixel_ = p_.pixels ? p_.pixels[at_] : at_;
    if (pixel_ < begin_ || pixel_ >= begin_ + p_.width) {
      const int64_t row = pixel_ / p_.width;
      begin_ = row * p_.width, y_ = float(row) * per_y_ + top_;
    }
    x_ = float(pixel_ - begin_) * per_x_ + left_;
  }

  const EnvironmentMapParams& p_;
  int rows_;
  int64_t at_;
  int row_, column_;
  float per_x_, per_y_, left_, top_, step_x_, step_y_;
  int64_t pixel_ = 0, begin_ = 0;
  float x_ = 0, y_ = top_;
};

Floats load_lanes(const float* p) { return Floats(load(p)); }

struct Rotation {
  explicit Rotation(const EnvironmentMapParams& p) {
    for (int i = 0; i < 9; ++i) R[i] = Floats(p.cam_from_world[i]);
  }
  Floats R[9];
};

// Computes the places on the maps, and the weights, of the next `count` samples, at most kBlock. Lanes past the end
// repeat the last one.
template <bool kWeighted>
void reflect_block(const EnvironmentMapParams& p, const Rotation& rotation, Samples<kWeighted>& samples, int count,
                   Block& b) {
  b.count = count;
  const int groups = (count + kWidth - 1) / kWidth;
  for (int i = 0; i < count; ++i) samples.write(b, i);
  for (int i = count; i < groups * kWidth; ++i) {
    for (int k = 0; k < 2; ++k) b.ray[k][i] = b.ray[k][count - 1];
    for (int c = 0; c < 3; ++c) b.normal[c][i] = b.normal[c][count - 1];
  }
  const Floats side(float(p.side));
  for (int g = 0; g < groups; ++g) {
    const int i = g * kWidth;
    const Floats ray[2] = {load_lanes(b.ray[0] + i), load_lanes(b.ray[1] + i)};
    const Floats normal[3] = {load_lanes(b.normal[0] + i), load_lanes(b.normal[1] + i), load_lanes(b.normal[2] + i)};
    const EnvironmentMapSight<Floats> sight = reflect_sight(rotation.R, ray, normal);
    for (int k = 0; k < 2; ++k) {
      store(b.texel[0][k] + i, texel_of(sight.still.place[k], side).v);
      store(b.texel[1][k] + i, texel_of(sight.held.place[k], side).v);
    }
    b.sight[g] = sight;
    if constexpr (kWeighted) {
      const Floats square = normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2];
      store(b.weight + i, sqrt(square).v);
    }
  }
}

int64_t samples_of(const EnvironmentMapParams& p) { return p.samples ? int64_t(p.samples) * p.samples : 1; }

// The four texels around a sample's place on a map.
struct Cell {
  Cell(const PaddedMaps& layout, const Block& b, int which, int i) {
    const float across = b.texel[which][0][i], along = b.texel[which][1][i];
    const int column = int(across), line = int(along);
    x = across - float(column), y = along - float(line);
    upper = layout.at(which, line, column), lower = upper + layout.row;
  }
  Corners<vtexel> load(const float* maps) const {
    return {load_texel(maps + upper), load_texel(maps + upper + 4), load_texel(maps + lower), load_texel(maps + lower + 4)};
  }
  void add(float* maps, const Corners<vtexel>& v) const {
    add_texel(maps + upper, v.upper_left), add_texel(maps + upper + 4, v.upper_right);
    add_texel(maps + lower, v.lower_left), add_texel(maps + lower + 4, v.lower_right);
  }

  size_t upper, lower;
  float x, y;
};

template <bool kWeighted>
void forward_samples(const EnvironmentMapParams& p) {
  const PaddedMaps layout(p.side);
  const float* maps = pad(p, layout);
  const Rotation rotation(p);
  parallel_chunks(p.count, kChunk, [&](int64_t begin, int64_t end) {
    const int64_t all = (end - begin) * samples_of(p);
    Samples<kWeighted> samples(p, begin * samples_of(p));
    Block b;
    for (int64_t done = 0; done < all; done += kBlock) {
      reflect_block(p, rotation, samples, int(std::min<int64_t>(all - done, kBlock)), b);
      for (int i = 0; i < b.count; ++i) {
        const Cell still(layout, b, 0, i), held(layout, b, 1, i);
        float* to = p.light + 3 * b.pixel[i];
        vtexel light = bilinear(still.load(maps), still.x, still.y) + bilinear(held.load(maps), held.x, held.y);
        if constexpr (kWeighted) {
          light *= b.weight[i];
          if (!b.first[i]) light += load_channels(to);
        }
        std::memcpy(to, &light, 3 * sizeof(float));
      }
    }
  });
}

void forward(const EnvironmentMapParams& p) { p.samples ? forward_samples<true>(p) : forward_samples<false>(p); }

// Computes the gradients of the samples' places on the maps, in texels, if the normals' gradient is requested. Adds the
// gradients of the maps to v_maps, if those are requested.
template <bool kWeighted>
void look_back(const EnvironmentMapParams& p, const PaddedMaps& layout, const float* maps, Block& b, float* v_maps) {
  const bool to_normals = p.v_normals != nullptr, to_maps = p.v_maps != nullptr;
  for (int i = 0; i < b.count; ++i) {
    vtexel v = load_channels(p.v_light + 3 * b.pixel[i]);
    if constexpr (kWeighted) v *= b.weight[i];
    vtexel by[2][2] = {};
    for (int which = 0; which < 2; ++which) {
      const Cell cell(layout, b, which, i);
      if (to_normals) bilinear_slopes(cell.load(maps), cell.x, cell.y, by[which][0], by[which][1]);
      if (to_maps) cell.add(v_maps, bilinear_vjp(v, cell.x, cell.y));
    }
    if (!to_normals) continue;
    const vtexel sum = sums(by[0][0] * v, by[0][1] * v, by[1][0] * v, by[1][1] * v);
    for (int k = 0; k < 4; ++k) b.v_texel[k / 2][k % 2][i] = sum[k];
  }
}

void normal_gradients(const EnvironmentMapParams& p, const Rotation& rotation, const Block& b) {
  const Floats side(float(p.side));
  for (int i = 0; i < b.count; i += kWidth) {
    Floats v_place[2][2], v_normal[3];
    for (int which = 0; which < 2; ++which)
      for (int k = 0; k < 2; ++k)
        v_place[which][k] = load_lanes(b.v_texel[which][k] + i) * texel_slope(load_lanes(b.texel[which][k] + i), side);
    reflect_sight_vjp(rotation.R, b.sight[i / kWidth], v_place[0], v_place[1], v_normal);
    float columns[3][kWidth];
    for (int c = 0; c < 3; ++c) store(columns[c], v_normal[c].v);
    for (int lane = 0; lane < std::min(kWidth, b.count - i); ++lane)
      for (int c = 0; c < 3; ++c) p.v_normals[3 * b.pixel[i + lane] + c] = columns[c][lane];
  }
}

// Adds the maps of the parts [parts, 2, stride, stride, 4] in order, without the texels that the layout adds; those
// have no weight.
void add_parts(const EnvironmentMapParams& p, const PaddedMaps& layout, const float* of_parts, int64_t parts) {
  parallel_chunks(2 * p.side, 8, [&](int64_t begin, int64_t end) {
    for (int64_t line = begin; line < end; ++line) {
      const float* from = of_parts + layout.at(int(line / p.side), int(line % p.side), 0);
      float* to = p.v_maps + 3 * line * p.side;
      for (int x = 0; x < p.side; ++x) {
        vtexel sum = load_texel(from + 4 * x);
        for (int64_t part = 1; part < parts; ++part) sum += load_texel(from + size_t(part) * layout.floats() + 4 * x);
        std::memcpy(to + 3 * x, &sum, 3 * sizeof(float));
      }
    }
  });
}

template <bool kWeighted>
void backward_samples(const EnvironmentMapParams& p) {
  static thread_local std::vector<float> of_parts;
  const PaddedMaps layout(p.side);
  const float* maps = pad(p, layout);
  const Rotation rotation(p);
  const int64_t all = p.count * samples_of(p);
  const int64_t parts = std::clamp<int64_t>(all / kLeastPart, 1, kMostParts), size = (all + parts - 1) / parts;
  if (p.v_maps) of_parts.resize(size_t(parts) * layout.floats());
  float* v_maps = of_parts.data();
  ThreadPool::instance().run(int(parts), [&](int part) {
    float* own = v_maps + size_t(part) * layout.floats();
    if (p.v_maps) std::fill_n(own, layout.floats(), 0.0f);
    const int64_t begin = part * size, end = std::min<int64_t>(all, begin + size);
    if (begin >= end) return;
    Samples<kWeighted> samples(p, begin);
    Block b;
    for (int64_t at = begin; at < end; at += kBlock) {
      reflect_block(p, rotation, samples, int(std::min<int64_t>(end - at, kBlock)), b);
      look_back<kWeighted>(p, layout, maps, b, own);
      if (p.v_normals) normal_gradients(p, rotation, b);
    }
  });
  if (p.v_maps) add_parts(p, layout, v_maps, parts);
}

void backward(const EnvironmentMapParams& p) { p.samples ? backward_samples<true>(p) : backward_samples<false>(p); }

}  // namespace

extern const EnvironmentMapTable environment_map_table{forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
