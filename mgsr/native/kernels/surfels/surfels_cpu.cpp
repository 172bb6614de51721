// 2D surfels on the CPU.
//
// Forward: project and cull every splat (chunks of splats over the threads); sort the visible ones by depth; fill the
// tile lists; blend tile by tile (one tile is one piece of work). Within a tile each 4x4 sub-tile is blended on its
// own, its 16 pixels in registers, over the entries of the tile whose mask names it.
// Backward: the same walk front to back. With q = v_out . (what the splat adds), the gradient to alpha_i is
// T_i q_i - (everything behind i) / (1 - alpha_i), and "everything behind" is the pixel's total less a running sum: one
// scalar however many outputs there are. A splat's footprint depends on nine numbers (centre, L, g, depth); over the
// pixels their gradients need nine sums, since L enters only by its product with three second moments. With opacity,
// colour and normal a (splat, tile) pair has 16 sums, one cache line, kept in the pair's own slot; a splat's slots are
// then added in tile order, so the result doesn't depend on the number of threads.
#include "kernels/surfels/surfels.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "kernels/common/blending.h"
#include "kernels/common/pairs.h"
#include "kernels/common/simd.h"
#include "kernels/common/subtiles.h"
#include "math/surfel.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr float kLog2E = 1.4426950408889634f, kLn2 = 0.69314718056f;
constexpr float kExponentScale = 0.5f * kLog2E;       // 2^-(this * (u^2 + v^2)) is the weight ...
constexpr float kRootExponentScale = 0.84932180028f;  // ... so that this, times L, leaves a plain square
constexpr float kNever = 1e6f;                        // L of an edge-on splat: its disk counts nowhere

// Gradient of one (splat, tile) pair, as sums over pixels. kXX, kXY, kYY: second moments of the exponent's gradient /
// w^2, which give L's. kSlopeX, kSlopeY, kW: w's gradient times dx, dy, 1. kMeanX, kMeanY: first moments where the splat
// is plain, else the centre's gradient itself. kDepth, kOpacity: times the depth, times the opacity.
enum PairField { kXX, kXY, kYY, kSlopeX, kSlopeY, kMeanX, kMeanY, kW, kDepth, kOpacity, kColor, kNormal = kColor + 3 };

// A splat's footprint on the image: where its disk is strong enough to count, and the circle of its low-pass.
struct SurfelBounds {
  Ellipse disk;
  float x, y, radius;  // radius 0 where the disk is stronger than the low-pass everywhere
  bool clipped;        // the disk reaches behind the near plane

  PixelBox box() const {
    const PixelBox b = disk.box();
    return {std::min(b.x0, x - radius), std::max(b.x1, x + radius), std::min(b.y0, y - radius), std::max(b.y1, y + radius)};
  }

  Intervals cut(vfloat y0, vfloat y1) const {
    Intervals c = disk.cut(y0, y1);
    if (radius == 0.0f) return c;
    const vfloat dy = max(max(y0 - y, y - y1), vfloat{}), half2 = radius * radius - dy * dy;
    const vfloat half = sqrt(max(half2, vfloat{}));
    const vint on_circle = half2 > 0.0f;
    c.x0 = select(on_circle, select(c.any, min(c.x0, x - half), x - half), c.x0);
    c.x1 = select(on_circle, select(c.any, max(c.x1, x + half), x + half), c.x1);
    c.any |= on_circle;
    return c;
  }
};

Ellipse ellipse_of_box(const PixelBox& b) {
  const float hx = 0.5f * (b.x1 - b.x0), hy = 0.5f * (b.y1 - b.y0);
  return {{b.x0 + hx, b.y0 + hy, hx, hy, 0.0f, 0.0f, hx * hx, 0.0f}};
}

