// What is found wrong with a kernel. Of a line of the PTX number n, messages say {n}, which the launcher spells out.
#pragma once

#include <algorithm>
#include <stdexcept>
#include <string>
#include <vector>

#include "thread.h"

namespace ptx {

// What a launch can't go on after.
struct Fault : std::runtime_error {
  using std::runtime_error::runtime_error;
};

inline std::string who(uint32_t block, uint32_t thread) {
  return "block " + std::to_string(block) + ", thread " + std::to_string(thread);
}
inline std::string who(const Thread& thread) { return who(thread.block, thread.index); }
inline std::string at(int line) { return " at {" + std::to_string(line) + "}"; }

// What a launch goes on after: each kind once, so that a race at every pixel is a message or two.
class Problems {
 public:
  void clear() { kinds_.clear(), texts_.clear(); }
  void add(const std::string& kind, const std::string& instance) {
    if (std::find(kinds_.begin(), kinds_.end(), kind) != kinds_.end() || kinds_.size() == kMost) return;
    kinds_.push_back(kind);
    texts_.push_back(kind + " (" + instance + ")");
  }
  bool any() const { return !texts_.empty(); }
  std::string text() const {
    std::string all;
    for (const std::string& one : texts_) all += (all.empty() ? "" : "\n") + one;
    return all;
  }

 private:
  static constexpr size_t kMost = 16;
  std::vector<std::string> kinds_, texts_;
};

}  // namespace ptx
