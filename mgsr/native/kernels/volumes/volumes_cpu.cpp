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

#include "kernels/volumes/backward_cpu.h"
#include "kernels/volumes/blending_cpu.h"
#include "math/gaussian.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr double kLog2E = 1.4426950408889634;
constexpr int kSplatChunk = 512;

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
  record.x = int16_t(std::min(std::max(std::floor(g.x), -32768.0), 32767.0));
  record.y = int16_t(std::min(std::max(std::floor(g.y), -32768.0), 32767.0));
  record.x_rest = float(g.x - record.x), record.y_rest = float(g.y - record.y);
  const double k = std::sqrt(0.5 * kLog2E), inverse = k / std::sqrt(det * g.cyy);
  record.root[0] = float(inverse * g.cyy), record.root[1] = float(-inverse * g.cxy), record.root[2] = float(k / std::sqrt(g.cyy));
  record.opacity = opacity, record.depth = g.depth;
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (in.refl_opacities) {
    record.refl_opacity = refl_opacity, record.weight = in.weights[i];
    std::memcpy(record.refl_color, in.refl_colors + 3 * i, sizeof(record.refl_color));
  }
  return true;
}

// Projects all splats; state.projected, outlines and depths then hold the visible ones by index.
void project_all(const VolumeInputs& in, VolumeState& state, float* radii) {
  const int chunks = int((in.count + kSplatChunk - 1) / kSplatChunk);
  state.projected.resize(in.count), state.outlines.resize(in.count), state.visible.resize(in.count);
  state.chunk_counts.assign(chunks, 0);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    int64_t place = begin;
    for (int64_t i = begin; i < end; ++i) {
      const bool seen = project_one(in, i, state.projected[place], state.outlines[place]);
      radii[i] = seen ? std::max(state.outlines[place].hx, state.outlines[place].hy) : 0.0f;
      state.visible[place] = uint32_t(i);
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
      std::copy_n(state.visible.begin() + begin, n, state.visible.begin() + total);
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

// From the pairs' moments to the projected splat's gradient, and on to the parameters.
void splat_backward(const VolumeInputs& in, int64_t i, const VolumeRecord& r, const float* total, bool dual, const VolumeGradients& v) {
  // exponent (natural) = -0.5 (qxx dx^2 + 2 qxy dx dy + qyy dy^2) in terms of the inverse covariance Q.
  constexpr float kScale = float(2.0 / kLog2E);
  const float qxx = kScale * r.root[0] * r.root[0], qxy = kScale * r.root[0] * r.root[1];
  const float qyy = kScale * (r.root[1] * r.root[1] + r.root[2] * r.root[2]);
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

void reduce_pairs(const VolumeInputs& in, const VolumeState& state, bool dual, const VolumeGradients& v) {
  parallel_chunks(int64_t(state.records.size()), kSplatChunk, [&](int64_t begin, int64_t end) {
    for (int64_t s = begin; s < end; ++s) {
      float total[kFields] = {};
      for (uint32_t slot = state.lists.slot_begin[s]; slot < state.lists.slot_begin[s + 1]; ++slot)
        for (int k = 0; k < kFields; ++k) total[k] += state.pair_gradients[size_t(slot) * kFields + k];
      splat_backward(in, state.visible[state.order[s]], state.records[s], total, dual, v);
    }
  });
}

void forward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, float* radii) {
  const bool dual = in.refl_opacities != nullptr;
  project_all(in, state, radii);
  sort_and_bin(in, state);
  state.transmittance.resize(size_t(in.width) * in.height);
  if (dual) in.depth ? blend<true, true>(in, state, out) : blend<true, false>(in, state, out);
  else in.depth ? blend<false, true>(in, state, out) : blend<false, false>(in, state, out);
}

void backward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, const VolumeImages& v_out,
              const VolumeGradients& v) {
  const bool dual = in.refl_opacities != nullptr;
  if (dual) {
    v_out.depth ? blend_backward<true, true>(in, state, out, v_out) : blend_backward<true, false>(in, state, out, v_out);
  } else {
    v_out.depth ? blend_backward<false, true>(in, state, out, v_out) : blend_backward<false, false>(in, state, out, v_out);
  }
  reduce_pairs(in, state, dual, v);
}

}  // namespace

const VolumeKernels volume_kernels = {forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
