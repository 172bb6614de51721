// 3D Gaussians on the CPU.
//
// Forward: project and cull every splat and find the tiles it touches (chunks of splats over the threads); sort the
// visible ones by depth; lay out the tiles' lists; blend tile by tile (one tile is one piece of work). Within a tile each
// 4x4 sub-tile is blended on its own, its 16 pixels in registers, over the entries of the tile whose mask names it.
// Backward: the same walk front to back leaves the gradient of each (splat, tile) pair in the pair's own slot; a splat's
// slots are then added in tile order, so the result doesn't depend on the number of threads.
#include "kernels/volumes/volumes.h"

#include "kernels/volumes/backward_cpu.h"
#include "kernels/volumes/blending_cpu.h"
#include "kernels/volumes/projection_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

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
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    const float* pairs = state.pair_gradients.data() + size_t(state.lists.chunk_slots[begin / kSplatChunk]) * kFields;
    for (int64_t i = begin; i < end; ++i) {
      if (state.depths[i] < 0) continue;
      float total[kFields] = {};
      for (uint32_t slot = state.lists.spans[i].begin; slot < state.lists.spans[i].end; ++slot)
        for (int k = 0; k < kFields; ++k) total[k] += pairs[size_t(slot) * kFields + k];
      splat_backward(in, i, state.records[i], total, dual, v);
    }
  });
}

void forward(const VolumeInputs& in, VolumeState& state, const VolumeImages& out, float* radii) {
  const bool dual = in.refl_opacities != nullptr;
  project_all(in, state, radii);
  sort_by_depth(state.sort, state.depths);
  lay_out_lists(state.lists, state.sort.order);
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
