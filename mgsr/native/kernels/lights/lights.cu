// Adds reflected light to rendered images, and lights them by a flash, before they are compared. A thread is a pixel,
// and its gradients depend on no other pixel.
#include "kernels/common/cuda.h"
#include "math/light.h"

namespace mgsr {

constexpr int kLightThreads = 256;

// color = transmitted + weight * reflected, reflected = own + mirrored.
struct ReflectionParams {
  int64_t pixels;
  const float *transmitted, *weight;  // [pixels, 3], [pixels]
  const float *own, *mirrored;        // [pixels, 3] each, or null for 0
  float *color, *reflected;           // [pixels, 3]
};

struct ReflectionVjpParams {
  int64_t pixels;
  const float *v_color, *reflected, *weight;
  const float *add_transmitted, *add_weight, *add_own;         // further gradients to add to each, or null
  float *v_transmitted, *v_weight, *v_own, *v_mirrored;  // [pixels, 3], but [pixels] for the weight
};

// image = unlit + (shading - 1) * (unlit + alpha * (background + offset) - background).
struct LightUpParams {
  int64_t pixels;
  const float *unlit, *alpha, *background, *shading;  // [pixels, 3], [pixels], [3], [pixels]
  float offset;
  float* image;  // [pixels, 3]
};

struct LightUpVjpParams {
  int64_t pixels;
  const float *v_image, *background, *shading;
  float offset;
  const float* add_alpha;   // [pixels], or null
  float *v_unlit, *v_alpha;  // [pixels, 3], [pixels]
};

__device__ inline int64_t light_pixel() { return int64_t(blockIdx.x) * kLightThreads + threadIdx.x; }

}  // namespace mgsr

MGSR_KERNEL(lights_reflection, mgsr::ReflectionParams, mgsr::kLightThreads) {
  const int64_t i = mgsr::light_pixel();
  if (i >= p.pixels) return;
  for (int64_t at = 3 * i; at < 3 * i + 3; ++at) {
    const float reflected = (p.own ? p.own[at] : 0.0f) + (p.mirrored ? p.mirrored[at] : 0.0f);
    p.reflected[at] = reflected;
    p.color[at] = p.transmitted[at] + p.weight[i] * reflected;
  }
}

MGSR_KERNEL(lights_reflection_vjp, mgsr::ReflectionVjpParams, mgsr::kLightThreads) {
  const int64_t i = mgsr::light_pixel();
  if (i >= p.pixels) return;
  float v_weight = 0.0f;
  for (int64_t at = 3 * i; at < 3 * i + 3; ++at) {
    const float v_color = p.v_color[at], v_reflected = v_color * p.weight[i];
    p.v_transmitted[at] = v_color + (p.add_transmitted ? p.add_transmitted[at] : 0.0f);
    p.v_own[at] = v_reflected + (p.add_own ? p.add_own[at] : 0.0f);
    p.v_mirrored[at] = v_reflected;
    v_weight += v_color * p.reflected[at];
  }
  p.v_weight[i] = v_weight + (p.add_weight ? p.add_weight[i] : 0.0f);
}

MGSR_KERNEL(lights_light_up, mgsr::LightUpParams, mgsr::kLightThreads) {
  const int64_t i = mgsr::light_pixel();
  if (i >= p.pixels) return;
  for (int c = 0; c < 3; ++c) {
    p.image[3 * i + c] = mgsr::lit(p.unlit[3 * i + c], p.alpha[i], p.background[c], p.shading[i], p.offset);
  }
}

MGSR_KERNEL(lights_light_up_vjp, mgsr::LightUpVjpParams, mgsr::kLightThreads) {
  const int64_t i = mgsr::light_pixel();
  if (i >= p.pixels) return;
  float v_alpha = 0.0f;
  for (int c = 0; c < 3; ++c) {
    p.v_unlit[3 * i + c] = p.v_image[3 * i + c] * p.shading[i];
    v_alpha += p.v_image[3 * i + c] * mgsr::lit_by_alpha(p.background[c], p.offset);
  }
  p.v_alpha[i] = (p.shading[i] - 1.0f) * v_alpha + (p.add_alpha ? p.add_alpha[i] : 0.0f);
}
