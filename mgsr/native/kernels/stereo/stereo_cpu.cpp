// PatchMatch stereo (Barnes et al. 2009; Bleyer et al. 2011) with normalised cross-correlation.
//
// Each pixel holds a plane. Pixels take over better planes of pixels beside them, and try planes that differ a little
// from their own. Pixels of one colour of a checkerboard read only pixels of the other colour. So rows may be processed
// in any order, on any number of threads, with the same result.
#include "kernels/stereo/stereo.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <iterator>

#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

typedef float Rgba __attribute__((vector_size(16)));
typedef float RgbaPair __attribute__((vector_size(32)));

constexpr float kUnseen = -1;         // the score of a neighbour that does not show the patch
constexpr float kImpossible = -2;     // the score of a plane outside the range, or seen too obliquely
constexpr float kUntried = -3;
constexpr float kGrazing = 0.15f;     // the least cosine between a plane's normal and the pixel's ray
constexpr float kLeastStretch = 0.1f; // the least and the largest area in pixels of a pixel in a neighbour
constexpr float kMostStretch = 10;
constexpr int kMostSamples = 81;
constexpr int kPadded = (kMostSamples + kWidth - 1) / kWidth * kWidth;
constexpr int kTogether = kWidth / 4;  // number of samples whose channels fill a vector
constexpr int kRandomStarts = 4;
constexpr int kRows = 4;              // rows of pixels per task
// The offsets of the pixels whose planes a pixel tries. They are odd, so those pixels have the other colour.
constexpr int kSteps[8][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {3, 0}, {-3, 0}, {0, 3}, {0, -3}};

inline uint32_t mix(uint32_t x) {
  x ^= x >> 16, x *= 0x7feb352dU, x ^= x >> 15, x *= 0x846ca68bU;
  return x ^ (x >> 16);
}

struct Random {
  uint32_t state;
  float next() {  // 0..1
    state = mix(state + 0x9e3779b9U);
    return float(state >> 8) * (1.0f / 16777216.0f);
  }
  float around(float size) { return size * (2 * next() - 1); }
};

// A plane in camera axes: 1 / z = a x + b y + c along the ray (x, y, 1); (a, b, c) is its normal, up to scale.
struct Plane {
  float a = 0, b = 0, c = 0;
  float inverse_depth(float x, float y) const { return a * x + b * y + c; }
  bool operator==(const Plane& other) const { return a == other.a && b == other.b && c == other.c; }
};

Plane plane_through(float x, float y, float inverse_depth, const float* normal) {
  float along = normal[0] * x + normal[1] * y + normal[2];
  if (std::fabs(along) < 0.05f) along = std::copysign(0.05f, along);
  const float scale = inverse_depth / along;
  return {normal[0] * scale, normal[1] * scale, normal[2] * scale};
}

inline Rgba pixel(const StereoView& view, int x, int y) {
  Rgba value;
  std::memcpy(&value, view.pixels + 4 * (size_t(y) * size_t(view.width) + size_t(x)), sizeof(value));
  return value;
}

// Interpolates bilinearly between pixel centres at +0.5; the place must lie between four of them.
inline Rgba sample(const StereoView& view, float x, float y) {
  x -= 0.5f, y -= 0.5f;
  const int left = int(x), top = int(y);
  const float across = x - float(left), down = y - float(top);
  const Rgba a = pixel(view, left, top), b = pixel(view, left + 1, top);
  const Rgba c = pixel(view, left, top + 1), d = pixel(view, left + 1, top + 1);
  const Rgba upper = a + (b - a) * across, lower = c + (d - c) * across;
  return upper + (lower - upper) * down;
}

inline RgbaPair pixel_pair(const float* first) {
  RgbaPair pair;
  std::memcpy(&pair, first, sizeof(pair));
  return pair;
}

