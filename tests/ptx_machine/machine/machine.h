// Executes kernels that were translated from PTX: independent threads, which meet where the PTX has them meet.
#pragma once

#include <random>

#include "comparisons.h"
#include "conversions.h"
#include "warps.h"

namespace ptx {

// A translated kernel. run: goes on with a thread until its next meeting, and returns whether there was one.
struct Kernel {
  const char* name;
  bool (*run)(Thread&);
  size_t register_bytes, shared_bytes, local_bytes, params_bytes;
  uint32_t most_threads;
  int global_unit, shared_unit;
  const Range* shared_arrays;
  int shared_array_count;
};

// Given by the translated module: its kernels, up to one without a name, and its variables, up to one without bytes.
extern const Kernel kernels[];
extern const Range variables[];

// As ctypes lays it out in launcher.py.
struct Launch {
  const char* kernel;
  const unsigned char* params;
  uint64_t params_bytes;
  const Range* tensors;
  int32_t tensor_count;
  uint32_t blocks, threads;
  int32_t order, seed, noise_ulps;
};

enum class Order : int32_t { kAscending, kDescending, kShuffled };

struct Machine {
  const Kernel* kernel = nullptr;
  uint32_t blocks = 0, threads = 0;
  Order order = Order::kAscending;
  std::mt19937 random;
  std::vector<Thread> team;
  std::vector<uint64_t> registers, locals;
};

inline Machine machine;

inline std::vector<uint32_t> in_order(uint32_t count) {
  std::vector<uint32_t> order(count);
  for (uint32_t i = 0; i < count; ++i) order[i] = machine.order == Order::kDescending ? count - 1 - i : i;
  if (machine.order == Order::kShuffled) std::shuffle(order.begin(), order.end(), machine.random);
  return order;
}

inline Warp warp_of(const Thread& thread) {
  const uint32_t first = thread.index / kWarp * kWarp;
  return {&machine.team[first], std::min<uint32_t>(kWarp, machine.threads - first)};
}

inline void run_thread(Thread& thread) {
  if (!machine.kernel->run(thread)) {
    thread.state = Thread::kDone;
  } else if (thread.meeting.operation < Operation::kSyncWarp) {
    thread.state = Thread::kAtBarrier;
  } else {
    thread.state = Thread::kInWarp;
    meet(warp_of(thread), thread);
  }
}

// Lets those of the threads [begin, end) that can run do so until their next meeting; returns whether any could.
inline bool run_some(uint32_t begin, uint32_t end) {
  bool ran = false;
  for (uint32_t index : in_order(end - begin)) {
    Thread& thread = machine.team[begin + index];
    if (thread.state != Thread::kReady) continue;
    run_thread(thread);
    ran = true;
  }
  return ran;
}

// Lets every thread run until the block's next barrier or its end; returns whether any could. In the plain orders one warp
// runs as far as it can before the next one begins, which is as far apart as warps can be; shuffled, all go step by step.
inline bool run_round() {
  if (machine.order == Order::kShuffled) return run_some(0, machine.threads);
  bool ran = false;
  for (uint32_t warp : in_order((machine.threads + kWarp - 1) / kWarp))
    while (run_some(warp * kWarp, std::min(warp * kWarp + kWarp, machine.threads))) ran = true;
  return ran;
}

inline const Thread* find(Thread::State state) {
  for (const Thread& thread : machine.team)
    if (thread.state == state) return &thread;
  return nullptr;
}

// No thread can run: all have left, or all wait at the barrier, or there is a fault. Returns whether the block goes on.
inline bool go_on_together() {
  const Thread *left = find(Thread::kDone), *waits = find(Thread::kAtBarrier), *in_warp = find(Thread::kInWarp);
  if (in_warp) {
    are_all_there(warp_of(*in_warp), *in_warp);
    fault_in_warp(*in_warp, "lanes of its mask have diverged and wait at a barrier of the block");
  }
  if (!waits) return false;
  if (left)
    throw Fault("divergent barrier:" + at(waits->meeting.line) + " (" + who(*waits) + ") waits for thread " +
                std::to_string(left->index) + ", which has left the kernel");
  pass_barrier(machine.team);
  return true;
}

inline size_t in_words(size_t bytes) { return (bytes + 15) / 16 * 2; }  // of 8 bytes, whole pieces of 16

// Every register and local byte begins as garbage.
inline void start_block(uint32_t block) {
  constexpr uint64_t kGarbage = 0xabababababababab;
  const size_t registers = in_words(machine.kernel->register_bytes), locals = in_words(machine.kernel->local_bytes);
  machine.registers.assign(machine.threads * registers, kGarbage);
  machine.locals.assign(machine.threads * locals + 2, kGarbage);
  uint64_t* first_local = machine.locals.data() + (reinterpret_cast<uint64_t>(machine.locals.data()) % 16 ? 1 : 0);
  for (uint32_t i = 0; i < machine.threads; ++i) {
    Thread& thread = machine.team[i] = Thread();
    thread.index = i, thread.block = block;
    thread.registers = machine.registers.data() + i * registers;
    thread.local = reinterpret_cast<unsigned char*>(first_local + i * locals);
  }
  memory.shared.start_block();
  memory.barriers = 0;
}

inline void run_block(uint32_t block) {
  start_block(block);
  do {
    while (run_round()) {
    }
  } while (go_on_together());
}

inline const Kernel& find_kernel(const Launch& launch) {
  for (const Kernel* kernel = kernels; kernel->name; ++kernel) {
    if (std::strcmp(kernel->name, launch.kernel) != 0) continue;
    if (kernel->params_bytes != launch.params_bytes)
      throw Fault("expected " + std::to_string(kernel->params_bytes) + " bytes of parameters, got " +
                  std::to_string(launch.params_bytes));
    if (launch.threads == 0 || launch.threads > kernel->most_threads)
      throw Fault("declared for 1 to " + std::to_string(kernel->most_threads) + " threads a block, launched with " +
                  std::to_string(launch.threads));
    return *kernel;
  }
  throw Fault("the module has no kernel of that name");
}

inline void prepare(const Launch& launch) {
  memory.problems.clear(), memory.unwritten.clear();
  const Kernel& kernel = find_kernel(launch);
  machine.kernel = &kernel, machine.blocks = launch.blocks, machine.threads = launch.threads;
  machine.order = Order(launch.order), machine.random.seed(uint32_t(launch.seed));
  machine.team.resize(launch.threads);
  noise_ulps = launch.noise_ulps;
  std::vector<Range> ranges(launch.tensors, launch.tensors + launch.tensor_count);
  for (const Range* variable = variables; variable->bytes; ++variable) ranges.push_back(*variable);
  memory.global.start(ranges, kernel.global_unit);
  memory.shared.start(kernel.shared_bytes, kernel.shared_arrays, kernel.shared_array_count, kernel.shared_unit);
  memory.params = launch.params, memory.params_bytes = launch.params_bytes, memory.local_bytes = kernel.local_bytes;
}

}  // namespace ptx

// Runs a kernel. Null, or what is wrong with it.
extern "C" const char* ptx_launch(const ptx::Launch* launch) {
  static std::string result;
  result.clear();
  try {
    ptx::prepare(*launch);
    for (uint32_t block : ptx::in_order(launch->blocks)) ptx::run_block(block);
  } catch (const ptx::Fault& fault) {
    result = fault.what();
  }
  ptx::memory.global.stop();
  if (ptx::memory.problems.any()) result += (result.empty() ? "" : "\n") + ptx::memory.problems.text();
  return result.empty() ? nullptr : result.c_str();
}

// Of the last launch: which reads of shared memory came before any write, or null. A kernel may make them and not use
// what it reads.
extern "C" const char* ptx_unwritten_reads() {
  static std::string result;
  result = ptx::memory.unwritten.text();
  return result.empty() ? nullptr : result.c_str();
}
