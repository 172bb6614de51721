// The walk back through the 3D branch's blending: from gradient images to a gradient for each (splat, tile) pair.
//
// It goes front to back too. With g = v_out . (what the splat adds), the gradient to alpha_i is
// T_i g_i - (everything behind i) / (1 - alpha_i), and "everything behind" is the pixel's total less a running sum: one
// scalar however many channels there are. Sums over a tile's pixels go to the pair's own slot.
#pragma once

#include <cstring>

#include "kernels/volumes/blending_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

// Gradient of one (splat, tile) pair. The moments are of the exponent's gradient over the pixels' offsets from the
// centre; kOpacity and kReflOpacity are times the opacity.
enum PairField { kDx, kDy, kDxx, kDxy, kDyy, kOpacity, kColor, kDepth = kColor + 3, kReflOpacity, kWeight, kReflColor };
constexpr int kFields = 16;  // one cache line, the last one unused

// The gradient images at a sub-tile's pixels, made ready for the walk.
template <bool Dual, bool Depth>
struct PixelGradients {
  float color[3][16] = {}, depth[16] = {}, weight[16] = {}, refl_color[3][16] = {};
  // What the walk will have added up by its end, and what lies behind the last splat.
  float behind[16] = {}, refl_behind[16] = {};

  PixelGradients(const VolumeInputs& in, const VolumeState& state, const VolumeImages& out, const VolumeImages& v,
                 const Pixels& pixels) {
    for_pixels(pixels.x0, pixels.y0, in.width, in.height, [&](int64_t i, int j) {
      const float T = state.transmittance[i], alpha = 1.0f - T;
      float total = v.alpha ? -T * v.alpha[i] : 0.0f;
      for (int k = 0; k < 3; ++k) {
        color[k][j] = v.color ? v.color[3 * i + k] : 0.0f;
        total += color[k][j] * out.color[3 * i + k];
      }
      if (Depth && v.depth && out.depth[i] > 0) {
        // depth = D / alpha: v_D = v / alpha, and v_alpha loses v * depth / alpha.
        depth[j] = v.depth[i] / alpha;
        total += depth[j] * out.depth[i];
      }
      if (Dual) {
        weight[j] = v.weight ? v.weight[i] : 0.0f;
        total += weight[j] * out.weight[i];
        for (int k = 0; k < 3; ++k) {
          refl_color[k][j] = v.reflected ? v.reflected[3 * i + k] : 0.0f;
          refl_behind[j] += refl_color[k][j] * out.reflected[3 * i + k];
        }
      }
      behind[j] = total;
    });
  }
};

// One of the two lights at a vector of pixels on the walk.
struct LightWalk {
  Light light;
  vfloat behind;

  // Goes through a splat of which a share adds `gain` each to the loss; returns that share.
  vfloat pass(vfloat met, vfloat gain, vfloat& v_exponent) {
    const vfloat alpha = light.admit(met), T = light.T, share = alpha * T;
    light.pass(alpha);
    behind = fma(-share, gain, behind);
    const vfloat v_alpha = fma(T, gain, -(behind * reciprocal(1.0f - alpha)));
    // Zero where alpha is held at its maximum, and where it is 0.
    v_exponent = keep(alpha < kMaxAlpha, v_alpha * alpha);
    return share;
  }
};

struct Walk {
  LightWalk main, refl;
};

// What the walk finds for a batch: for each splat, its pixels' shares and gradients of the exponent.
struct Steps {
  alignas(64) float share[kBatch][16], exponent[kBatch][16], refl_share[kBatch][16], refl_exponent[kBatch][16];
};

inline vfloat dot(const vfloat a[3], const float b[3]) { return fma(a[0], splat(b[0]), fma(a[1], splat(b[1]), a[2] * b[2])); }

template <bool Dual, bool Depth>
inline void walk_vector(const Hit* hits, int n, int v, const PixelGradients<Dual, Depth>& g, Walk& walk, Steps& steps) {
  const int lane = v * kWidth;
  LightWalk main = walk.main, refl = walk.refl;
  const vfloat v_color[3] = {load(g.color[0] + lane), load(g.color[1] + lane), load(g.color[2] + lane)};
  const vfloat v_refl_color[3] = {load(g.refl_color[0] + lane), load(g.refl_color[1] + lane), load(g.refl_color[2] + lane)};
  for (int e = 0; e < n; ++e) {
    const VolumeRecord& r = *hits[e].splat;
    vfloat gain = dot(v_color, r.color), v_exponent;
    if (Depth) gain = fma(load(g.depth + lane), splat(r.depth), gain);
    if (Dual) gain = fma(load(g.weight + lane), splat(r.weight), gain);
    store(steps.share[e] + lane, main.pass(hits[e].alpha[v], gain, v_exponent));
    store(steps.exponent[e] + lane, v_exponent);
    if (!Dual) continue;
    store(steps.refl_share[e] + lane, refl.pass(hits[e].refl_alpha[v], dot(v_refl_color, r.refl_color), v_exponent));
    store(steps.refl_exponent[e] + lane, v_exponent);
  }
  walk.main = main;
  if (Dual) walk.refl = refl;
}

// From here on a vector has a splat to each lane.

// The steps' values at kWidth pixels from `pixel` on.
inline void turn(const float steps[kBatch][16], int pixel, vfloat by_pixel[kWidth]) {
  for (int e = 0; e < kBatch; ++e) by_pixel[e] = load(steps[e] + pixel);
  transpose(by_pixel);
}

