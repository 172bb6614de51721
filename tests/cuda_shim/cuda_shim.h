// Runs CUDA kernels on the host, for tests: included before a .cu file that g++ compiles.
//
// The threads of a block are fibers on one processor, switched where they meet: at __syncthreads and at warp operations.
// Between two meetings they run one after the other, in the order asked for: ascending or descending, with each warp as far
// ahead of the next as barriers allow, or shuffled anew each time. Blocks go in the same kind of order. What depends on the order is a race, and shows as a difference of results.
// Misuse ends the launch with a message: a thread that left while others wait, threads of a warp in different
// operations, a deadlock.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <exception>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "fibers.h"

#define __global__
#define __device__
#define __host__
#define __forceinline__ inline
#define __launch_bounds__(...)
#define __shared__ static
#define __grid_constant__

struct uint3 { unsigned x, y, z; };
struct dim3 { unsigned x, y, z; };
struct int2 { int x, y; };
struct int4 { int x, y, z, w; };
struct float2 { float x, y; };
struct alignas(16) float4 { float x, y, z, w; };
inline int2 make_int2(int x, int y) { return {x, y}; }
inline int4 make_int4(int x, int y, int z, int w) { return {x, y, z, w}; }
inline float2 make_float2(float x, float y) { return {x, y}; }
inline float4 make_float4(float x, float y, float z, float w) { return {x, y, z, w}; }

namespace shim {

enum class Order : int { kAscending, kDescending, kShuffled };

enum class Operation : int { kShuffleUp, kShuffleDown, kShuffleXor, kShuffle, kBallot, kSync };

struct Thread {
  enum State { kReady, kAtBarrier, kInWarp, kDone } state = kReady;
  Fiber fiber;
};

// A meeting of a warp's threads: what each brought, and the last but one result, since some may still read the last.
struct Warp {
  uint32_t arrived = 0;
  Operation operation = Operation::kSync;
  uint64_t brought[32] = {}, results[2][32] = {};
  int meeting = 0;
};

struct Machine {
  uint3 thread{}, block{};
  dim3 threads{}, blocks{};
  std::vector<Thread> team;
  std::vector<Warp> warps;
  std::vector<uint64_t> stack_memory;
  Fiber scheduler;
  int current = 0;
  Order order = Order::kAscending;
  std::mt19937 random;
  std::string error;
  void (*kernel)(const void*) = nullptr;
  const void* params = nullptr;
};

inline Machine machine;

[[noreturn]] inline void fail(const std::string& what) {
  throw std::runtime_error(what + " (block " + std::to_string(machine.block.x) + ", thread " +
                           std::to_string(machine.thread.x) + ")");
}

inline void give_way(Thread::State state) {
  Thread& self = machine.team[size_t(machine.current)];
  self.state = state;
  switch_fiber(self.fiber, machine.scheduler);
}

// All of a block's threads begin here, each on its own stack.
inline void thread_main() {
  try {
    machine.kernel(machine.params);
  } catch (const std::exception& error) {
    machine.error = error.what();
  }
  for (;;) give_way(Thread::kDone);
}

inline std::vector<int> in_order(int count) {
  std::vector<int> order(static_cast<size_t>(count));
  for (int i = 0; i < count; ++i) order[size_t(i)] = machine.order == Order::kDescending ? count - 1 - i : i;
  if (machine.order == Order::kShuffled) std::shuffle(order.begin(), order.end(), machine.random);
  return order;
}

inline void run_thread(int index) {
  machine.current = index;
  machine.thread = {unsigned(index), 0, 0};
  switch_fiber(machine.scheduler, machine.team[size_t(index)].fiber);
}

// Lets those of the threads [begin, end) that can run do so until their next meeting; returns whether any could.
inline bool run_some(int begin, int end) {
  bool ran = false;
  for (int index : in_order(end - begin)) {
    if (machine.team[size_t(begin + index)].state != Thread::kReady) continue;
    run_thread(begin + index);
    ran = true;
    if (!machine.error.empty()) throw std::runtime_error(machine.error);
  }
  return ran;
}

// Lets every thread run until the block's next barrier or its end; returns whether any could. In the plain orders one warp
// runs as far as it can before the next one begins, which is as far apart as warps can be; shuffled, all go step by step.
inline bool run_round() {
  const int size = int(machine.team.size());
  if (machine.order == Order::kShuffled) return run_some(0, size);
  bool ran = false;
  for (int warp : in_order((size + 31) / 32))
    while (run_some(32 * warp, std::min(32 * warp + 32, size))) ran = true;
  return ran;
}

inline int count_threads(Thread::State state) {
  int count = 0;
  for (const Thread& thread : machine.team) count += thread.state == state;
  return count;
}

inline void run_block() {
  constexpr size_t kStackWords = 16384;
  const size_t size = machine.team.size();
  machine.stack_memory.resize(size * kStackWords);
  machine.warps.assign((size + 31) / 32, Warp());
  for (size_t i = 0; i < size; ++i) {
    machine.team[i].state = Thread::kReady;
    start_fiber(machine.team[i].fiber, &machine.stack_memory[i * kStackWords], kStackWords, thread_main);
  }
  for (;;) {
    if (run_round()) continue;
    if (count_threads(Thread::kDone) == int(size)) return;
    if (count_threads(Thread::kAtBarrier) != int(size))
      fail("deadlock: some threads wait at a barrier or in a warp operation that others don't reach");
    for (Thread& thread : machine.team) thread.state = Thread::kReady;
  }
}

inline void launch(void (*kernel)(const void*), const void* params, int blocks, int threads, int order, int seed) {
  machine.kernel = kernel, machine.params = params;
  machine.order = Order(order), machine.random.seed(unsigned(seed)), machine.error.clear();
  machine.blocks = {unsigned(blocks), 1, 1}, machine.threads = {unsigned(threads), 1, 1};
  machine.team.resize(size_t(threads));
  for (int block : in_order(blocks)) {
    machine.block = {unsigned(block), 0, 0};
    run_block();
  }
}

// Meets the other threads of the warp, and returns what lane `from` brought; from < 0: the lanes that brought non-zero.
inline uint64_t meet_warp(unsigned mask, Operation operation, uint64_t value, int from) {
  const int lane = machine.current % 32;
  Warp& warp = machine.warps[size_t(machine.current) / 32];
  if (mask != 0xffffffffu) fail("a warp operation with a partial mask");
  if (warp.arrived && warp.operation != operation) fail("threads of one warp in different operations");
  warp.operation = operation, warp.brought[lane] = value, warp.arrived |= 1u << lane;
  const int meeting = warp.meeting;
  if (warp.arrived == mask) {
    std::memcpy(warp.results[meeting], warp.brought, sizeof(warp.brought));
    warp.arrived = 0, warp.meeting = 1 - meeting;
    const size_t first = size_t(machine.current) / 32 * 32;
    for (size_t i = first; i < first + 32; ++i) machine.team[i].state = Thread::kReady;
  } else {
    give_way(Thread::kInWarp);
  }
  const uint64_t* results = warp.results[meeting];
  if (from >= 0) return results[from];
  uint64_t lanes = 0;
  for (int i = 0; i < 32; ++i) lanes |= uint64_t(results[i] != 0) << i;
  return lanes;
}

template <class T>
T exchange(unsigned mask, Operation operation, T value, int from) {
  static_assert(sizeof(T) <= sizeof(uint64_t));
  uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof(T));
  bits = meet_warp(mask, operation, bits, from);
  std::memcpy(&value, &bits, sizeof(T));
  return value;
}

