// The integers of a fixed width, also for NVRTC, which has no <cstdint>.
#pragma once

#if defined(__CUDACC_RTC__)
using int16_t = short;
using int32_t = int;
using int64_t = long long;
using uint32_t = unsigned;
#else
#include <cstdint>
#endif