// The image of that part of the disk's bounding square (half side r in u and v) that lies beyond `near`.
PixelBox clipped_square(const Camera<float>& cam, const SurfelFrame<float>& f, const float scale[2], float r, float near) {
  PixelBox box = {1e9f, -1e9f, 1e9f, -1e9f};
  const auto add = [&](const float p[3]) {
    const float x = cam.fx * p[0] / p[2] + cam.cx, y = cam.fy * p[1] / p[2] + cam.cy;
    box = {std::min(box.x0, x), std::max(box.x1, x), std::min(box.y0, y), std::max(box.y1, y)};
  };
  constexpr float kU[5] = {-1, 1, 1, -1, -1}, kV[5] = {-1, -1, 1, 1, -1};
  float last[3];
  for (int corner = 0; corner < 5; ++corner) {
    float p[3];
    for (int i = 0; i < 3; ++i) p[i] = f.p[i] + r * (kU[corner] * scale[0] * f.tu[i] + kV[corner] * scale[1] * f.tv[i]);
    if (corner > 0 && (p[2] > near) != (last[2] > near)) {
      const float t = (near - last[2]) / (p[2] - last[2]);
      const float cut[3] = {last[0] + t * (p[0] - last[0]), last[1] + t * (p[1] - last[1]), near};
      add(cut);
    }
    if (p[2] > near) add(p);
    std::memcpy(last, p, sizeof(p));
  }
  return box;
}

// The radius of the low-pass circle; 0 when within it the disk's weight is nowhere less than the low-pass's.
float low_pass_radius(const ProjectedSurfel<float>& s, bool edge_on, float log_strength, float low_pass) {
  const float radius = std::sqrt(2.0f * low_pass * log_strength);
  const float trace = s.L[0] * s.L[0] + s.L[1] * s.L[1] + s.L[2] * s.L[2] + s.L[3] * s.L[3];
  const float det = s.L[0] * s.L[3] - s.L[1] * s.L[2];
  const float largest = 0.5f * (trace + std::sqrt(std::max(trace * trace - 4 * det * det, 0.0f)));
  const float w = 1.0f - radius * std::sqrt(s.g[0] * s.g[0] + s.g[1] * s.g[1]);
  return !edge_on && w > 0 && largest * low_pass < w * w ? 0.0f : radius;
}

SurfelBounds surfel_bounds(const SurfelInputs& in, const SurfelFrame<float>& f, const ProjectedSurfel<float>& s,
                           const float scale[2], float opacity) {
  const float log_strength = std::log(opacity / kMinAlpha), r2 = 2.0f * log_strength;
  SurfelBounds b = {{}, s.x, s.y, low_pass_radius(s, f.edge_on, log_strength, in.low_pass), false};
  SurfelOutline<float> o;
  if (surfel_outline(in.camera, f, scale, r2, in.near, o)) {
    b.disk = {EllipseForm<float>::make(s.x + o.x, s.y + o.y, o.cxx, o.cxy, o.cyy, 1.0f)};
    b.disk.w2 += 1e-6f * o.cxx;  // the rounding of a thin ellipse's determinant
  } else {
    b.clipped = true;
    const float w = float(in.width), h = float(in.height);
    const PixelBox box = clipped_square(in.camera, f, scale, std::sqrt(r2), in.near);
    // In this order a NaN, from an overflow, gives the bound.
    b.disk = ellipse_of_box({std::max(-w, box.x0), std::min(2 * w, box.x1), std::max(-h, box.y0), std::min(2 * h, box.y1)});
  }
  return b;
}

// Fills the record and bounds of splat i; false when it can't be seen or isn't finite.
bool project_one(const SurfelInputs& in, int64_t i, SurfelRecord& record, SurfelBounds& bounds) {
  const float opacity = in.opacities[i], *scale = in.scales + 2 * i;
  SurfelFrame<float> f;
  surfel_frame(in.camera, in.means + 3 * i, in.quats + 4 * i, scale, f);
  if (!(f.p[2] > in.near) || !(opacity >= kMinAlpha) || !(scale[0] > 0) || !(scale[1] > 0)) return false;
  const ProjectedSurfel<float> s = project_surfel(in.camera, f);
  record = {s.x, s.y, {}, {s.g[0], s.g[1]}, s.depth, std::log2(opacity), {}, {s.normal[0], s.normal[1], s.normal[2]}};
  for (int k = 0; k < 4; ++k) record.L[k] = kRootExponentScale * s.L[k];
  if (f.edge_on) record.L[0] = record.L[3] = kNever;
  std::memcpy(record.color, in.colors + 3 * i, sizeof(record.color));
  if (!all_finite(&record.x, 16) || !all_finite(scale, 2)) return false;
  bounds = surfel_bounds(in, f, s, scale, opacity);
  if (bounds.radius > 0 || bounds.clipped) record.signed_depth = -s.depth;
  const PixelBox box = bounds.box();
  return box.x1 >= 0 && box.x0 <= in.width && box.y1 >= 0 && box.y0 <= in.height;
}

