// The parts of losses outside the image family on the CPU: the target of a view, the covered pixels, and terms of
// single numbers. Each term writes its derivatives, not yet scaled, and returns its sum.
#pragma once

#include <cstdint>

namespace mgsr {

// Composites a photograph in bytes on a colour.
struct TargetParams {
  int64_t pixels = 0;
  const uint8_t* image = nullptr;      // [pixels, 3], straight colours
  const uint8_t* mask = nullptr;       // [pixels]
  const bool* off_edge = nullptr;      // [pixels], or null
  const float* background = nullptr;   // [3]
  float* color = nullptr;              // [pixels, 3]
  float* alpha = nullptr;              // [pixels] 0..1
  float* weights = nullptr;            // [pixels], off_edge as floats; required with it
};

// Writes 1 where both alphas are over a half, else 0.
struct CoveredParams {
  int64_t pixels = 0;
  const float* alpha = nullptr;
  const float* mask = nullptr;  // or null for 1 everywhere
  float* covered = nullptr;
};

// The difference of two silhouettes: absolute, or the cross entropy with alpha clamped to kLeastAlpha from 0 and 1.
struct SilhouetteParams {
  int64_t pixels = 0;
  const float* alpha = nullptr;
  const float* mask = nullptr;
  const float* weights = nullptr;  // multiplies both silhouettes; or null for 1 everywhere
  bool entropy = false;
  float* v_alpha = nullptr;        // [pixels], or null
};

// The squares of (a - b) * first * second - offset.
struct SquaresParams {
  int64_t count = 0;
  const float* a = nullptr;
  const float *b = nullptr, *first = nullptr, *second = nullptr;  // each may be null, which means 0, 1 and 1 everywhere
  float offset = 0;
  float* differences = nullptr;  // [count]
};

// The sum of weight times colour.
struct ProductParams {
  int64_t pixels = 0;
  const float* weight = nullptr;
  const float* color = nullptr;  // [pixels, 3]
  float* v_weight = nullptr;     // [pixels], the sum over the colour's channels; the derivative to the colour is the weight
};

// The squared steps between neighbouring texels of square maps.
struct StepsParams {
  int maps = 0, side = 0, channels = 0;
  const float* values = nullptr;  // [maps, side, side, channels]
  float* v_values = nullptr;      // the same
};

constexpr int kMostChannels = 16;  // of an image whose slopes hold for all channels

// A term's part of an image's gradient: scale * slopes.
struct GradientPart {
  const float* slopes = nullptr;  // [pixels, channels], or [pixels] where they hold for all channels
  bool all_channels = false;
  float scale = 0;
};

struct GradientParams {
  int64_t pixels = 0;
  int channels = 1;
  const GradientPart* parts = nullptr;
  int count = 0;         // of the parts
  float* out = nullptr;  // [pixels, channels]
};

struct TermsTable {
  void (*target)(const TargetParams&);
  void (*covered)(const CoveredParams&);
  double (*silhouette)(const SilhouetteParams&);
  double (*squares)(const SquaresParams&);
  double (*product)(const ProductParams&);
  double (*steps)(const StepsParams&);
  void (*gradient)(const GradientParams&);
};

namespace avx512 { extern const TermsTable terms_table; }
namespace avx2 { extern const TermsTable terms_table; }
namespace baseline { extern const TermsTable terms_table; }

}  // namespace mgsr
