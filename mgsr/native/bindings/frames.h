// A rendered view as an opaque Python object, which holds the state that backward needs.
#pragma once

#include <memory>
#include <mutex>
#include <vector>

namespace mgsr {

// Owns a rasterizer's state while the view is needed. Then a later view reuses the state's memory.
template <class State>
class Frame {
 public:
  Frame() : state_(Pool::instance().take()) {}
  ~Frame() { Pool::instance().give(std::move(state_)); }
  State& operator*() const { return *state_; }
  State* operator->() const { return state_.get(); }

 private:
  class Pool {
   public:
    static Pool& instance() {
      static Pool pool;
      return pool;
    }
    std::unique_ptr<State> take() {
      std::lock_guard<std::mutex> lock(mutex_);
      if (free_.empty()) return std::make_unique<State>();
      auto state = std::move(free_.back());
      free_.pop_back();
      return state;
    }
    void give(std::unique_ptr<State> state) {
      std::lock_guard<std::mutex> lock(mutex_);
      if (free_.size() < kKept) free_.push_back(std::move(state));
    }

   private:
    static constexpr size_t kKept = 2;
    std::mutex mutex_;
    std::vector<std::unique_ptr<State>> free_;
  };

  std::unique_ptr<State> state_;
};

}  // namespace mgsr