// Projects and culls all splats, and notes the tiles that the visible ones touch. radii: [N] pixels, 0 where culled.
void project_all(const SurfelInputs& in, SurfelState& state, float* radii) {
  state.records.resize(in.count), state.depths.resize(in.count);
  start_lists(state.lists, in.count, in.width, in.height);
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    state.lists.found[begin / kSplatChunk].count = 0;
    for (int64_t i = begin; i < end; ++i) {
      SurfelBounds bounds;
      const bool seen = project_one(in, i, state.records[i], bounds);
      radii[i] = seen ? std::max({bounds.disk.hx, bounds.disk.hy, bounds.radius}) : 0.0f;
      state.depths[i] = seen ? state.records[i].depth() : -1.0f;
      state.lists.spans[i] = {};
      if (seen) find_tiles(state.lists, i, bounds);
    }
  });
}

// The walk goes in batches, each in stages: the footprints of a batch's splats and their alphas, which do not wait for one
// another; the passing of the light, which does; then what is made of it. In one loop the processor would not see far
// enough ahead to overlap them.
constexpr int kBatch = kWidth;

// Splats on a sub-tile. The last batch of a list is filled up with splats that count nowhere.
struct Batch {
  const SurfelRecord* splat[kBatch];
  float depth[kBatch];                 // of their centres
  vfloat alpha[kBatch][kVectors];      // 0 where one does not count
  vfloat T[kBatch][kVectors];          // before it
  vfloat r[kBatch][kVectors];          // depth = centre's depth * r: 1 / w, or 1 where the low-pass is stronger
  vfloat exponent[kBatch][kVectors];   // the weight is 2^-exponent
  vint on_disk[kBatch][kVectors];      // where the disk, not the low-pass, gives the weight; not set for plain splats
};

// A splat's exponents; for now alpha is its logarithm. Plain splats need neither the low-pass nor the near plane looked at.
template <bool Plain>
inline void meet(const SurfelRecord& s, const Pixels& pixels, float near, float low_pass, int e, Batch& batch) {
  const float depth = Plain ? s.signed_depth : -s.signed_depth;
  batch.splat[e] = &s, batch.depth[e] = depth;
  const vfloat dx = pixels.x + (pixels.x0 - s.x);
  const vfloat ax = s.L[0] * dx, bx = s.L[2] * dx, wx = fma(splat(s.g[0]), dx, splat(1.0f));
  for (int v = 0; v < kVectors; ++v) {
    const vfloat dy = pixels.y[v] + (pixels.y0 - s.y);
    const vfloat a = fma(splat(s.L[1]), dy, ax), b = fma(splat(s.L[3]), dy, bx);
    const vfloat inverse = reciprocal(fma(splat(s.g[1]), dy, wx));
    vfloat exponent = fma(a, a, b * b) * (inverse * inverse), r = inverse;
    if (!Plain) {
      const vfloat blur = (kExponentScale / low_pass) * fma(dx, dx, dy * dy);
      const vint on_disk = (exponent <= blur) & (depth * inverse > near);
      exponent = select(on_disk, exponent, blur), r = select(on_disk, inverse, splat(1.0f));
      batch.on_disk[e][v] = on_disk;
    }
    batch.alpha[e][v] = s.log2_opacity - exponent;
    batch.r[e][v] = r, batch.exponent[e][v] = exponent;
  }
}

// From the alphas' logarithms to the alphas.
inline void raise_alphas(vfloat* alpha, int count) {
  constexpr int kAtOnce = 4;
  for (int i = 0; i < count; i += kAtOnce) {
    vfloat raw[kAtOnce];
    for (int k = 0; k < kAtOnce; ++k) raw[k] = alpha[i + k];
    exp2_in_range<kAtOnce>(raw);
    for (int k = 0; k < kAtOnce; ++k) alpha[i + k] = keep(alpha[i + k] >= kLog2MinAlpha, min(raw[k], splat(kMaxAlpha)));
  }
}

