// 3D Gaussians on the CPU.
//
// Forward: project and cull every splat (chunks of splats over the threads); sort the visible ones by depth; fill the
// tile lists; blend tile by tile (one tile is one piece of work). Within a tile each 4x4 sub-tile is blended on its
// own, its 16 pixels in registers, over the entries of the tile whose mask names it.
// Backward: the same walk front to back. With g = v_out . (what the splat adds), the gradient to alpha_i is
// T_i g_i - (everything behind i) / (1 - alpha_i), and "everything behind" is the pixel's total less a running sum: one
// scalar however many channels there are. Sums over a tile's pixels go to the pair's own slot; a splat's slots are then
// added in tile order, so the result doesn't depend on the number of threads.
#include "kernels/volumes/volumes.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/common/blending.h"
#include "kernels/common/simd.h"
#include "kernels/common/subtiles.h"
#include "math/gaussian.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kVectors = 16 / kWidth;          // vectors to a sub-tile
constexpr double kLog2E = 1.4426950408889634;
constexpr int kSplatChunk = 512;

// Gradient of one (splat, tile) pair. The moments are of v_exponent over the pixels' offsets from the centre.
enum PairField { kDx, kDy, kDxx, kDxy, kDyy, kOpacity, kColor, kDepth = kColor + 3, kReflOpacity, kWeight, kReflColor };
constexpr int kSingleFields = kDepth + 1, kDualFields = kReflColor + 3;
constexpr int stride(bool dual) { return dual ? 16 : 12; }

bool finite(const float* p, int n) {
  float zero = 0;
  for (int i = 0; i < n; ++i) zero += p[i] * 0.0f;
  return zero == 0.0f;
}

// In float64: a splat counts for a pixel or not by a threshold, and an error of 1e-5 in the exponent, which is what float
// leaves of a centre 256 pixels out, flips some thousands of those decisions in a view.
ProjectedGaussian<double> project_exactly(const VolumeInputs& in, int64_t i) {
  Camera<double> camera;
  for (int k = 0; k < 9; ++k) camera.R[k] = in.camera.R[k];
  for (int k = 0; k < 3; ++k) camera.t[k] = in.camera.t[k];
  camera.fx = in.camera.fx, camera.fy = in.camera.fy, camera.cx = in.camera.cx, camera.cy = in.camera.cy;
  camera.width = in.width, camera.height = in.height;
  double mean[3], quat[4], scale[3];
  for (int k = 0; k < 3; ++k) mean[k] = in.means[3 * i + k], scale[k] = in.scales[3 * i + k];
  for (int k = 0; k < 4; ++k) quat[k] = in.quats[4 * i + k];
  return project_gaussian(camera, mean, quat, scale, double(in.low_pass));
}

// Fills the record and outline of splat i; false when it can't be seen or isn't finite.
bool project_one(const VolumeInputs& in, int64_t i, VolumeRecord& record, Ellipse& outline) {
  const ProjectedGaussian<double> g = project_exactly(in, i);
  const double det = g.cxx * g.cyy - g.cxy * g.cxy;
  if (!(g.depth > in.near) || !(det > 0) || !(g.cxx + g.cyy < 1e12f)) return false;
  const float factor = in.compensate ? float(g.compensation) : 1.0f;
  const float opacity = in.opacities[i] * factor;
  const float refl_opacity = in.refl_opacities ? in.refl_opacities[i] * factor : 0.0f;
  const float strongest = std::max(opacity, refl_opacity);
  if (!(strongest >= kMinAlpha) || !(strongest <= 1e6f) || !(opacity >= 0) || !(refl_opacity >= 0)) return false;
  if (!finite(in.colors + 3 * i, 3) || (in.refl_colors && !(finite(in.refl_colors + 3 * i, 3) && finite(in.weights + i, 1))))
    return false;
  const float r2 = 2.0f * std::log(strongest / kMinAlpha);
  outline = Ellipse::make(g.x, g.y, g.cxx, g.cxy, g.cyy, r2);
  const PixelBox box = outline.box();
  if (!(box.x1 >= 0 && box.x0 <= in.width && box.y1 >= 0 && box.y0 <= in.height)) return false;
  record = {};
  record.x = std::floor(float(g.x)), record.y = std::floor(float(g.y));
  record.x_rest = float(g.x - record.x), record.y_rest = float(g.y - record.y);
  const double scale = -0.5 * kLog2E / det;
  record.qxx = float(scale * g.cyy), record.qxy = float(-2.0 * scale * g.cxy), record.qyy = float(scale * g.cxx);
  record.opacity = opacity, record.depth = g.depth;
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (in.refl_opacities) {
    record.refl_opacity = refl_opacity, record.weight = in.weights[i];
    std::memcpy(record.refl_color, in.refl_colors + 3 * i, sizeof(record.refl_color));
  }
  record.index = uint32_t(i);
  return true;
}

