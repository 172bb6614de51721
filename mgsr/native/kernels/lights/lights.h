// Reflected light and flash light on rendered images, on the CPU, before they are compared.
#pragma once

#include <cstdint>

namespace mgsr {

// color = transmitted + weight * reflected, reflected = own + environment.
struct ReflectionParams {
  int64_t pixels = 0;
  const float *transmitted = nullptr, *weight = nullptr;   // [pixels, 3], [pixels]
  const float *own = nullptr, *environment = nullptr;      // [pixels, 3] each, or null for 0
  float *color = nullptr, *reflected = nullptr;            // [pixels, 3]
};

struct ReflectionVjpParams {
  int64_t pixels = 0;
  const float *v_color = nullptr, *reflected = nullptr, *weight = nullptr;
  const float *add_transmitted = nullptr, *add_weight = nullptr, *add_own = nullptr;  // further gradients, or null
  float *v_transmitted = nullptr, *v_weight = nullptr, *v_own = nullptr;  // [pixels, 3], but [pixels] for the weight
  float* v_environment = nullptr;                                         // [pixels, 3]
};

// image = unlit + (shading - 1) * (unlit + alpha * (background + offset) - background).
struct LightUpParams {
  int64_t pixels = 0;
  const float *unlit = nullptr, *alpha = nullptr, *background = nullptr, *shading = nullptr;  // the background: [3]
  float offset = 0;
  float* image = nullptr;  // [pixels, 3]
};

struct LightUpVjpParams {
  int64_t pixels = 0;
  const float *v_image = nullptr, *background = nullptr, *shading = nullptr;
  float offset = 0;
  const float* add_alpha = nullptr;             // [pixels], or null
  float *v_unlit = nullptr, *v_alpha = nullptr;  // [pixels, 3], [pixels]
};

struct LightsTable {
  void (*reflection)(const ReflectionParams&);
  void (*reflection_vjp)(const ReflectionVjpParams&);
  void (*light_up)(const LightUpParams&);
  void (*light_up_vjp)(const LightUpVjpParams&);
};

namespace avx512 { extern const LightsTable lights_table; }
namespace avx2 { extern const LightsTable lights_table; }
namespace baseline { extern const LightsTable lights_table; }

}  // namespace mgsr