// Meets up to kBatch splats of a sub-tile's list and lets them pass; returns how many.
inline int pass_splats(const SurfelInputs& in, const SurfelState& state, const SubTileLists& sub, const uint32_t* list,
                       int count, const Pixels& pixels, vfloat lights[kVectors], Batch& batch) {
  const int n = count < kBatch ? count : kBatch, ahead = count < 2 * kBatch ? count : 2 * kBatch;
  for (int e = kBatch; e < ahead; ++e) __builtin_prefetch(&state.records[sub.splat(list[e])]);
  for (int e = 0; e < kBatch; ++e) {
    const SurfelRecord& s = state.records[sub.splat(list[e < n ? e : 0])];
    if (s.plain())
      meet<true>(s, pixels, in.near, in.low_pass, e, batch);
    else
      meet<false>(s, pixels, in.near, in.low_pass, e, batch);
  }
  raise_alphas(batch.alpha[0], kBatch * kVectors);
  for (int e = n; e < kBatch; ++e)
    for (int v = 0; v < kVectors; ++v) batch.alpha[e][v] = vfloat{};
  pass_batch<kBatch, kVectors>(lights, batch.alpha, batch.T);
  return n;
}

// Depth measured from a sub-tile's first splat, in units of the depth range: distortion needs only differences, and
// these lose no digits.
struct DepthUnit {
  float offset, scale;
  vfloat of(vfloat z) const { return (z - offset) * scale; }
};

inline DepthUnit depth_unit(const SurfelInputs& in, const SurfelState& state, const SubTileLists& sub, int s) {
  return {sub.count(s) > 0 ? state.records[sub.splat(*sub.begin(s))].depth() : 0.0f, 1.0f / (in.far - in.near)};
}

// What blending adds up at a vector of pixels.
struct Blend {
  vfloat color[3], normal[3], depth, median, m1, m2;
};

template <bool Distortion>
inline void blend_vector(const Batch& batch, int v, const DepthUnit& unit, Blend& sums) {
  // Copied out one by one, so that the loop has them in registers.
  vfloat depth = sums.depth, median = sums.median, m1 = {}, m2 = {};
  vfloat red = sums.color[0], green = sums.color[1], blue = sums.color[2];
  vfloat nx = sums.normal[0], ny = sums.normal[1], nz = sums.normal[2];
  for (int e = 0; e < kBatch; ++e) {
    const SurfelRecord& s = *batch.splat[e];
    const vfloat T = batch.T[e][v], w = batch.alpha[e][v] * T, z = batch.depth[e] * batch.r[e][v];
    red = fma(w, splat(s.color[0]), red), green = fma(w, splat(s.color[1]), green), blue = fma(w, splat(s.color[2]), blue);
    nx = fma(w, splat(s.normal[0]), nx), ny = fma(w, splat(s.normal[1]), ny), nz = fma(w, splat(s.normal[2]), nz);
    depth = fma(w, z, depth);
    median = select((T >= 0.5f) & (T - w < 0.5f), z, median);
    if (Distortion) {
      const vfloat m = unit.of(z), wm = w * m;
      m1 += wm, m2 = fma(wm, m, m2);
    }
  }
  sums.depth = depth, sums.median = median;
  sums.color[0] = red, sums.color[1] = green, sums.color[2] = blue;
  sums.normal[0] = nx, sums.normal[1] = ny, sums.normal[2] = nz;
  if (Distortion) sums.m1 += m1, sums.m2 += m2;
}

template <bool Distortion>
inline void blend_subtile(const SurfelInputs& in, const SurfelState& state, const SubTileLists& sub, int s, const Pixels& pixels,
                          vfloat lights[kVectors], Blend p[kVectors]) {
  const DepthUnit unit = depth_unit(in, state, sub, s);
  Batch batch;
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    pass_splats(in, state, sub, list + e, count - e, pixels, lights, batch);
    for (int v = 0; v < kVectors; ++v) blend_vector<Distortion>(batch, v, unit, p[v]);
    if (!any_open<kVectors>(lights)) break;
  }
}