// Sums over a sub-tile's pixels, with their offsets from its middle.
struct Moments {
  vfloat one = {}, x = {}, y = {}, xx = {}, xy = {}, yy = {};

  void add_row(const vfloat a[4], float row) {
    const vfloat outer = a[0] + a[3], inner = a[1] + a[2], sum = outer + inner;
    const vfloat sum_x = fma(splat(1.5f), a[3] - a[0], 0.5f * (a[2] - a[1]));
    one += sum, x += sum_x, xx += fma(splat(2.25f), outer, 0.25f * inner);
    y = fma(splat(row), sum, y), xy = fma(splat(row), sum_x, xy), yy = fma(splat(row * row), sum, yy);
  }

  // The moments with the middle at (dx, dy).
  void write(vfloat dx, vfloat dy, vfloat fields[kFields]) const {
    const vfloat from_x = fma(dx, one, x), from_y = fma(dy, one, y);
    fields[kDx] = from_x, fields[kDy] = from_y;
    fields[kDxx] = fma(dx, x + from_x, xx), fields[kDyy] = fma(dy, y + from_y, yy);
    fields[kDxy] = fma(dx, from_y, fma(dy, x, xy));
  }
};

inline void add_products(const vfloat shares[kWidth], const float* v_image, vfloat& field) {
  for (int p = 0; p < kWidth; ++p) field = fma(shares[p], splat(v_image[p]), field);
}

template <bool Dual, bool Depth>
inline void gather(const Steps& steps, const PixelGradients<Dual, Depth>& g, vfloat dx, vfloat dy, vfloat fields[kFields]) {
  for (int k = 0; k < kFields; ++k) fields[k] = vfloat{};
  Moments moments;
  vfloat a[kWidth], b[kWidth];
  for (int pixel = 0; pixel < 16; pixel += kWidth) {
    turn(steps.share, pixel, a);
    for (int k = 0; k < 3; ++k) add_products(a, g.color[k] + pixel, fields[kColor + k]);
    if (Depth) add_products(a, g.depth + pixel, fields[kDepth]);
    if (Dual) add_products(a, g.weight + pixel, fields[kWeight]);
    turn(steps.exponent, pixel, a);
    for (int p = 0; p < kWidth; ++p) fields[kOpacity] += a[p];
    if (Dual) {
      turn(steps.refl_exponent, pixel, b);
      for (int p = 0; p < kWidth; ++p) fields[kReflOpacity] += b[p], a[p] += b[p];
      turn(steps.refl_share, pixel, b);
      for (int k = 0; k < 3; ++k) add_products(b, g.refl_color[k] + pixel, fields[kReflColor + k]);
    }
    for (int p = 0; p < kWidth; p += kSubTile) moments.add_row(a + p, float((pixel + p) / kSubTile) - 1.5f);
  }
  moments.write(dx, dy, fields);
}

// pairs: [tile's entries, kFields] gets the sums of a batch's splats added.
inline void add_to_pairs(vfloat fields[kFields], const uint32_t* list, int n, float* pairs) {
  for (int k = 0; k < kFields; k += kWidth) {
    transpose(fields + k);
    for (int e = 0; e < n; ++e) {
      float* pair = pairs + size_t(list[e]) * kFields + k;
      store(pair, load(pair) + fields[k + e]);
    }
  }
}

template <bool Dual, bool Depth>
void backward_subtile(const VolumeState& state, const PixelGradients<Dual, Depth>& g, const SubTileLists& sub, int s,
                      const Pixels& pixels, float* pairs) {
  Walk p[kVectors];
  for (int v = 0; v < kVectors; ++v) {
    p[v].main.behind = load(g.behind + v * kWidth);
    if (Dual) p[v].refl.behind = load(g.refl_behind + v * kWidth);
  }
  Hit hits[kBatch];
  Steps steps = {};
  vfloat dx = {}, dy = {}, fields[kFields];
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    const int n = meet_batch<Dual>(state, sub, list + e, count - e, pixels, hits);
    vint open = {};
    for (int v = 0; v < kVectors; ++v) {
      walk_vector<Dual, Depth>(hits, n, v, g, p[v], steps);
      open |= p[v].main.light.open;
      if (Dual) open |= p[v].refl.light.open;
    }
    for (int i = 0; i < n; ++i) dx[i] = hits[i].dx + 0.5f * kSubTile, dy[i] = hits[i].dy + 0.5f * kSubTile;
    gather<Dual, Depth>(steps, g, dx, dy, fields);
    add_to_pairs(fields, list + e, n, pairs);
    if (!any(open)) break;
  }
}

template <bool Dual, bool Depth>
void blend_backward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, const VolumeImages& v_out) {
  state.pair_gradients.resize(size_t(state.lists.pairs()) * kFields);
  for_tiles(state.lists, state.records.data(), [&](int tile, const SubTileLists& sub, int x0, int y0) {
    static thread_local std::vector<float> pairs;
    const int64_t first = state.lists.begin[tile], n = state.lists.begin[tile + 1] - first;
    pairs.assign(size_t(n) * kFields, 0.0f);
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const Pixels pixels(x, y);
      const PixelGradients<Dual, Depth> g(in, state, out, v_out, pixels);
      backward_subtile<Dual, Depth>(state, g, sub, s, pixels, pairs.data());
    });
    for (int64_t e = 0; e < n; ++e)
      std::memcpy(&state.pair_gradients[size_t(state.lists.entries[first + e].slot) * kFields], &pairs[size_t(e) * kFields],
                  sizeof(float) * kFields);
  });
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