// Projects all splats; state.projected, outlines and depths then hold the visible ones by index.
void project_all(const VolumeInputs& in, VolumeState& state, float* radii) {
  const int chunks = int((in.count + kSplatChunk - 1) / kSplatChunk);
  state.projected.resize(in.count), state.outlines.resize(in.count), state.chunk_counts.assign(chunks + 1, 0);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    int64_t place = begin;
    for (int64_t i = begin; i < end; ++i) {
      const bool seen = project_one(in, i, state.projected[place], state.outlines[place]);
      radii[i] = seen ? std::max(state.outlines[place].hx, state.outlines[place].hy) : 0.0f;
      place += seen;
    }
    state.chunk_counts[begin / kSplatChunk] = place - begin;
  });
  // Close the gaps that culled splats left at the chunks' ends.
  int64_t total = 0;
  for (int c = 0; c < chunks; ++c) {
    const int64_t begin = int64_t(c) * kSplatChunk, n = state.chunk_counts[c];
    if (total != begin) {
      std::copy_n(state.projected.begin() + begin, n, state.projected.begin() + total);
      std::copy_n(state.outlines.begin() + begin, n, state.outlines.begin() + total);
    }
    total += n;
  }
  state.projected.resize(total), state.outlines.resize(total), state.depths.resize(total);
  for (int64_t s = 0; s < total; ++s) state.depths[s] = state.projected[s].depth;
}

void sort_and_bin(const VolumeInputs& in, VolumeState& state) {
  state.sorter.sort(state.depths, state.order);
  const int count = int(state.order.size());
  state.records.resize(count), state.sorted_outlines.resize(count), state.boxes.resize(count);
  parallel_chunks(count, kSplatChunk, [&](int64_t begin, int64_t end) {
    for (int64_t s = begin; s < end; ++s) {
      state.records[s] = state.projected[state.order[s]];
      state.sorted_outlines[s] = state.outlines[state.order[s]];
      state.boxes[s] = state.sorted_outlines[s].box();
    }
  });
  const Ellipse* outlines = state.sorted_outlines.data();
  state.lists.build(count, in.width, in.height, state.boxes.data(),
                    [outlines](int s, float y0, float y1, float& x0, float& x1) { return outlines[s].rows(y0, y1, x0, x1); });
}

// The 16 pixels of a sub-tile: their offsets from its first pixel's centre.
struct Pixels {
  vfloat x[kVectors], y[kVectors];
  float x0, y0;

  Pixels(int left, int top) : x0(left + 0.5f), y0(top + 0.5f) {
    for (int v = 0; v < kVectors; ++v)
      for (int lane = 0; lane < kWidth; ++lane) {
        const int p = v * kWidth + lane;
        x[v][lane] = float(p % kSubTile);
        y[v][lane] = float(p / kSubTile);
      }
  }
};

// The footprint of a splat at a vector of pixels.
struct Footprint {
  vfloat dx, dy, weight;  // offsets from the centre; G
};

// A centre far from the image's origin is coarse in float; its whole and its fractional part are not, nor is their
// difference to a pixel near by.
inline Footprint footprint(const VolumeRecord& r, const Pixels& pixels, int v) {
  Footprint f;
  f.dx = pixels.x[v] + ((pixels.x0 - r.x) - r.x_rest), f.dy = pixels.y[v] + ((pixels.y0 - r.y) - r.y_rest);
  const vfloat ydy = (r.qyy * f.dy) * f.dy;
  f.weight = exp2_nonpositive(fma(f.dx, fma(splat(r.qxx), f.dx, r.qxy * f.dy), ydy));
  return f;
}

// alpha of a splat whose o G is `raw`: zero where it doesn't count.
inline vfloat alpha_of(vfloat raw) { return keep(raw >= kMinAlpha, min(raw, splat(kMaxAlpha))); }

