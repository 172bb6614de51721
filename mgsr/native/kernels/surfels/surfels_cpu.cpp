// 2D surfels on the CPU.
//
// Forward: project and cull every splat and find the tiles it touches, in chunks of splats over the threads. Sort the
// visible splats by depth, and lay out the tiles' lists. Blend tile by tile; one tile is one task. Within a tile, each
// 4x4 sub-tile is blended on its own, with its 16 pixels in registers, over the entries whose mask names it.
// Backward: the same walk, front to back, writes the gradient of each (splat, tile) pair to the pair's own slot. Then a
// splat's slots are added in tile order, so the result does not depend on the number of threads.
#include "kernels/surfels/surfels.h"

#include "kernels/surfels/backward_cpu.h"
#include "kernels/surfels/blending_cpu.h"
#include "kernels/surfels/projection_cpu.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

void forward(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, float* radii) {
  project_all(in, state, radii);
  sort_by_depth(state.sort, state.depths);
  lay_out_lists(state.lists, state.sort.order);
  const size_t pixels = size_t(in.width) * in.height;
  state.transmittance.resize(pixels);
  if (out.distortion) state.moments.resize(2 * pixels);
  out.distortion ? blend<true>(in, state, out) : blend<false>(in, state, out);
}

void backward(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, const SurfelImages& v_out,
              const SurfelGradients& v) {
  v_out.distortion ? blend_backward<true>(in, state, out, v_out) : blend_backward<false>(in, state, out, v_out);
  reduce_pairs(in, state, v);
}

}  // namespace

const SurfelKernels surfel_kernels = {forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