template <bool Distortion>
void write_pixels(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, const vfloat lights[kVectors],
                  const Blend p[kVectors], int x0, int y0) {
  float f[11][16];
  for (int v = 0; v < kVectors; ++v) {
    store(f[0] + v * kWidth, abs(lights[v]));
    for (int k = 0; k < 3; ++k) store(f[1 + k] + v * kWidth, p[v].color[k]), store(f[4 + k] + v * kWidth, p[v].normal[k]);
    store(f[7] + v * kWidth, p[v].depth), store(f[8] + v * kWidth, p[v].median);
    if (Distortion) store(f[9] + v * kWidth, p[v].m1), store(f[10] + v * kWidth, p[v].m2);
  }
  for_pixels(x0, y0, in.width, in.height, [&](int64_t i, int j) {
    const float T = f[0][j], alpha = 1.0f - T;
    state.transmittance[i] = T, out.alpha[i] = alpha;
    for (int k = 0; k < 3; ++k) {
      out.color[3 * i + k] = f[1 + k][j] + T * in.background[k];
      out.normal[3 * i + k] = f[4 + k][j];
    }
    out.depth[i] = alpha > 0.5f * kMinAlpha ? f[7][j] / alpha : 0.0f;
    out.median_depth[i] = f[8][j];
    if (!Distortion) return;
    const float m1 = f[9][j], m2 = f[10][j];
    state.moments[2 * i] = m1, state.moments[2 * i + 1] = m2;
    out.distortion[i] = std::max(alpha * m2 - m1 * m1, 0.0f);
  });
}

template <bool Distortion>
void blend(const SurfelInputs& in, SurfelState& state, const SurfelImages& out) {
  for_tiles(state.lists, state.records.data(), [&](int, const SubTileLists& sub, int x0, int y0) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const Pixels pixels(x, y);
      Blend p[kVectors] = {};
      vfloat lights[kVectors];
      for (vfloat& light : lights) light = splat(1.0f);
      blend_subtile<Distortion>(in, state, sub, s, pixels, lights, p);
      write_pixels<Distortion>(in, state, out, lights, p, x, y);
    });
  });
}

// The gradient images at a sub-tile's pixels, made ready for the walk.
struct PixelGradients {
  struct Fields {
    float color[3][16], normal[3][16], depth[16], median[16], m1[16], m2[16];
    float behind[16];  // what the walk will have added up by its end, and what lies behind the last splat
  } f = {};

  PixelGradients(const SurfelInputs& in, const SurfelState& state, const SurfelImages& out, const SurfelImages& v, int x0,
                 int y0) {
    for_pixels(x0, y0, in.width, in.height, [&](int64_t i, int j) {
      const float T = state.transmittance[i], alpha = 1.0f - T;
      float total = v.alpha ? -T * v.alpha[i] : 0.0f;
      for (int k = 0; k < 3; ++k) {
        f.color[k][j] = v.color ? v.color[3 * i + k] : 0.0f;
        f.normal[k][j] = v.normal ? v.normal[3 * i + k] : 0.0f;
        total += f.color[k][j] * out.color[3 * i + k] + f.normal[k][j] * out.normal[3 * i + k];
      }
      if (v.depth && alpha > 0.5f * kMinAlpha) {
        // depth = sum / alpha: the sum's gradient is v / alpha, and alpha's loses v * depth / alpha.
        f.depth[j] = v.depth[i] / alpha;
        total += f.depth[j] * out.depth[i];
      }
      if (v.median_depth) f.median[j] = v.median_depth[i];
      if (v.distortion) {
        // distortion = alpha m2 - m1^2
        const float m1 = state.moments[2 * i], m2 = state.moments[2 * i + 1];
        f.m1[j] = -2.0f * m1 * v.distortion[i], f.m2[j] = alpha * v.distortion[i];
        total += f.m1[j] * m1 + f.m2[j] * m2 - T * m2 * v.distortion[i];
      }
      f.behind[j] = total;
    });
  }
};

// What the walk finds for one splat.
struct Step {
  vfloat opacity[kVectors], depth[kVectors];  // gradients of opacity and depth, times opacity and depth
  vfloat share[kVectors];                     // alpha T
};

template <bool Distortion>
inline void walk_vector(const Batch& batch, int v, const PixelGradients::Fields& g, const DepthUnit& unit, vfloat& behind_them,
                        Step* steps) {
  const int lane = v * kWidth;
  vfloat behind = behind_them;
  for (int e = 0; e < kBatch; ++e) {
    const SurfelRecord& s = *batch.splat[e];
    const vfloat alpha = batch.alpha[e][v], T = batch.T[e][v], w = alpha * T, z = batch.depth[e] * batch.r[e][v];
    const vfloat v_depth = load(g.depth + lane);
    vfloat q = load(g.color[0] + lane) * s.color[0] + load(g.color[1] + lane) * s.color[1] + load(g.color[2] + lane) * s.color[2];
    q += load(g.normal[0] + lane) * s.normal[0] + load(g.normal[1] + lane) * s.normal[1] + (load(g.normal[2] + lane) * s.normal[2] + v_depth * z);
    vfloat v_z = w * v_depth + keep((T >= 0.5f) & (T - w < 0.5f), load(g.median + lane));
    if (Distortion) {
      const vfloat m = unit.of(z), v_m1 = load(g.m1 + lane), v_m2 = load(g.m2 + lane);
      q += m * (v_m1 + m * v_m2);
      v_z += w * unit.scale * (v_m1 + 2.0f * m * v_m2);
    }
    behind -= w * q;
    const vfloat v_alpha = T * q - behind * reciprocal(1.0f - alpha);
    // Zero where alpha is held at its maximum, and where it is 0.
    steps[e].opacity[v] = keep(alpha < kMaxAlpha, v_alpha * alpha);
    steps[e].depth[v] = v_z * z;
    steps[e].share[v] = w;
  }
  behind_them = behind;
}

