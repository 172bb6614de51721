// Structural similarity of one window (Wang et al. 2004, with C1 = 0.01^2 and C2 = 0.03^2 for values in 0..1).
// T is float, double or a vector of floats.
#pragma once

#include "math/macros.h"

namespace mgsr {

// The Gaussian window: 11 taps, sigma 1.5, sum 1. Taps 0..5; the others mirror them.
constexpr int kSsimRadius = 5;
constexpr float kSsimTaps[kSsimRadius + 1] = {0.0010283801f, 0.0075987581f, 0.0360007721f,
                                              0.1093606895f, 0.2130055377f, 0.2660117249f};

// The weighted means over a window of a, b, a^2 + b^2 and a b.
template <class T>
struct SsimMoments {
  T a, b, squares, product;
};

template <class T>
MGSR_HD T ssim(const SsimMoments<T>& m) {
  const T both = m.a * m.b, own = m.a * m.a + m.b * m.b;
  return (2.0f * both + 1e-4f) * (2.0f * (m.product - both) + 9e-4f) / ((own + 1e-4f) * (m.squares - own + 9e-4f));
}

// Writes the gradients of the moments, given the gradient v of ssim. Returns ssim.
template <class T>
MGSR_HD T ssim_vjp(const SsimMoments<T>& m, T v, SsimMoments<T>& v_m) {
  const T both = m.a * m.b, own = m.a * m.a + m.b * m.b;
  const T p = 2.0f * both + 1e-4f, q = 2.0f * (m.product - both) + 9e-4f;
  const T r = own + 1e-4f, s = m.squares - own + 9e-4f;
  const T inverse = (T{} + 1.0f) / (r * s), value = p * q * inverse;
  const T by_p = q * inverse, by_q = p * inverse, by_r = -value * s * inverse, by_s = -value * r * inverse;
  const T cross = 2.0f * v * (by_p - by_q), along = 2.0f * v * (by_r - by_s);
  v_m.a = cross * m.b + along * m.a;
  v_m.b = cross * m.a + along * m.b;
  v_m.squares = v * by_s;
  v_m.product = 2.0f * v * by_q;
  return value;
}

}  // namespace mgsr
