// Barriers of a block and operations of a warp, once all that take part are there.
#pragma once

#include "integers.h"
#include "memory.h"

namespace ptx {

// The lanes of one warp, some of which a block of an odd size lacks.
struct Warp {
  Thread* lanes;
  uint32_t count;
};

template <class Visit>
void visit_lanes(const Warp& warp, uint32_t mask, const Visit& visit) {
  for (uint32_t lane = 0; lane < warp.count; ++lane)
    if (mask >> lane & 1) visit(warp.lanes[lane]);
}

[[noreturn]] inline void fault_in_warp(const Thread& thread, const std::string& what) {
  throw Fault("warp operation" + at(thread.meeting.line) + ": " + what + " (" + who(thread) + ")");
}

[[noreturn]] inline void fault_with(const Thread& thread, const Thread& other, const std::string& what) {
  fault_in_warp(thread, "its mask names lane " + std::to_string(lane_of(other)) + ", " + what);
}

// Whether all lanes that a waiting thread's mask names wait for it too. Faults where they never can.
inline bool are_all_there(const Warp& warp, const Thread& thread) {
  const Meeting& meeting = thread.meeting;
  if (!(meeting.mask >> lane_of(thread) & 1)) fault_in_warp(thread, "the lane is not in its own mask");
  if (warp.count < kWarp && meeting.mask >> warp.count) fault_in_warp(thread, "its mask names lanes that the block lacks");
  bool complete = true;
  visit_lanes(warp, meeting.mask, [&](const Thread& other) {
    if (other.state == Thread::kDone) fault_with(thread, other, "which has left the kernel");
    complete = complete && other.state == Thread::kInWarp;
    if (other.state != Thread::kInWarp) return;
    if (other.meeting.line != meeting.line)
      fault_with(thread, other, "which has diverged and is in another" + at(other.meeting.line));
    if (other.meeting.mask != meeting.mask) fault_with(thread, other, "which has another mask");
  });
  return complete;
}

inline void sync_warp(const Warp& warp, uint32_t mask) {
  Knowledge all;
  visit_lanes(warp, mask, [&](Thread& thread) {
    thread.knowledge.known[lane_of(thread)] = ++thread.syncs;
    for (uint32_t i = 0; i < kWarp; ++i) all.known[i] = std::max(all.known[i], thread.knowledge.known[i]);
  });
  visit_lanes(warp, mask, [&](Thread& thread) { thread.knowledge = all; });
}

struct Source {
  uint32_t lane;
  bool is_in_segment;
};

// The lane that a shuffle reads from, by PTX's definition of its clamp and segment mask.
inline Source source_of_shuffle(uint32_t lane, const Meeting& meeting) {
  const uint32_t by = meeting.lane & 31, clamp = meeting.clamp & 31, segments = meeting.clamp >> 8 & 31;
  const int32_t last = int32_t((lane & segments) | (clamp & ~segments));
  int32_t from = 0;
  switch (meeting.operation) {
    case Operation::kShuffleUp: from = int32_t(lane) - int32_t(by); break;
    case Operation::kShuffleDown: from = int32_t(lane + by); break;
    case Operation::kShuffleXor: from = int32_t(lane ^ by); break;
    default: from = int32_t((lane & segments) | (by & ~segments));
  }
  const bool inside = meeting.operation == Operation::kShuffleUp ? from >= last : from <= last;
  return {inside ? uint32_t(from) : lane, inside};
}

inline void shuffle(const Warp& warp, uint32_t mask) {
  uint32_t results[kWarp] = {};
  visit_lanes(warp, mask, [&](const Thread& thread) {
    const Source source = source_of_shuffle(lane_of(thread), thread.meeting);
    if (!(mask >> source.lane & 1))
      fault_in_warp(thread, "reads from lane " + std::to_string(source.lane) + ", which its mask leaves out");
    results[lane_of(thread)] = uint32_t(warp.lanes[source.lane].meeting.value);
  });
  visit_lanes(warp, mask, [&](const Thread& thread) {
    if (thread.meeting.result) *thread.meeting.result = results[lane_of(thread)];
    if (thread.meeting.flag) *thread.meeting.flag = source_of_shuffle(lane_of(thread), thread.meeting).is_in_segment;
  });
}

inline void match(const Warp& warp, uint32_t mask, bool all) {
  visit_lanes(warp, mask, [&](const Thread& thread) {
    uint32_t equal = 0;
    visit_lanes(warp, mask, [&](const Thread& other) {
      equal |= uint32_t(other.meeting.value == thread.meeting.value) << lane_of(other);
    });
    const bool whole = equal == mask;
    if (thread.meeting.result) *thread.meeting.result = all && !whole ? 0 : equal;
    if (thread.meeting.flag) *thread.meeting.flag = whole;
  });
}

inline uint32_t combine(Operation operation, uint32_t a, uint32_t b) {
  switch (operation) {
    case Operation::kReduceAdd: return a + b;
    case Operation::kReduceMin: return std::min(a, b);
    case Operation::kReduceMinSigned: return uint32_t(std::min(int32_t(a), int32_t(b)));
    case Operation::kReduceMax: return std::max(a, b);
    case Operation::kReduceMaxSigned: return uint32_t(std::max(int32_t(a), int32_t(b)));
    case Operation::kReduceAnd: return a & b;
    case Operation::kReduceOr: return a | b;
    default: return a ^ b;
  }
}

inline void reduce(const Warp& warp, uint32_t mask, Operation operation) {
  uint32_t result = 0;
  bool first = true;
  visit_lanes(warp, mask, [&](const Thread& thread) {
    const uint32_t value = uint32_t(thread.meeting.value);
    result = first ? value : combine(operation, result, value);
    first = false;
  });
  visit_lanes(warp, mask, [&](const Thread& thread) { *thread.meeting.result = result; });
}

inline void vote(const Warp& warp, uint32_t mask, Operation operation) {
  uint32_t ballot = 0;
  visit_lanes(warp, mask, [&](const Thread& t) { ballot |= uint32_t(t.meeting.predicate) << lane_of(t); });
  const bool all = ballot == mask, any = ballot != 0;
  const bool flag = operation == Operation::kVoteAll ? all : operation == Operation::kVoteAny ? any : all || !any;
  visit_lanes(warp, mask, [&](const Thread& thread) {
    if (operation == Operation::kBallot) *thread.meeting.result = ballot;
    else *thread.meeting.flag = flag;
  });
}

inline void elect(const Warp& warp, uint32_t mask) {
  const uint32_t lowest = uint32_t(__builtin_ctz(mask));
  visit_lanes(warp, mask, [&](const Thread& thread) {
    if (thread.meeting.result) *thread.meeting.result = lowest;
    *thread.meeting.flag = lane_of(thread) == lowest;
  });
}

// Does what the lanes of a mask have met for, and lets them go on.
inline void perform(const Warp& warp, Operation operation, uint32_t mask) {
  switch (operation) {
    case Operation::kSyncWarp: sync_warp(warp, mask); break;
    case Operation::kShuffleUp: case Operation::kShuffleDown: case Operation::kShuffleXor: case Operation::kShuffleIndex:
      shuffle(warp, mask); break;
    case Operation::kVoteAll: case Operation::kVoteAny: case Operation::kVoteUniform: case Operation::kBallot:
      vote(warp, mask, operation); break;
    case Operation::kMatchAny: match(warp, mask, false); break;
    case Operation::kMatchAll: match(warp, mask, true); break;
    case Operation::kElect: elect(warp, mask); break;
    default: reduce(warp, mask, operation);
  }
  visit_lanes(warp, mask, [](Thread& thread) { thread.state = Thread::kReady; });
}

// Whether a thread that has come to a warp operation was the last one missing; then the operation is done.
inline bool meet(const Warp& warp, const Thread& thread) {
  if (!are_all_there(warp, thread)) return false;
  perform(warp, thread.meeting.operation, thread.meeting.mask);
  return true;
}

// Lets a block pass its barrier, where every thread waits.
inline void pass_barrier(std::vector<Thread>& team) {
  uint32_t count = 0;
  for (const Thread& thread : team) count += thread.meeting.predicate;
  for (Thread& thread : team) {
    const Meeting& meeting = thread.meeting;
    if (meeting.line != team[0].meeting.line)
      throw Fault("divergent barrier: threads of a block wait at different ones," + at(meeting.line) + " and" +
                  at(team[0].meeting.line) + " (" + who(thread) + ")");
    if (meeting.operation == Operation::kBarrierPopc) *meeting.result = count;
    if (meeting.operation == Operation::kBarrierAnd) *meeting.flag = count == team.size();
    if (meeting.operation == Operation::kBarrierOr) *meeting.flag = count != 0;
    thread.state = Thread::kReady;
  }
  ++memory.barriers;
}

}  // namespace ptx