inline int lane() { return machine.current % 32; }

}  // namespace shim

#define threadIdx (shim::machine.thread)
#define blockIdx (shim::machine.block)
#define blockDim (shim::machine.threads)
#define gridDim (shim::machine.blocks)

inline void __syncthreads() { shim::give_way(shim::Thread::kAtBarrier); }
inline void __syncwarp(unsigned mask = 0xffffffffu) { shim::meet_warp(mask, shim::Operation::kSync, 0, 0); }
inline unsigned __ballot_sync(unsigned mask, int predicate) {
  return unsigned(shim::meet_warp(mask, shim::Operation::kBallot, predicate != 0, -1));
}
inline int __any_sync(unsigned mask, int predicate) { return __ballot_sync(mask, predicate) != 0; }
inline int __all_sync(unsigned mask, int predicate) { return __ballot_sync(mask, predicate) == 0xffffffffu; }
template <class T>
T __shfl_up_sync(unsigned mask, T value, unsigned by) {
  const int from = shim::lane() - int(by);
  return shim::exchange(mask, shim::Operation::kShuffleUp, value, from < 0 ? shim::lane() : from);
}
template <class T>
T __shfl_down_sync(unsigned mask, T value, unsigned by) {
  const int from = shim::lane() + int(by);
  return shim::exchange(mask, shim::Operation::kShuffleDown, value, from > 31 ? shim::lane() : from);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T value, int by) {
  return shim::exchange(mask, shim::Operation::kShuffleXor, value, shim::lane() ^ by);
}
template <class T>
T __shfl_sync(unsigned mask, T value, int from) {
  return shim::exchange(mask, shim::Operation::kShuffle, value, from & 31);
}
// Each thread adds its own to what the block has so far; the sum is read after the barrier.
inline int __syncthreads_count(int predicate) {
  static int counts[2], turn = 0, arrived = 0;
  if (arrived == 0) counts[turn] = 0;
  counts[turn] += predicate != 0;
  const int here = turn;
  if (++arrived == int(blockDim.x)) arrived = 0, turn = 1 - turn;
  __syncthreads();
  return counts[here];
}

inline float __fmul_rn(float a, float b) { return a * b; }
inline float __fadd_rn(float a, float b) { return a + b; }
inline float __fdividef(float a, float b) { return a / b; }
inline unsigned __float_as_uint(float x) {
  unsigned bits;
  std::memcpy(&bits, &x, 4);
  return bits;
}
inline int __popc(unsigned x) { return __builtin_popcount(x); }
inline int __ffs(int x) { return __builtin_ffs(x); }

// For each kernel: what runs it for one thread, and the size of its parameters for the caller to compare.
#define MGSR_KERNEL(name, Params, threads)                              \
  static void name##_body(const Params& p);                             \
  extern "C" const size_t name##_size = sizeof(Params);                 \
  extern "C" const int name##_threads = threads;                        \
  extern "C" void name(const void* p) { name##_body(*static_cast<const Params*>(p)); } \
  static void name##_body(const Params& p)

// Runs a kernel; null, or what went wrong.
extern "C" inline __attribute__((used)) const char* shim_launch(void (*kernel)(const void*), const void* params, int blocks,
                                                                int threads, int order, int seed) {
  try {
    shim::launch(kernel, params, blocks, threads, order, seed);
    return nullptr;
  } catch (const std::exception& error) {
    shim::machine.error = error.what();
    return shim::machine.error.c_str();
  }
}
