// Strips of pixels are tasks. The gradients of a pixel depend on no other pixel.
#include "kernels/lights/lights.h"

#include "kernels/common/channels.h"
#include "kernels/common/parallel.h"
#include "math/light.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int kFloats = 3 * kStrip;

// Calls body(first pixel, number of pixels) for strips of all pixels.
template <class Body>
void for_strips(int64_t pixels, const Body& body) {
  parallel_chunks(pixels, kStrip, [&](int64_t begin, int64_t end) { body(begin, int(end - begin)); });
}

// Returns a strip of an image with three channels; null stays null.
inline const float* strip(const float* image, int64_t begin) { return image ? image + 3 * begin : nullptr; }

// Writes own + added to out, which may lack `added`.
inline void sum_of(const float* own, const float* added, int n, float* out) {
  if (added)
    for (int i = 0; i < n; ++i) out[i] = own[i] + added[i];
  else
    for (int i = 0; i < n; ++i) out[i] = own[i];
}

void reflection(const ReflectionParams& p) {
  for_strips(p.pixels, [&](int64_t begin, int n) {
    float weight[kFloats];
    repeat(p.weight + begin, n, 3, weight);
    const float *own = strip(p.own, begin), *environment = strip(p.environment, begin);
    const float* transmitted = p.transmitted + 3 * begin;
    float *reflected = p.reflected + 3 * begin, *color = p.color + 3 * begin;
    sum_of(own ? own : environment, own ? environment : nullptr, 3 * n, reflected);
    for (int i = 0; i < 3 * n; ++i) color[i] = transmitted[i] + weight[i] * reflected[i];
  });
}

void reflection_vjp(const ReflectionVjpParams& p) {
  for_strips(p.pixels, [&](int64_t begin, int n) {
    float weight[kFloats], products[kFloats];
    repeat(p.weight + begin, n, 3, weight);
    const float *v_color = p.v_color + 3 * begin, *reflected = p.reflected + 3 * begin;
    float *v_environment = p.v_environment + 3 * begin, *v_weight = p.v_weight + begin;
    for (int i = 0; i < 3 * n; ++i) {
      v_environment[i] = v_color[i] * weight[i];
      products[i] = v_color[i] * reflected[i];
    }
    sum_of(v_color, strip(p.add_transmitted, begin), 3 * n, p.v_transmitted + 3 * begin);
    sum_of(v_environment, strip(p.add_own, begin), 3 * n, p.v_own + 3 * begin);
    for (int i = 0; i < n; ++i) v_weight[i] = products[3 * i] + products[3 * i + 1] + products[3 * i + 2];
    if (p.add_weight)
      for (int i = 0; i < n; ++i) v_weight[i] += p.add_weight[begin + i];
  });
}

void light_up(const LightUpParams& p) {
  float behind[kFloats];
  for (int i = 0; i < kFloats; ++i) behind[i] = p.background[i % 3];
  for_strips(p.pixels, [&](int64_t begin, int n) {
    float alpha[kFloats], shading[kFloats];
    repeat(p.alpha + begin, n, 3, alpha);
    repeat(p.shading + begin, n, 3, shading);
    const float* unlit = p.unlit + 3 * begin;
    float* image = p.image + 3 * begin;
    for (int i = 0; i < 3 * n; ++i) image[i] = lit(unlit[i], alpha[i], behind[i], shading[i], p.offset);
  });
}

void light_up_vjp(const LightUpVjpParams& p) {
  for_strips(p.pixels, [&](int64_t begin, int n) {
    float shading[kFloats];
    repeat(p.shading + begin, n, 3, shading);
    const float* v_image = p.v_image + 3 * begin;
    float *v_unlit = p.v_unlit + 3 * begin, *v_alpha = p.v_alpha + begin;
    for (int i = 0; i < 3 * n; ++i) v_unlit[i] = v_image[i] * shading[i];
    const float red = lit_by_alpha(p.background[0], p.offset), green = lit_by_alpha(p.background[1], p.offset);
    const float blue = lit_by_alpha(p.background[2], p.offset);
    for (int i = 0; i < n; ++i) {
      const float sum = v_image[3 * i] * red + v_image[3 * i + 1] * green + v_image[3 * i + 2] * blue;
      v_alpha[i] = (p.shading[begin + i] - 1) * sum;
    }
    if (p.add_alpha)
      for (int i = 0; i < n; ++i) v_alpha[i] += p.add_alpha[begin + i];
  });
}

}  // namespace

extern const LightsTable lights_table{reflection, reflection_vjp, light_up, light_up_vjp};

}  // namespace MGSR_ISA
}  // namespace mgsr
