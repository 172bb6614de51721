// The votes of depth maps, and their fusion under total variation (Zach, 2008) by the primal-dual algorithm of
// Chambolle and Pock (2011).
//
// The field u minimises  sum over voxels of  votes(d) |u - d|, integrated over d,  +  strength |gradient of u|. A bin's
// votes are spread evenly over its width, so that the field is not attracted to the middles of bins. The gradient is by
// forward differences, 0 at the end of the grid.
#include "kernels/fusion/fusion.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "kernels/common/parallel.h"

namespace mgsr {
namespace MGSR_ISA {
namespace {

constexpr int64_t kRows = 16;     // rows along z per task
constexpr int64_t kVoxels = 4096; // voxels or points per task
// The primal and the dual step length. The squared norm of the gradient operator in three dimensions is at most 12.
const float kStep = 1 / std::sqrt(12.0f);

// The part of a row along z whose gradients affect the voxels that are fitted.
struct Span {
  int64_t begin = INT64_MAX, end = 0;
  void add(int64_t z) { begin = std::min(begin, z), end = std::max(end, z + 1); }
};

class Field {
 public:
  explicit Field(const FusionParams& p)
      : p_(p), row_(p.shape[2]), slice_(p.shape[1] * p.shape[2]), ahead_(p.field, p.field + p.shape[0] * slice_) {
    for (auto& each : dual_) each.assign(ahead_.size(), 0.0f);
    find_spans();
    find_slopes();
  }

  void run() {
    for (int round = 0; round < p_.rounds; ++round) {
      parallel_chunks(int64_t(rows_.size()), kRows, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) climb(rows_[size_t(i)]);
      });
      parallel_chunks(p_.count, kVoxels, [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) descend(i);
      });
    }
  }

 private:
  void find_spans() {
    spans_.resize(size_t(p_.shape[0] * p_.shape[1]));
    for (int64_t i = 0; i < p_.count; ++i) {
      const int64_t voxel = p_.voxels[i], row = voxel / row_, z = voxel % row_, y = row % p_.shape[1];
      spans_[size_t(row)].add(z);
      if (z > 0) spans_[size_t(row)].add(z - 1);
      if (y > 0) spans_[size_t(row - 1)].add(z);
      if (row >= p_.shape[1]) spans_[size_t(row - p_.shape[1])].add(z);
    }
    for (size_t row = 0; row < spans_.size(); ++row)
      if (spans_[row].end) rows_.push_back(int64_t(row));
  }

  // Finds the votes' pull at each edge between bins: the weight of all larger distances less that of all smaller ones.
  void find_slopes() {
    pulls_.resize(size_t(p_.count * (p_.bins + 1)));
    for (int64_t i = 0; i < p_.count; ++i) {
      const float* votes = p_.votes + i * p_.bins;
      float* pulls = pulls_.data() + i * (p_.bins + 1);
      float sum = 0;
      for (int bin = 0; bin < p_.bins; ++bin) sum += votes[bin];
      pulls[0] = sum;
      for (int bin = 0; bin < p_.bins; ++bin) pulls[bin + 1] = pulls[bin] - 2 * votes[bin];
    }
  }

  // The dual step of a row: adds the field's gradient to the dual variables, and limits their length to `strength`.
  void climb(int64_t row) {
    const Span span = spans_[size_t(row)];
    const bool last_x = row / p_.shape[1] + 1 == p_.shape[0], last_y = row % p_.shape[1] + 1 == p_.shape[1];
    const int64_t at = row * row_;
    const float* u = ahead_.data() + at;
    const float* right = last_x ? u : u + slice_;
    const float* below = last_y ? u : u + row_;
    float *px = dual_[0].data() + at, *py = dual_[1].data() + at, *pz = dual_[2].data() + at;
    const float strength = p_.strength;
    for (int64_t z = span.begin; z < span.end; ++z) {
      const float x = px[z] + kStep * (right[z] - u[z]), y = py[z] + kStep * (below[z] - u[z]);
      const float along = z + 1 < row_ ? pz[z] + kStep * (u[z + 1] - u[z]) : 0.0f;
      const float length = std::sqrt(x * x + y * y + along * along);
      const float share = strength / std::max(strength, length);
      px[z] = share * x, py[z] = share * y, pz[z] = share * along;
    }
  }