// sums: [kPairFields] of the sub-tile's pixels, lane by lane.
template <bool Plain>
inline void gather(const Batch& batch, int e, const Step& step, const Pixels& pixels, const PixelGradients::Fields& g,
                   float low_pass, vfloat sums[kPairFields]) {
  const SurfelRecord& s = *batch.splat[e];
  const vfloat dx = pixels.x + (pixels.x0 - s.x);
  vfloat second = {}, second_y = {}, yy = {}, w = {}, w_y = {}, blur = {}, blur_y = {};
  for (int k = 0; k < kPairFields; ++k) sums[k] = vfloat{};
  for (int n = 0; n < kVectors; ++n) {
    const vfloat dy = pixels.y[n] + (pixels.y0 - s.y), scaled = (2.0f * kLn2) * step.opacity[n], r = batch.r[e][n];
    // Of w, and of the disk's exponent times 1/w^2, whose moments give L's gradient.
    vfloat v_w = (scaled * batch.exponent[e][n] - step.depth[n]) * r, v_second = scaled * (r * r);
    if (!Plain) {
      v_second = keep(batch.on_disk[e][n], v_second), v_w = keep(batch.on_disk[e][n], v_w);
      const vfloat v_blur = keep(~batch.on_disk[e][n], step.opacity[n] / low_pass);
      blur += v_blur, blur_y += v_blur * dy;
    }
    const vfloat y = v_second * dy;
    second += v_second, second_y += y, yy += y * dy;
    w += v_w, w_y += v_w * dy;
    sums[kDepth] += step.depth[n], sums[kOpacity] += step.opacity[n];
    for (int k = 0; k < 3; ++k) sums[kColor + k] += step.share[n] * load(g.color[k] + n * kWidth);
    for (int k = 0; k < 3; ++k) sums[kNormal + k] += step.share[n] * load(g.normal[k] + n * kWidth);
  }
  const vfloat second_x = second * dx;
  sums[kXX] = second_x * dx, sums[kXY] = second_y * dx, sums[kYY] = yy;
  sums[kSlopeX] = w * dx, sums[kSlopeY] = w_y;
  if (Plain) {
    sums[kMeanX] = second_x, sums[kMeanY] = second_y, sums[kW] = w;
  } else {
    // Moving the centre moves every d the other way.
    const vfloat a = s.L[0] * second_x + s.L[1] * second_y, b = s.L[2] * second_x + s.L[3] * second_y;
    sums[kMeanX] = blur * dx + s.L[0] * a + s.L[2] * b - s.g[0] * w;
    sums[kMeanY] = blur_y + s.L[1] * a + s.L[3] * b - s.g[1] * w;
  }
}

// pairs: [tile's entries, kPairFields] gets each pair's sums added.
template <bool Distortion>
void backward_subtile(const SurfelInputs& in, const SurfelState& state, const PixelGradients::Fields& g,
                      const SubTileLists& sub, int s, const Pixels& pixels, float* pairs) {
  const DepthUnit unit = depth_unit(in, state, sub, s);
  vfloat lights[kVectors], behind[kVectors];
  for (int v = 0; v < kVectors; ++v) lights[v] = splat(1.0f), behind[v] = load(g.behind + v * kWidth);
  Batch batch;
  Step steps[kBatch];
  const uint32_t* list = sub.begin(s);
  const int count = sub.count(s);
  for (int e = 0; e < count; e += kBatch) {
    const int n = pass_splats(in, state, sub, list + e, count - e, pixels, lights, batch);
    for (int v = 0; v < kVectors; ++v) walk_vector<Distortion>(batch, v, g, unit, behind[v], steps);
    for (int i = 0; i < n; ++i) {
      vfloat sums[kPairFields];
      if (batch.splat[i]->plain())
        gather<true>(batch, i, steps[i], pixels, g, in.low_pass, sums);
      else
        gather<false>(batch, i, steps[i], pixels, g, in.low_pass, sums);
      add_sums<kPairFields>(sums, pairs + size_t(list[e + i]) * kPairFields);
    }
    if (!any_open<kVectors>(lights)) break;
  }
}

