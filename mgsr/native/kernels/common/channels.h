// Numbers of pixels, repeated for every channel of an image whose channels are interleaved. Loops over all numbers of an
// image then have a form that the compiler vectorises.
#pragma once

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kStrip = 512;  // pixels whose repeated numbers are held at a time

// Repeats each of n values for every channel.
inline void repeat(const float* values, int n, int channels, float* out) {
  for (int i = 0; i < n; ++i)
    for (int c = 0; c < channels; ++c) out[i * channels + c] = values[i];
}

}  // namespace
}  // namespace MGSR_ISA
}  // namespace mgsr
