// 3D Gaussians on the CPU.
//
// Forward: project and cull every splat and find the tiles it touches (chunks of splats over the threads); sort the
// visible ones by depth; lay out the tiles' lists; blend tile by tile (one tile is one piece of work). Within a tile each
// 4x4 sub-tile is blended on its own, its 16 pixels in registers, over the entries of the tile whose mask names it.
// Backward: the same walk front to back leaves the gradient of each (splat, tile) pair in the pair's own slot; a splat's
// slots are then added in tile order, so the result doesn't depend on the number of threads.
#include "kernels/gaussians/gaussians.h"

#include "kernels/gaussians/backward_cpu.h"
#include "kernels/gaussians/blending_cpu.h"
#include "kernels/gaussians/projection_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

void forward(const GaussianInputs& in, GaussianState& state, const GaussianImages& out, float* radii) {
  const bool dual = out.reflected != nullptr;  // of no splats at all, the inputs have no address either
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