template <bool Distortion>
void blend_backward(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, const SurfelImages& v_out) {
  const auto walk = [&](const SubTileLists& sub, int x0, int y0, float* pairs) {
    for_subtiles(x0, y0, in.width, in.height, [&](int s, int x, int y) {
      const PixelGradients g(in, state, out, v_out, x, y);
      backward_subtile<Distortion>(in, state, g.f, sub, s, Pixels(x, y), pairs);
    });
  };
  walk_tiles(state.lists, state.records.data(), state.pair_gradients, walk);
}

// From the pairs' sums to the gradients of splat i, whose record is s.
void splat_backward(const SurfelInputs& in, int64_t i, const SurfelRecord& s, const float* total, const SurfelGradients& v) {
  const float *scale = in.scales + 2 * i, *quat = in.quats + 4 * i;
  SurfelFrame<float> f;
  surfel_frame(in.camera, in.means + 3 * i, quat, scale, f);
  ProjectedSurfel<float> g = {};
  g.x = total[kMeanX], g.y = total[kMeanY];
  if (s.plain()) {
    // Moving the centre moves every d the other way.
    const float a = s.L[0] * g.x + s.L[1] * g.y, b = s.L[2] * g.x + s.L[3] * g.y;
    g.x = s.L[0] * a + s.L[2] * b - s.g[0] * total[kW];
    g.y = s.L[1] * a + s.L[3] * b - s.g[1] * total[kW];
  }
  g.depth = total[kDepth] / s.depth();
  for (int k = 0; k < 4; k += 2) {
    g.L[k] = -kRootExponentScale * (s.L[k] * total[kXX] + s.L[k + 1] * total[kXY]);
    g.L[k + 1] = -kRootExponentScale * (s.L[k] * total[kXY] + s.L[k + 1] * total[kYY]);
  }
  g.g[0] = total[kSlopeX], g.g[1] = total[kSlopeY];
  for (int k = 0; k < 3; ++k) g.normal[k] = total[kNormal + k];
  for (int k = 0; k < 3; ++k) v.colors[3 * i + k] = total[kColor + k];
  v.opacities[i] = total[kOpacity] / in.opacities[i];
  v.means2d[2 * i] = g.x, v.means2d[2 * i + 1] = g.y;
  project_surfel_vjp(in.camera, quat, scale, f, g, v.means + 3 * i, v.quats + 4 * i, v.scales + 2 * i);
}

void reduce_pairs(const SurfelInputs& in, const SurfelState& state, const SurfelGradients& v) {
  parallel_chunks(in.count, kSplatChunk, [&](int64_t begin, int64_t end) {
    float total[kPairFields];
    for (int64_t i = begin; i < end; ++i) {
      if (state.depths[i] < 0) continue;
      sum_pairs(state.lists, state.pair_gradients, i, total);
      splat_backward(in, i, state.records[i], total, v);
    }
  });
}

void forward(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, float* radii) {
  project_all(in, state, radii);
  sort_by_depth(state.sort, state.depths);
  lay_out_lists(state.lists, state.sort.order);
  const size_t pixels = size_t(in.width) * in.height;
  state.transmittance.resize(pixels);
  if (out.distortion) state.moments.resize(2 * pixels);
  out.distortion ? blend<true>(in, state, out) : blend<false>(in, state, out);
}

void backward(const SurfelInputs& in, SurfelState& state, const SurfelImages& out, const SurfelImages& v_out,
              const SurfelGradients& v) {
  v_out.distortion ? blend_backward<true>(in, state, out, v_out) : blend_backward<false>(in, state, out, v_out);
  reduce_pairs(in, state, v);
}

}  // namespace

const SurfelKernels surfel_kernels = {forward, backward};

}  // namespace MGSR_ISA
}  // namespace mgsr