template <bool Dual, bool Depth>
void blend_subtile(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, const SubTileItem* items,
                   int count, int x0, int y0) {
  const Pixels pixels(x0, y0);
  Light light[kVectors], refl_light[kVectors];
  vfloat C[kVectors][3] = {}, D[kVectors] = {}, Cr[kVectors][3] = {}, W[kVectors] = {};
  for (int e = 0; e < count; ++e) {
    const VolumeRecord& r = state.records[items[e].splat];
    vint open = vint{};
    for (int v = 0; v < kVectors; ++v) {
      const Footprint f = footprint(r, pixels, v);
      const vfloat alpha = light[v].admit(alpha_of(r.opacity * f.weight)), w = alpha * light[v].T;
      for (int c = 0; c < 3; ++c) C[v][c] = fma(w, splat(r.color[c]), C[v][c]);
      if (Depth) D[v] = fma(w, splat(r.depth), D[v]);
      light[v].pass(alpha);
      open |= light[v].open;
      if (Dual) {
        W[v] = fma(w, splat(r.weight), W[v]);
        const vfloat alpha_r = refl_light[v].admit(alpha_of(r.refl_opacity * f.weight)), w_r = alpha_r * refl_light[v].T;
        for (int c = 0; c < 3; ++c) Cr[v][c] = fma(w_r, splat(r.refl_color[c]), Cr[v][c]);
        refl_light[v].pass(alpha_r);
        open |= refl_light[v].open;
      }
    }
    if (!any(open)) break;
  }
  float t[16], c[3][16], d[16], tr[16], cr[3][16], w[16];
  for (int v = 0; v < kVectors; ++v) {
    store(t + v * kWidth, light[v].T);
    for (int k = 0; k < 3; ++k) store(c[k] + v * kWidth, C[v][k]);
    if (Depth) store(d + v * kWidth, D[v]);
    if (!Dual) continue;
    store(tr + v * kWidth, refl_light[v].T), store(w + v * kWidth, W[v]);
    for (int k = 0; k < 3; ++k) store(cr[k] + v * kWidth, Cr[v][k]);
  }
  for_pixels(x0, y0, in.width, in.height, [&](int64_t i, int p) {
    const float alpha = 1.0f - t[p];
    state.transmittance[i] = t[p], out.alpha[i] = alpha;
    for (int k = 0; k < 3; ++k) out.color[3 * i + k] = c[k][p] + t[p] * in.background[k];
    if (Depth) out.depth[i] = alpha > kMinAlpha / 2 ? d[p] / alpha : 0.0f;
    if (!Dual) return;
    state.refl_transmittance[i] = tr[p], out.weight[i] = w[p];
    for (int k = 0; k < 3; ++k) out.reflected[3 * i + k] = cr[k][p];
  });
}

// The gradient images at a sub-tile's pixels, made ready for the walk.
template <bool Dual, bool Depth>
struct PixelGradients {
  vfloat color[kVectors][3], depth[kVectors], behind[kVectors];
  vfloat refl_color[kVectors][3], weight[kVectors], refl_behind[kVectors];

  PixelGradients(const VolumeInputs& in, const VolumeState& state, const VolumeImages& out, const VolumeImages& v, int x0,
                 int y0) {
    float g[10][16] = {};
    for_pixels(x0, y0, in.width, in.height, [&](int64_t i, int p) {
      const float T = state.transmittance[i], alpha = 1.0f - T;
      // What the walk will have added up by its end, and what the background and alpha add behind the last splat.
      float total = v.alpha ? -T * v.alpha[i] : 0.0f;
      for (int k = 0; k < 3; ++k) {
        g[k][p] = v.color ? v.color[3 * i + k] : 0.0f;
        total += g[k][p] * out.color[3 * i + k];
      }
      if (Depth && v.depth && out.depth[i] > 0) {
        // depth = D / alpha: v_D = v / alpha, and v_alpha loses v * depth / alpha.
        g[3][p] = v.depth[i] / alpha;
        total += g[3][p] * out.depth[i] * alpha + T * g[3][p] * out.depth[i];
      }
      if (Dual) {
        g[5][p] = v.weight ? v.weight[i] : 0.0f;
        total += g[5][p] * out.weight[i];
        float refl_total = 0;
        for (int k = 0; k < 3; ++k) {
          g[6 + k][p] = v.reflected ? v.reflected[3 * i + k] : 0.0f;
          refl_total += g[6 + k][p] * out.reflected[3 * i + k];
        }
        g[9][p] = refl_total;
      }
      g[4][p] = total;
    });
    for (int n = 0; n < kVectors; ++n) {
      for (int k = 0; k < 3; ++k) color[n][k] = load(g[k] + n * kWidth), refl_color[n][k] = load(g[6 + k] + n * kWidth);
      depth[n] = load(g[3] + n * kWidth), behind[n] = load(g[4] + n * kWidth);
      weight[n] = load(g[5] + n * kWidth), refl_behind[n] = load(g[9] + n * kWidth);
    }
  }
};

