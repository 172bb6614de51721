// The cost of each tilt of a point's normal: the robust residual of the light that the tilted normal mirrors.
//
// A point's brightness is its diffuse brightness, the same in all views, plus the mirrored light. The weighted mean of
// the residuals stands for the diffuse brightness. The lanes of a vector are tilts of one point.
#include "kernels/mirrored/mirrored.h"

#include <algorithm>
#include <vector>

#include "kernels/common/parallel.h"
#include "kernels/common/simd.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int64_t kPoints = 64;  // points per task

// A visible observation of a point.
struct Observation {
  float eye[3];    // unit direction to the camera
  float along[3];  // its components along the axes of the point's frame
  float brightness, weight;
};

// The tilts of a grid, first along the first tangent.
class Grid {
 public:
  explicit Grid(const TiltParams& p) : blocks_((p.tilts * p.tilts + kWidth - 1) / kWidth) {
    first_.assign(size_t(blocks_ * kWidth), 0.0f), second_ = first_;
    for (int64_t i = 0; i < p.tilts * p.tilts; ++i)
      first_[size_t(i)] = p.tangents[i / p.tilts], second_[size_t(i)] = p.tangents[i % p.tilts];
  }

  int64_t blocks() const { return blocks_; }
  vfloat first(int64_t block) const { return load(first_.data() + block * kWidth); }
  vfloat second(int64_t block) const { return load(second_.data() + block * kWidth); }

 private:
  const int64_t blocks_;  // vectors of tilts; the last one is filled up with tilts of 0
  std::vector<float> first_, second_;
};

class TiltSearch {
 public:
  TiltSearch(const TiltParams& p, const Grid& grid) : p_(p), grid_(grid), residuals_(size_t(p.views)) {
    observations_.reserve(size_t(p.views));
  }

  void run(int64_t point) {
    const float* frame = p_.frames + 9 * point;
    const float total = observe(point, frame);
    float* costs = p_.costs + point * p_.tilts * p_.tilts;
    for (int64_t block = 0; block < grid_.blocks(); ++block) {
      const vfloat cost = costs_of(frame, grid_.first(block), grid_.second(block), total);
      const int64_t begin = block * kWidth, count = std::min<int64_t>(kWidth, p_.tilts * p_.tilts - begin);
      std::memcpy(costs + begin, &cost, size_t(count) * sizeof(float));
    }
  }

 private:
  // Collects the visible observations of a point; returns the sum of their weights.
  float observe(int64_t point, const float* frame) {
    observations_.clear();
    float total = 0;
    for (int64_t i = point * p_.views; i < (point + 1) * p_.views; ++i) {
      if (!(p_.weights[i] > 0)) continue;
      const float* eye = p_.view_directions + 3 * i;
      Observation each{{eye[0], eye[1], eye[2]}, {}, p_.brightness[i], p_.weights[i]};
      for (int axis = 0; axis < 3; ++axis)
        each.along[axis] = frame[3 * axis] * eye[0] + frame[3 * axis + 1] * eye[1] + frame[3 * axis + 2] * eye[2];
      observations_.push_back(each);
      total += each.weight;
    }
    return std::max(total, 1e-9f);
  }

  vfloat costs_of(const float* frame, vfloat first, vfloat second, float total) {
    const vfloat twice = 2.0f / (1.0f + first * first + second * second);
    vfloat tilted[3], sum{}, cost{};
    for (int axis = 0; axis < 3; ++axis) tilted[axis] = first * frame[axis] + second * frame[3 + axis] + frame[6 + axis];
    for (size_t i = 0; i < observations_.size(); ++i) {
      const Observation& seen = observations_[i];
      const vfloat cosine = twice * (first * seen.along[0] + second * seen.along[1] + seen.along[2]);
      const vfloat shown = light(cosine * tilted[0] - seen.eye[0], cosine * tilted[1] - seen.eye[1],
                                 cosine * tilted[2] - seen.eye[2]);
      residuals_[i] = seen.brightness - shown;
      sum += seen.weight * residuals_[i];
    }
    const vfloat mean = sum / total;
    const float scale = 1 / p_.outlier;
    for (size_t i = 0; i < observations_.size(); ++i) {
      const vfloat share = scale * (residuals_[i] - mean), square = share * share;
      cost += observations_[i].weight * square / (1.0f + square);
    }
    return cost;
  }

  // Returns the table's light in directions.
  vfloat light(vfloat x, vfloat y, vfloat z) const {
    return load_at(p_.table, (cell(x) * p_.cells + cell(y)) * p_.cells + cell(z));
  }

  vint cell(vfloat component) const {
    const float half = 0.5f * float(p_.cells);
    const vfloat place = min(max(half * component + half, vfloat{}), splat(float(p_.cells - 1)));
    return __builtin_convertvector(place, vint);
  }

  const TiltParams& p_;
  const Grid& grid_;
  std::vector<Observation> observations_;
  std::vector<vfloat> residuals_;  // of each observation
};

void tilt_costs(const TiltParams& p) {
  const Grid grid(p);
  parallel_chunks(p.points, kPoints, [&](int64_t begin, int64_t end) {
    TiltSearch search(p, grid);
    for (int64_t point = begin; point < end; ++point) search.run(point);
  });
}

}  // namespace

extern const MirroredTable mirrored_table{tilt_costs};

}  // namespace MGSR_ISA
}  // namespace mgsr