// Returns kTogether results of `sample` side by side. offset: the first channels of their upper left pixels. across,
// down:
// the places relative to those, 0..1. row: floats from a pixel to the one below.
inline vfloat samples(const float* pixels, int row, const int* offset, const float* across, const float* down) {
  const auto columns = [&](int k) {  // the left one, then the right one
    const RgbaPair upper = pixel_pair(pixels + offset[k]), lower = pixel_pair(pixels + offset[k] + row);
    return upper + (lower - upper) * down[k];
  };
#if defined(MGSR_ISA_avx512)
  const auto two = [&](int k) {
    return __builtin_shufflevector(columns(k), columns(k + 1), 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  };
  const vfloat front = two(0), back = two(2);
  const vfloat left = __builtin_shufflevector(front, back, 0, 1, 2, 3, 8, 9, 10, 11, 16, 17, 18, 19, 24, 25, 26, 27);
  const vfloat right = __builtin_shufflevector(front, back, 4, 5, 6, 7, 12, 13, 14, 15, 20, 21, 22, 23, 28, 29, 30, 31);
  const __m512i own = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
  return left + (right - left) * (vfloat)_mm512_permutevar_ps(_mm512_broadcast_f32x4(_mm_loadu_ps(across)), own);
#elif defined(MGSR_ISA_avx2)
  const RgbaPair first = columns(0), second = columns(1);
  const vfloat left = __builtin_shufflevector(first, second, 0, 1, 2, 3, 8, 9, 10, 11);
  const vfloat right = __builtin_shufflevector(first, second, 4, 5, 6, 7, 12, 13, 14, 15);
  const float a = across[0], b = across[1];
  return left + (right - left) * vfloat{a, a, a, a, b, b, b, b};
#else
  const RgbaPair pair = columns(0);
  const vfloat left = __builtin_shufflevector(pair, pair, 0, 1, 2, 3);
  const vfloat right = __builtin_shufflevector(pair, pair, 4, 5, 6, 7);
  return left + (right - left) * across[0];
#endif
}

// Of samples side by side: the alpha of each sample in all its channels, and the sum of all samples.
inline vfloat alphas(const vfloat& values) {
  vint places;
  for (int lane = 0; lane < kWidth; ++lane) places[lane] = lane | 3;
  return __builtin_shuffle(values, places);
}

inline Rgba summed(const vfloat& values) {
  Rgba parts[kTogether], total = {};
  std::memcpy(parts, &values, sizeof(values));
  for (const Rgba& part : parts) total += part;
  return total;
}

inline bool holds(const StereoView& view, float x, float y, float margin_x, float margin_y) {
  return x - margin_x >= 0.5f && y - margin_y >= 0.5f && x + margin_x < float(view.width) - 0.5f &&
         y + margin_y < float(view.height) - 0.5f;
}

// The view's samples around a pixel with their bilateral weights, one per channel. They are padded to a multiple of
// kWidth by samples without weight.
struct Patch {
  int count = 0;
  float total = 0;
  float across[kPadded] = {}, down[kPadded] = {};
  alignas(64) float weight[4 * kPadded] = {}, value[4 * kPadded] = {};
};

void take_patch(const StereoView& view, const StereoSettings& settings, int column, int row, Patch& patch) {
  const Rgba middle = pixel(view, column, row);
  const float by_color = -0.5f / (settings.alike * settings.alike), by_space = -0.5f / (settings.reach * settings.reach);
  patch.count = 0, patch.total = 0;
  for (int j = -settings.radius; j <= settings.radius; ++j)
    for (int i = -settings.radius; i <= settings.radius; ++i) {
      const float across = float(i) * settings.spacing, down = float(j) * settings.spacing;
      const float x = float(column) + 0.5f + across, y = float(row) + 0.5f + down;
      if (!holds(view, x, y, 0, 0)) continue;
      const Rgba value = sample(view, x, y), apart = value - middle;
      const float color = apart[0] * apart[0] + apart[1] * apart[1] + apart[2] * apart[2];
      const float weight = value[3] * std::exp(by_color * color + by_space * (across * across + down * down));
      if (weight < 1e-4f) continue;
      const int k = patch.count++;
      const Rgba weights = {weight, weight, weight, weight};
      std::memcpy(patch.value + 4 * k, &value, sizeof(value)), std::memcpy(patch.weight + 4 * k, &weights, sizeof(weights));
      patch.across[k] = across, patch.down[k] = down;
      patch.total += weight;
    }
  const int padded = (patch.count + kWidth - 1) / kWidth * kWidth;
  std::fill(patch.weight + 4 * patch.count, patch.weight + 4 * padded, 0.0f);
  std::fill(patch.across + patch.count, patch.across + padded, 0.0f);
  std::fill(patch.down + patch.count, patch.down + padded, 0.0f);
}

// The mapping from the view to a neighbour: the ray (x, y, 1) of the view at inverse depth i has the homogeneous pixel
// coordinates turned (x, y, 1) + i moved in the neighbour.
struct Neighbour {
  const StereoView* view;
  float turned[9], moved[3];
};

Neighbour beside(const StereoView& view, const StereoView& other) {
  Neighbour to{&other, {}, {}};
  float rotation[9], translation[3];
  for (int i = 0; i < 3; ++i) {
    translation[i] = other.translation[i];
    for (int j = 0; j < 3; ++j) {
      float sum = 0;
      for (int k = 0; k < 3; ++k) sum += other.rotation[3 * i + k] * view.rotation[3 * j + k];
      rotation[3 * i + j] = sum;
      translation[i] -= sum * view.translation[j];
    }
  }
  for (int j = 0; j < 3; ++j) {
    to.turned[j] = other.fx * rotation[j] + other.cx * rotation[6 + j];
    to.turned[3 + j] = other.fy * rotation[3 + j] + other.cy * rotation[6 + j];
    to.turned[6 + j] = rotation[6 + j];
  }
  to.moved[0] = other.fx * translation[0] + other.cx * translation[2];
  to.moved[1] = other.fy * translation[1] + other.cy * translation[2];
  to.moved[2] = translation[2];
  return to;
}

// The image of a patch in a neighbour by a plane: its middle, and the steps of one pixel to the right and one down.
struct Warp {
  bool seen = false;
  float x = 0, y = 0, right[2] = {}, down[2] = {};
};

Warp warp_by(const Plane& plane, const Neighbour& to, const StereoView& view, float x, float y) {
  float h[9];
  for (int i = 0; i < 3; ++i) {
    h[3 * i] = to.turned[3 * i] + to.moved[i] * plane.a;
    h[3 * i + 1] = to.turned[3 * i + 1] + to.moved[i] * plane.b;
    h[3 * i + 2] = to.turned[3 * i + 2] + to.moved[i] * plane.c;
  }
  Warp warp;
  const float depth = h[6] * x + h[7] * y + h[8];
  if (depth <= 1e-6f) return warp;
  warp.x = (h[0] * x + h[1] * y + h[2]) / depth, warp.y = (h[3] * x + h[4] * y + h[5]) / depth;
  const float right = 1 / (depth * view.fx), down = 1 / (depth * view.fy);
  warp.right[0] = (h[0] - warp.x * h[6]) * right, warp.right[1] = (h[3] - warp.y * h[6]) * right;
  warp.down[0] = (h[1] - warp.x * h[7]) * down, warp.down[1] = (h[4] - warp.y * h[7]) * down;
  const float stretch = warp.right[0] * warp.down[1] - warp.right[1] * warp.down[0];
  warp.seen = stretch > kLeastStretch && stretch < kMostStretch;
  return warp;
}

// Returns the correlation of a patch with its image in a neighbour, over all three channels, each less its mean.
// Perspective is taken as linear over so small a patch.
float correlation(const Patch& patch, const Warp& warp, const StereoView& other, const StereoSettings& settings) {
  const float extent = float(settings.radius) * settings.spacing;
  const float wide = extent * (std::fabs(warp.right[0]) + std::fabs(warp.down[0]));
  const float high = extent * (std::fabs(warp.right[1]) + std::fabs(warp.down[1]));
  if (!holds(other, warp.x, warp.y, wide, high)) return kUnseen;
  alignas(64) int offset[kPadded];
  alignas(64) float across[kPadded], down[kPadded];
  for (int k = 0; k < patch.count; k += kWidth) {
    const vfloat right = load(patch.across + k), below = load(patch.down + k);
    const vfloat x = (warp.x - 0.5f) + right * warp.right[0] + below * warp.down[0];
    const vfloat y = (warp.y - 0.5f) + right * warp.right[1] + below * warp.down[1];
    const vint left = __builtin_convertvector(x, vint), top = __builtin_convertvector(y, vint);
    const vint first = 4 * (top * other.width + left);
    std::memcpy(offset + k, &first, sizeof(first));
    store(across + k, x - __builtin_convertvector(left, vfloat)), store(down + k, y - __builtin_convertvector(top, vfloat));
  }
  vfloat weights = {}, own = {}, its = {}, own_own = {}, its_its = {}, own_its = {};
  for (int k = 0; k < patch.count; k += kTogether) {
    const vfloat here = load(patch.value + 4 * k);
    const vfloat there = samples(other.pixels, 4 * other.width, offset + k, across + k, down + k);
    const vfloat weight = load(patch.weight + 4 * k) * alphas(there);
    const vfloat weighed = weight * here, weighed_there = weight * there;
    weights += weight;
    own += weighed, own_own += weighed * here;
    its += weighed_there, its_its += weighed_there * there, own_its += weighed * there;
  }
  const float total = summed(weights)[0];
  if (total < settings.cover * patch.total || total <= 0) return kUnseen;
  const float share = 1 / total;
  const Rgba mean = summed(own) * share, other_mean = summed(its) * share;
  const Rgba variance = summed(own_own) * share - mean * mean;
  const Rgba other_variance = summed(its_its) * share - other_mean * other_mean;
  const Rgba common = summed(own_its) * share - mean * other_mean;
  const float noise = 3 * settings.noise * settings.noise;
  const float product = (variance[0] + variance[1] + variance[2] + noise) *
                        (other_variance[0] + other_variance[1] + other_variance[2] + noise);
  return (common[0] + common[1] + common[2]) / std::sqrt(product);
}

struct Hypothesis {
  Plane plane;
  float score = kUntried;
  int round = -1;  // the round in which the pixel took the plane over; -1 for the start
};

class Matcher {
 public:
  explicit Matcher(const StereoParams& params)
      : p_(params), view_(params.view), settings_(params.settings), found_(size_t(view_.width) * size_t(view_.height)) {
    for (const StereoView& other : params.neighbours) neighbours_.push_back(beside(view_, other));
  }

  void search() {
    for_pixels([&](int at, const Patch& patch) { begin(at, patch); });
    for (int round = 0; round < settings_.rounds; ++round)
      for (int color = 0; color < 2; ++color)
        for_pixels([&](int at, const Patch& patch) {
          propagate(at, patch, round);
          refine(at, patch, round);
        }, color);
    write();
  }

  // Scores the planes of the start, without the prior.
  void judge() {
    std::fill(p_.score, p_.score + found_.size(), kUnseen);
    for_pixels([&](int at, const Patch& patch) {
      if (p_.start_depth[at] > 0) p_.score[at] = std::max(kUnseen, agreement(at, patch, start_plane(at)));
    });
  }

 private:
  float ray_x(int at) const { return (float(at % view_.width) + 0.5f - view_.cx) / view_.fx; }
  float ray_y(int at) const { return (float(at / view_.width) + 0.5f - view_.cy) / view_.fy; }

  // Calls body(pixel, patch) for each pixel that shows the object, of one colour of the checkerboard or of both.
  template <class Body>
  void for_pixels(const Body& body, int color = -1) {
    parallel_chunks(view_.height, kRows, [&](int64_t first, int64_t end) {
      Patch patch;
      for (int row = int(first); row < int(end); ++row)
        for (int column = 0; column < view_.width; ++column) {
          const int at = row * view_.width + column;
          if ((color >= 0 && ((row + column) & 1) != color) || view_.pixels[4 * size_t(at) + 3] <= 0.5f) continue;
          take_patch(view_, settings_, column, row, patch);
          body(at, patch);
        }
    });
  }

  Plane start_plane(int at) const {
    return plane_through(ray_x(at), ray_y(at), 1 / p_.start_depth[at], p_.start_normal + 3 * size_t(at));
  }

  // Returns the mean correlation with the best agreeing neighbours. At least two neighbours must show the patch.
  float agreement(int at, const Patch& patch, const Plane& plane) const {
    const float x = ray_x(at), y = ray_y(at), inverse = plane.inverse_depth(x, y);
    if (!(inverse * p_.farthest >= 1 && inverse * p_.nearest <= 1)) return kImpossible;
    const float normal = plane.a * plane.a + plane.b * plane.b + plane.c * plane.c;
    if (inverse < kGrazing * std::sqrt(normal * (x * x + y * y + 1))) return kImpossible;
    float best[kMostBest];
    const int most = std::min(settings_.best, kMostBest);
    std::fill(best, best + most, kUnseen);
    int seen = 0;
    for (const Neighbour& to : neighbours_) {
      const Warp warp = warp_by(plane, to, view_, x, y);
      float score = warp.seen ? correlation(patch, warp, *to.view, settings_) : kUnseen;
      seen += score > kUnseen;
      for (int k = 0; k < most; ++k)
        if (score > best[k]) std::swap(score, best[k]);
    }
    const int count = std::min(seen, most);
    if (count < std::min(2, most)) return kUnseen;
    float sum = 0;
    for (int k = 0; k < count; ++k) sum += best[k];
    return sum / float(count);
  }

  void offer(int at, const Patch& patch, const Plane& plane, int round, Hypothesis& best) const {
    float score = agreement(at, patch, plane);
    const float start = p_.start_depth[at];
    if (start > 0 && score > kImpossible) {
      const float away = std::fabs(1 / plane.inverse_depth(ray_x(at), ray_y(at)) - start) * view_.fx / start;
      score -= settings_.prior * std::min(1.0f, away / settings_.prior_reach);
    }
    if (score > best.score) best = {plane, score, round};
  }

  void begin(int at, const Patch& patch) {
    Hypothesis best;
    const float x = ray_x(at), y = ray_y(at), start = p_.start_depth[at];
    if (start > 0) offer(at, patch, start_plane(at), -1, best);
    Random random{mix(p_.seed * 7919u + uint32_t(at))};
    const float first = start > 0 ? std::max((1 - settings_.prior_reach / view_.fx) * start, p_.nearest) : p_.nearest;
    for (int k = 0; k < kRandomStarts; ++k) {
      // Squaring puts more tries near the front, where the surface is more often.
      const float share = random.next(), depth = first + (p_.farthest - first) * share * share;
      const float known = start > 0 ? random.next() : 0.0f, ray[3] = {x, y, 1};
      float normal[3];
      for (int i = 0; i < 3; ++i)
        normal[i] = -0.7f * ray[i] + known * p_.start_normal[3 * size_t(at) + size_t(i)] + random.around(0.3f);
      offer(at, patch, plane_through(x, y, 1 / depth, normal), -1, best);
    }
    found_[size_t(at)] = best;
  }

  // Offers a pixel the planes of pixels beside it, which have the other colour. A plane is offered only once: scores
  // only rise, so a plane that lost would lose again. Pixels of colour 1 are offered planes that colour 0 took over in
  // this round; pixels of colour 0 are offered those that colour 1 took over in the round before.
  void propagate(int at, const Patch& patch, int round) {
    const int column = at % view_.width, row = at / view_.width, since = round - 1 + ((row + column) & 1);
    Hypothesis best = found_[size_t(at)];
    Plane offered[1 + std::size(kSteps)] = {best.plane};
    int count = 1;
    for (const auto& step : kSteps) {
      const int x = column + step[0], y = row + step[1];
      if (x < 0 || y < 0 || x >= view_.width || y >= view_.height) continue;
      const Hypothesis& other = found_[size_t(y) * size_t(view_.width) + size_t(x)];
      if (other.score <= kUnseen || (round > 0 && other.round < since)) continue;
      if (std::find(offered, offered + count, other.plane) != offered + count) continue;
      offered[count++] = other.plane;
      offer(at, patch, other.plane, round, best);
    }
    found_[size_t(at)] = best;
  }

  // Varies depth and normal, each alone and both together, less in later rounds.
  void refine(int at, const Patch& patch, int round) {
    Random random{mix(p_.seed * 7919u + uint32_t(at) * 31u + uint32_t(round) * 1000003u + 17u)};
    const float far = settings_.search / view_.fx * std::pow(0.5f, float(round)), tilt = 0.5f * std::pow(0.6f, float(round));
    const float tries[4][2] = {{far, 0}, {0, tilt}, {far, tilt}, {0.3f * far, 0.3f * tilt}};
    Hypothesis best = found_[size_t(at)];
    if (best.score <= kImpossible) return;
    const float x = ray_x(at), y = ray_y(at);
    for (const auto& size : tries) {
      const Plane plane = best.plane;
      const float length = std::sqrt(plane.a * plane.a + plane.b * plane.b + plane.c * plane.c) + 1e-12f;
      const float inverse = plane.inverse_depth(x, y) * (1 + random.around(size[0]));
      const float normal[3] = {plane.a / length + random.around(size[1]), plane.b / length + random.around(size[1]),
                               plane.c / length + random.around(size[1])};
      offer(at, patch, plane_through(x, y, inverse, normal), round, best);
    }
    found_[size_t(at)] = best;
  }

  void write() const {
    for (size_t at = 0; at < found_.size(); ++at) {
      const Hypothesis& found = found_[at];
      const bool known = found.score > kUnseen;
      const Plane& plane = found.plane;
      const float length = std::sqrt(plane.a * plane.a + plane.b * plane.b + plane.c * plane.c) + 1e-12f;
      p_.depth[at] = known ? 1 / plane.inverse_depth(ray_x(int(at)), ray_y(int(at))) : 0;
      p_.score[at] = known ? found.score : kUnseen;
      const float normal[3] = {plane.a, plane.b, plane.c};
      for (size_t i = 0; i < 3; ++i) p_.normal[3 * at + i] = known ? -normal[i] / length : 0;
    }
  }

  static constexpr int kMostBest = 8;

  const StereoParams& p_;
  const StereoView& view_;
  const StereoSettings& settings_;
  std::vector<Neighbour> neighbours_;
  std::vector<Hypothesis> found_;
};

void search(const StereoParams& params) { Matcher(params).search(); }
void judge(const StereoParams& params) { Matcher(params).judge(); }

}  // namespace

const StereoTable stereo_table = {search, judge};

}  // namespace MGSR_ISA
}  // namespace mgsr
