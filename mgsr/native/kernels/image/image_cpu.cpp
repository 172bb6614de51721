// The image family's table for one variant.
#include "kernels/image/depth_normals_cpu.h"
#include "kernels/image/loss_cpu.h"
#include "kernels/image/tv_cpu.h"

namespace mgsr {
namespace MGSR_ISA {

extern const ImageTable image_table{image_loss, tv, depth_normals, depth_normals_vjp};

}  // namespace MGSR_ISA
}  // namespace mgsr
