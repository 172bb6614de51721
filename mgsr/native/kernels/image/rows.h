// The division of rows and columns into parts of nearly equal size.
#pragma once

#include <cstdint>

namespace mgsr {
namespace MGSR_ISA {
namespace {

inline int cut(int begin, int end, int index, int count) { return begin + int(int64_t(end - begin) * index / count); }

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