// pairs: [tile's entries, stride] gets each pair's sums added.
template <bool Dual, bool Depth>
void backward_subtile(const VolumeInputs& in, const VolumeState& state, const VolumeImages& out, const VolumeImages& v_out,
                      const SubTileItem* items, int count, int x0, int y0, float* pairs) {
  constexpr int kFields = Dual ? kDualFields : Depth ? kSingleFields : kDepth;
  const Pixels pixels(x0, y0);
  PixelGradients<Dual, Depth> g(in, state, out, v_out, x0, y0);
  Light light[kVectors], refl_light[kVectors];
  for (int e = 0; e < count; ++e) {
    const VolumeRecord& r = state.records[items[e].splat];
    vfloat sums[kDualFields] = {};
    vint open = vint{};
    for (int v = 0; v < kVectors; ++v) {
      const Footprint f = footprint(r, pixels, v);
      const vfloat raw = r.opacity * f.weight, alpha = light[v].admit(alpha_of(raw)), w = alpha * light[v].T;
      vfloat gain = g.color[v][0] * r.color[0] + g.color[v][1] * r.color[1] + g.color[v][2] * r.color[2];
      if (Depth) gain += g.depth[v] * r.depth;
      if (Dual) gain += g.weight[v] * r.weight;
      g.behind[v] -= w * gain;
      // Zero where the splat doesn't count and where alpha is held at its maximum.
      vfloat v_alpha = light[v].T * gain - g.behind[v] / (1.0f - alpha);
      v_alpha = keep((alpha > 0.0f) & (raw < kMaxAlpha), v_alpha);
      vfloat v_exponent = v_alpha * raw;
      sums[kOpacity] += v_exponent;
      for (int c = 0; c < 3; ++c) sums[kColor + c] += w * g.color[v][c];
      if (Depth) sums[kDepth] += w * g.depth[v];
      light[v].pass(alpha);
      open |= light[v].open;
      if (Dual) {
        sums[kWeight] += w * g.weight[v];
        const vfloat raw_r = r.refl_opacity * f.weight, alpha_r = refl_light[v].admit(alpha_of(raw_r)),
                     w_r = alpha_r * refl_light[v].T;
        const vfloat gain_r =
            g.refl_color[v][0] * r.refl_color[0] + g.refl_color[v][1] * r.refl_color[1] + g.refl_color[v][2] * r.refl_color[2];
        g.refl_behind[v] -= w_r * gain_r;
        vfloat v_alpha_r = refl_light[v].T * gain_r - g.refl_behind[v] / (1.0f - alpha_r);
        v_alpha_r = keep((alpha_r > 0.0f) & (raw_r < kMaxAlpha), v_alpha_r);
        const vfloat v_exponent_r = v_alpha_r * raw_r;
        sums[kReflOpacity] += v_exponent_r;
        v_exponent += v_exponent_r;
        for (int c = 0; c < 3; ++c) sums[kReflColor + c] += w_r * g.refl_color[v][c];
        refl_light[v].pass(alpha_r);
        open |= refl_light[v].open;
      }
      const vfloat vx = v_exponent * f.dx, vy = v_exponent * f.dy;
      sums[kDx] += vx, sums[kDy] += vy;
      sums[kDxx] += vx * f.dx, sums[kDxy] += vx * f.dy, sums[kDyy] += vy * f.dy;
    }
    add_sums<kFields>(sums, pairs + size_t(items[e].entry) * stride(Dual));
    if (!any(open)) break;
  }
}

template <bool Dual, bool Depth>
void blend(const VolumeInputs& in, VolumeState& state, const VolumeImages& out) {
  for_tiles(state.lists, state.records.data(), [&](int, const SubTileLists& sub, int x0, int y0) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      blend_subtile<Dual, Depth>(in, state, out, sub.begin(s), sub.count(s), x, y);
    });
  });
}

template <bool Dual, bool Depth>
void blend_backward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, const VolumeImages& v_out) {
  state.pair_gradients.resize(size_t(state.lists.pairs()) * stride(Dual));
  for_tiles(state.lists, state.records.data(), [&](int tile, const SubTileLists& sub, int x0, int y0) {
    static thread_local std::vector<float> pairs;
    const int64_t first = state.lists.begin[tile], n = state.lists.begin[tile + 1] - first;
    pairs.assign(size_t(n) * stride(Dual), 0.0f);
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      backward_subtile<Dual, Depth>(in, state, out, v_out, sub.begin(s), sub.count(s), x, y, pairs.data());
    });
    for (int64_t e = 0; e < n; ++e)
      std::memcpy(&state.pair_gradients[size_t(state.lists.entries[first + e].slot) * stride(Dual)],
                  &pairs[size_t(e) * stride(Dual)], sizeof(float) * stride(Dual));
  });
}

