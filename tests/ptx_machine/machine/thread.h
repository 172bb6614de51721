// A thread of a kernel, and what it brings to a meeting with others.
#pragma once

#include "shadow.h"

namespace ptx {

enum class Operation {
  kBarrier, kBarrierPopc, kBarrierAnd, kBarrierOr,  // of the block; those of a warp follow
  kSyncWarp, kShuffleUp, kShuffleDown, kShuffleXor, kShuffleIndex,
  kVoteAll, kVoteAny, kVoteUniform, kBallot, kMatchAny, kMatchAll,
  kReduceAdd, kReduceMin, kReduceMinSigned, kReduceMax, kReduceMaxSigned, kReduceAnd, kReduceOr, kReduceXor, kElect,
};

struct Meeting {
  Operation operation = Operation::kBarrier;
  int line = 0;
  uint32_t mask = 0;
  uint64_t value = 0;
  uint32_t lane = 0, clamp = 0;  // a shuffle's operands b and c
  bool predicate = false;
  uint32_t* result = nullptr;
  bool* flag = nullptr;
};

struct Thread {
  enum State { kReady, kAtBarrier, kInWarp, kDone } state = kReady;
  uint32_t index = 0, block = 0;
  int resume = 0;  // which meeting its function goes on after
  void* registers = nullptr;
  unsigned char* local = nullptr;
  Meeting meeting;
  uint32_t syncs = 0;  // warp syncs that it took part in
  Knowledge knowledge;
};

inline uint32_t lane_of(const Thread& thread) { return thread.index % kWarp; }

// What a kernel's function does before it gives way to the others that meet it.
inline void go_to_barrier(Thread& thread, int line, Operation operation, bool predicate, uint32_t* result, bool* flag) {
  thread.meeting = {operation, line, 0, 0, 0, 0, predicate, result, flag};
}
inline void go_to_warp(Thread& thread, int line, Operation operation, uint32_t mask, uint64_t value = 0,
                       uint32_t* result = nullptr, bool* flag = nullptr) {
  thread.meeting = {operation, line, mask, value, 0, 0, value != 0, result, flag};
}
inline void go_to_shuffle(Thread& thread, int line, Operation operation, uint32_t mask, uint32_t value, uint32_t lane,
                          uint32_t clamp, uint32_t* result, bool* flag) {
  thread.meeting = {operation, line, mask, value, lane, clamp, false, result, flag};
}

}  // namespace ptx
