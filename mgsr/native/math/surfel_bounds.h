// The part of the image in which a surfel can count: the ellipse of its disk, and the circle of its low-pass.
#pragma once

#include "math/blending.h"
#include "math/ellipse.h"
#include "math/surfel.h"

namespace mgsr {

struct SurfelBounds {
  EllipseForm<float> disk;
  float x, y, radius;  // radius 0 if the disk is stronger than the low-pass everywhere
  bool clipped;        // the disk reaches behind the near plane
};

// The values of a view, apart from the camera, on which the bounds depend: camera units, px^2, pixels.
struct SurfelImage {
  float near, low_pass, width, height;
};

struct SurfelBox {
  float x0, x1, y0, y1;
};

MGSR_HD float smaller(float a, float b) { return b < a ? b : a; }  // a if one of them is NaN
MGSR_HD float larger(float a, float b) { return a < b ? b : a; }

MGSR_HD EllipseForm<float> ellipse_of_box(const SurfelBox& b) {
  const float hx = 0.5f * (b.x1 - b.x0), hy = 0.5f * (b.y1 - b.y0);
  return {b.x0 + hx, b.y0 + hy, hx, hy, 0.0f, 0.0f, hx * hx, 0.0f};
}

MGSR_HD void widen(SurfelBox& box, const Camera<float>& cam, const double p[3]) {
  const float x = float(cam.fx * p[0] / p[2] + cam.cx), y = float(cam.fy * p[1] / p[2] + cam.cy);
  box = {smaller(box.x0, x), larger(box.x1, x), smaller(box.y0, y), larger(box.y1, y)};
}

// Returns the image of the part of the disk's bounding square (half side r in u and v) that lies beyond `near`. If one
// axis is much longer than the distance, float32 loses the other axis beside it. So the corners are in float64, and an
// axis ends where it has practically reached its vanishing point.
MGSR_HD SurfelBox clipped_square(const Camera<float>& cam, const SurfelFrame<float>& f, const float scale[2], float r,
                                 float near) {
  SurfelBox box = {1e9f, -1e9f, 1e9f, -1e9f};
  const double farthest = 1e7 * MGSR_SQRT(double(f.p[0]) * f.p[0] + double(f.p[1]) * f.p[1] + double(f.p[2]) * f.p[2]);
  double last[3] = {}, reach[2];
  for (int i = 0; i < 2; ++i) reach[i] = double(r) * scale[i] < farthest ? double(r) * scale[i] : farthest;
  for (int corner = 0; corner < 5; ++corner) {
    const double u = corner % 4 == 1 || corner % 4 == 2 ? reach[0] : -reach[0], v = corner % 4 >= 2 ? reach[1] : -reach[1];
    double p[3];
    for (int i = 0; i < 3; ++i) p[i] = f.p[i] + (u * f.tu[i] + v * f.tv[i]);
    if (corner > 0 && (p[2] > near) != (last[2] > near)) {
      const double t = (near - last[2]) / (p[2] - last[2]);
      const double cut[3] = {last[0] + t * (p[0] - last[0]), last[1] + t * (p[1] - last[1]), near};
      widen(box, cam, cut);
    }
    if (p[2] > near) widen(box, cam, p);
    for (int i = 0; i < 3; ++i) last[i] = p[i];
  }
  return box;
}

// Returns the radius of the low-pass circle, or 0 if everywhere in it the disk's weight is at least the low-pass's.
MGSR_HD float low_pass_radius(const ProjectedSurfel<float>& s, bool edge_on, float log_strength, float low_pass) {
  const float radius = MGSR_SQRT(2.0f * low_pass * log_strength);
  const float trace = s.L[0] * s.L[0] + s.L[1] * s.L[1] + s.L[2] * s.L[2] + s.L[3] * s.L[3];
  const float det = s.L[0] * s.L[3] - s.L[1] * s.L[2];
  const float largest = 0.5f * (trace + MGSR_SQRT(larger(trace * trace - 4 * det * det, 0.0f)));
  const float w = 1.0f - radius * MGSR_SQRT(s.g[0] * s.g[0] + s.g[1] * s.g[1]);
  return !edge_on && w > 0 && largest * low_pass < w * w ? 0.0f : radius;
}

MGSR_HD SurfelBounds surfel_bounds(const Camera<float>& cam, const SurfelImage& image, const SurfelFrame<float>& f,
                                   const ProjectedSurfel<float>& s, const float scale[2], float opacity) {
  const float log_strength = log(opacity / kMinAlpha), r2 = 2.0f * log_strength;
  SurfelBounds b = {{}, s.x, s.y, low_pass_radius(s, f.edge_on, log_strength, image.low_pass), false};
  SurfelOutline<float> o;
  if (surfel_outline(cam, f, scale, r2, image.near, o)) {
    // The limit avoids a division by zero for a disk whose width vanishes.
    const float least = 1e-20f;
    b.disk = make_ellipse(s.x + o.x, s.y + o.y, at_least(o.cxx, least), o.cxy, at_least(o.cyy, least), 1.0f);
    b.disk.w2 += 1e-6f * o.cxx;  // covers the rounding error of a thin ellipse's determinant
  } else {
    b.clipped = true;
    const float w = image.width, h = image.height;
    const SurfelBox box = clipped_square(cam, f, scale, MGSR_SQRT(r2), image.near);
    // With the arguments in this order, a NaN from an overflow gives the bound.
    b.disk = ellipse_of_box({larger(-w, box.x0), smaller(2 * w, box.x1), larger(-h, box.y0), smaller(2 * h, box.y1)});
  }
  return b;
}

}  // namespace mgsr
