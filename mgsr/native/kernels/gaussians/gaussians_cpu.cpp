// 3D Gaussians on the CPU.
//
// Forward: project and cull every splat and find the tiles it touches, in chunks of splats over the threads. Sort the
// visible splats by depth, and lay out the tiles' lists. Blend tile by tile; one tile is one task. Within a tile, each
// 4x4 sub-tile is blended on its own, with its 16 pixels in registers, over the entries whose mask names it.
// Backward: the same walk, front to back, writes the gradient of each (splat, tile) pair to the pair's own slot. Then a
// splat's slots are added in tile order, so the result does not depend on the number of threads.
#include "kernels/gaussians/gaussians.h"

#include "kernels/gaussians/backward_cpu.h"
#include "kernels/gaussians/blending_cpu.h"
#include "kernels/gaussians/projection_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

void forward(const GaussianInputs& in, GaussianState& state, const GaussianImages& out, float* radii) {
  const bool dual = out.reflected != nullptr;  // the inputs can't tell, as they have no address if there are no splats
  project_all(in, state, radii);
  sort_by_depth(state.sort, state.depths);
  lay_out_lists(state.lists, state.sort.order);
  state.transmittance.resize(size_t(in.width) * in.height);
  if (dual) in.depth ? blend<true, true>(in, state, out) : blend<true, false>(in, state, out);
  else in.depth ? blend<false, true>(in, state, out) : blend<false, false>(in, state, out);
}

void backward(const GaussianInputs& in, GaussianState& state, const GaussianImages& out, const GaussianImages& v_out,
              const GaussianGradients& v) {
  const bool dual = out.reflected != nullptr;
  if (dual) {
    v_out.depth ? blend_backward<true, true>(in, state, out, v_out) : blend_backward<true, false>(in, state, out, v_out);
  } else {
    v_out.depth ? blend_backward<false, true>(in, state, out, v_out) : blend_backward<false, false>(in, state, out, v_out);
  }
  reduce_pairs(in, state, v);
}

}  // namespace

const GaussianKernels gaussian_kernels = {forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
