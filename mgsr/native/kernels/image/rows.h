// The division of rows and columns into parts of nearly equal size.
#pragma once

#include <cstdint>

namespace mgsr {
namespace MGSR_ISA {
namespace {

inline int cut(int size, int index, int count) { return int(int64_t(size) * index / count); }

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