// From the pairs' moments to the projected splat's gradient, and on to the parameters.
void splat_backward(const VolumeInputs& in, const VolumeRecord& r, const float* total, bool dual, const VolumeGradients& v) {
  const int64_t i = r.index;
  // exponent (natural) = -0.5 (qxx dx^2 + 2 qxy dx dy + qyy dy^2) in terms of the inverse covariance Q.
  const float qxx = r.qxx * float(-2.0 / kLog2E), qxy = r.qxy * float(-1.0 / kLog2E), qyy = r.qyy * float(-2.0 / kLog2E);
  ProjectedGaussian<float> g = {};
  g.x = qxx * total[kDx] + qxy * total[kDy];
  g.y = qxy * total[kDx] + qyy * total[kDy];
  g.depth = total[kDepth];
  // v_covariance = -Q v_Q Q, with v_Q = -0.5 * moments.
  const float mxx = 0.5f * total[kDxx], mxy = 0.5f * total[kDxy], myy = 0.5f * total[kDyy];
  const float axx = qxx * mxx + qxy * mxy, axy = qxx * mxy + qxy * myy, ayx = qxy * mxx + qyy * mxy, ayy = qxy * mxy + qyy * myy;
  g.cxx = axx * qxx + axy * qxy;
  g.cyy = ayx * qxy + ayy * qyy;
  g.cxy = (axx * qxy + axy * qyy) + (ayx * qxx + ayy * qxy);
  const float o = in.opacities[i], o_r = dual ? in.refl_opacities[i] : 0.0f;
  // Exponent's and opacity's gradients differ by the factor o; alpha = (o * compensation) * G.
  v.opacities[i] = o > 0 ? total[kOpacity] / o : 0.0f;
  if (dual) v.refl_opacities[i] = o_r > 0 ? total[kReflOpacity] / o_r : 0.0f;
  if (in.compensate) {
    const float factor = o > 0 ? r.opacity / o : r.refl_opacity / o_r;
    g.compensation = factor > 0 ? (total[kOpacity] + (dual ? total[kReflOpacity] : 0.0f)) / factor : 0.0f;
  }
  for (int k = 0; k < 3; ++k) v.colors[3 * i + k] = total[kColor + k];
  if (dual) {
    v.weights[i] = total[kWeight];
    for (int k = 0; k < 3; ++k) v.refl_colors[3 * i + k] = total[kReflColor + k];
  }
  v.means2d[2 * i] = g.x, v.means2d[2 * i + 1] = g.y;
  project_gaussian_vjp(in.camera, in.means + 3 * i, in.quats + 4 * i, in.scales + 3 * i, in.low_pass, g, v.means + 3 * i,
                       v.quats + 4 * i, v.scales + 3 * i);
}

template <bool Dual>
void reduce_pairs(const VolumeInputs& in, const VolumeState& state, const VolumeGradients& v) {
  parallel_chunks(int64_t(state.records.size()), kSplatChunk, [&](int64_t begin, int64_t end) {
    for (int64_t s = begin; s < end; ++s) {
      float total[16] = {};
      for (uint32_t slot = state.lists.slot_begin[s]; slot < state.lists.slot_begin[s + 1]; ++slot)
        for (int k = 0; k < stride(Dual); ++k) total[k] += state.pair_gradients[size_t(slot) * stride(Dual) + k];
      splat_backward(in, state.records[s], total, Dual, v);
    }
  });
}

void forward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, float* radii) {
  const bool dual = in.refl_opacities != nullptr;
  project_all(in, state, radii);
  sort_and_bin(in, state);
  state.transmittance.resize(size_t(in.width) * in.height);
  if (dual) state.refl_transmittance.resize(size_t(in.width) * in.height);
  if (dual) in.depth ? blend<true, true>(in, state, out) : blend<true, false>(in, state, out);
  else in.depth ? blend<false, true>(in, state, out) : blend<false, false>(in, state, out);
}

void backward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, const VolumeImages& v_out,
              const VolumeGradients& v) {
  if (in.refl_opacities) {
    v_out.depth ? blend_backward<true, true>(in, state, out, v_out) : blend_backward<true, false>(in, state, out, v_out);
    reduce_pairs<true>(in, state, v);
  } else {
    v_out.depth ? blend_backward<false, true>(in, state, out, v_out) : blend_backward<false, false>(in, state, out, v_out);
    reduce_pairs<false>(in, state, v);
  }
}

}  // namespace

const VolumeKernels volume_kernels = {forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