  void descend(int64_t i) {
    const int64_t at = p_.voxels[i], row = at / row_;
    const float *px = dual_[0].data() + at, *py = dual_[1].data() + at, *pz = dual_[2].data() + at;
    float divergence = *px + *py + *pz;
    if (row >= p_.shape[1]) divergence -= px[-slice_];
    if (row % p_.shape[1] > 0) divergence -= py[-row_];
    if (at % row_ > 0) divergence -= pz[-1];
    const float before = p_.field[at];
    const float now = std::min(nearest(before + kStep * divergence, pulls_.data() + i * (p_.bins + 1)), p_.most[at]);
    p_.field[at] = now;
    ahead_[size_t(at)] = 2 * now - before;
  }

  // The primal step: returns u in -1..1 at which u - v equals kStep times the votes' pull, which falls from edge to
  // edge.
  float nearest(float v, const float* pulls) const {
    const float width = 2.0f / float(p_.bins);
    float over = -1 - v - kStep * pulls[0];
    if (over >= 0) return -1;
    for (int bin = 0; bin < p_.bins; ++bin) {
      const float edge = -1 + float(bin + 1) * width, next = edge - v - kStep * pulls[bin + 1];
      if (next >= 0) return edge - width * next / (next - over);
      over = next;
    }
    return 1;
  }

  const FusionParams& p_;
  const int64_t row_, slice_;   // the distances in voxels of neighbours along y and along x
  std::vector<float> ahead_;    // the field extrapolated by its last change
  std::vector<float> dual_[3];  // along x, y, z
  std::vector<float> pulls_;    // [count, bins + 1]
  std::vector<Span> spans_;     // of each row
  std::vector<int64_t> rows_;   // the rows with a span
};

void regularise(const FusionParams& p) { Field(p).run(); }

// Adds the vote of one map to the histogram of a point.
void vote_on(const VotingParams& p, const VotingView& view, const double* at, float* votes) {
  const double *turn = view.rotation, *move = view.translation;
  const double z = turn[6] * at[0] + turn[7] * at[1] + turn[8] * at[2] + move[2];
  if (!(z > 0)) return;
  const double x = turn[0] * at[0] + turn[1] * at[1] + turn[2] * at[2] + move[0];
  const double y = turn[3] * at[0] + turn[4] * at[1] + turn[5] * at[2] + move[1];
  const double across = x / z * view.fx + view.cx, down = y / z * view.fy + view.cy;
  if (!(across >= 0 && across < view.width && down >= 0 && down < view.height)) return;
  const int64_t pixel = int64_t(down) * view.width + int64_t(across);
  const float weight = view.weights[pixel];
  const double behind = (z - double(view.depth[pixel])) / p.reach;
  if (!(weight > 0 && behind < double(p.solid_depth))) return;
  const int bin = int(std::clamp((behind + 1) / 2 * p.bins, 0.0, double(p.bins - 1)));
  votes[bin] += behind < 1 ? weight : weight * p.solid_weight;
}

void vote(const VotingParams& p) {
  parallel_chunks(p.count, kVoxels, [&](int64_t begin, int64_t end) {
    std::fill(p.votes + begin * p.bins, p.votes + end * p.bins, 0.0f);
    for (const VotingView& view : p.views)
      for (int64_t i = begin; i < end; ++i) vote_on(p, view, p.points + 3 * i, p.votes + i * p.bins);
  });
}

}  // namespace

extern const FusionTable fusion_table{vote, regularise};

}  // namespace MGSR_ISA
}  // namespace mgsr
