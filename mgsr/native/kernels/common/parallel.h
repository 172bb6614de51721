// A small thread pool. Work is cut into chunks whose number never depends on the number of threads. So sums that are
// made chunk by chunk have the same bytes for any number of threads.
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#if defined(__linux__)
#include <sched.h>
#endif

namespace mgsr {

class ThreadPool {
 public:
  // The pool of this extension module. The first call that has work for its workers starts them.
  static ThreadPool& instance() {
    static ThreadPool pool;
    return pool;
  }

  void set_threads(int n) {
    std::lock_guard<std::mutex> run(run_mutex_);
    stop_workers();
    threads_ = n > 0 ? n : available();
  }

  int threads() const { return threads_; }

  // Calls body(i) once for each i in [0, count), in any order and on any thread; returns when all are done.
  // Not reentrant: body must not call run.
  template <class Body>
  void run(int count, const Body& body) {
    if (count <= 1 || threads_ == 1) {
      for (int i = 0; i < count; ++i) body(i);
      return;
    }
    std::lock_guard<std::mutex> guard(run_mutex_);
    if (workers_.empty()) start_workers();
    body_ = [&body](int i) { body(i); };
    count_ = count;
    next_.store(0, std::memory_order_relaxed);
    joined_.store(kOpen, std::memory_order_release);
    {
      std::lock_guard<std::mutex> lock(mutex_);
      generation_.fetch_add(1, std::memory_order_release);
    }
    wake_.notify_all();
    drain();
    // Waits only for workers that joined: one that the system has not woken yet has nothing left to do.
    joined_.fetch_and(~kOpen, std::memory_order_acq_rel);
    for (int spin = 0; joined_.load(std::memory_order_acquire) != 0; ++spin) spin < 2000 ? pause() : std::this_thread::yield();
  }

  ~ThreadPool() { stop_workers(); }

 private:
  ThreadPool() : threads_(available()) {}

  static int available() {
#if defined(__linux__)
    cpu_set_t set;
    if (sched_getaffinity(0, sizeof(set), &set) == 0) return CPU_COUNT(&set) > 0 ? CPU_COUNT(&set) : 1;
#endif
    const int n = int(std::thread::hardware_concurrency());
    return n > 0 ? n : 1;
  }

  static void pause() {
#if defined(__x86_64__)
    __builtin_ia32_pause();
#else
    std::this_thread::yield();
#endif
  }

  void drain() {
    for (int i = next_.fetch_add(1); i < count_; i = next_.fetch_add(1)) body_(i);
  }

  void start_workers() {
    stopping_ = false;
    for (int t = 1; t < threads_; ++t) workers_.emplace_back([this, seen = generation_.load()]() mutable { work(seen); });
  }

  void stop_workers() {
    {
      std::lock_guard<std::mutex> lock(mutex_);
      stopping_ = true;
      generation_.fetch_add(1, std::memory_order_release);
    }
    wake_.notify_all();
    for (auto& worker : workers_) worker.join();
    workers_.clear();
  }

  // A kernel calls run several times within microseconds, so a worker polls for work for a moment before it sleeps.
  void work(uint64_t seen) {
    for (;;) {
      for (int spin = 0; spin < 2000 && generation_.load(std::memory_order_acquire) == seen; ++spin) pause();
      if (generation_.load(std::memory_order_acquire) == seen) {
        std::unique_lock<std::mutex> lock(mutex_);
        wake_.wait(lock, [&] { return generation_.load(std::memory_order_acquire) != seen; });
      }
      seen = generation_.load(std::memory_order_acquire);
      if (stopping_) return;
      if (!join()) continue;
      drain();
      joined_.fetch_sub(1, std::memory_order_release);
    }
  }

  // Joins the current run. Returns false if there is none that still takes workers.
  bool join() {
    uint32_t joined = joined_.load(std::memory_order_acquire);
    while (joined & kOpen)
      if (joined_.compare_exchange_weak(joined, joined + 1, std::memory_order_acq_rel)) return true;
    return false;
  }

  static constexpr uint32_t kOpen = 1u << 31;

  int threads_;
  std::vector<std::thread> workers_;
  std::mutex run_mutex_, mutex_;
  std::condition_variable wake_;
  std::atomic<uint64_t> generation_{0};
  std::atomic<int> next_{0};
  std::atomic<uint32_t> joined_{0};  // workers in the current run, and kOpen while it takes more
  int count_ = 0;
  bool stopping_ = false;
  std::function<void(int)> body_;
};

// Calls body(begin, end) over [0, n) in chunks of fixed size.
template <class Body>
void parallel_chunks(int64_t n, int64_t chunk, const Body& body) {
  const int count = int((n + chunk - 1) / chunk);
  ThreadPool::instance().run(count, [&](int c) {
    const int64_t begin = c * chunk, end = begin + chunk < n ? begin + chunk : n;
    body(begin, end);
  });
}

}  // namespace mgsr
