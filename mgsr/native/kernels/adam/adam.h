// The Adam family on the CPU.
#pragma once

#include "kernels/adam/group.h"

namespace mgsr {

struct AdamTable {
  void (*update)(const AdamGroup* groups, int count);
};

namespace avx512 { extern const AdamTable adam_table; }
namespace avx2 { extern const AdamTable adam_table; }
namespace baseline { extern const AdamTable adam_table; }

}  // namespace mgsr
