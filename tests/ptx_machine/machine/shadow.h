// Who touched a place of memory last, for finding races.
//
// Two accesses of which one writes are ordered by a barrier of the block between them, or by a bar.warp.sync that both
// lanes take part in; nothing else orders them: shuffles and votes don't, and blocks never are.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

namespace ptx {

constexpr uint32_t kWarp = 32;

struct Access {
  uint32_t block, barriers, syncs;  // barriers of the block, and warp syncs of the thread, before it
  uint16_t thread, line;            // no access has line 0
};

// What a thread knows of the accesses of its own warp: those of a lane before its sync number known[lane] are ordered
// before everything that the thread does from here on.
struct Knowledge {
  std::array<uint32_t, kWarp> known{};
};

inline bool is_ordered(const Access& before, const Access& now, const Knowledge& knowledge) {
  if (before.block != now.block) return false;
  if (before.thread == now.thread || before.barriers != now.barriers) return true;
  return before.thread / kWarp == now.thread / kWarp && knowledge.known[before.thread % kWarp] > before.syncs;
}

// The last write of a unit of memory, and some of the reads since. Zero bytes are a cell that nobody touched.
struct Cell {
  Access write;
  Access reads[3];
};

// Where a read is kept: in the place of one that is ordered before it, or of none; else of one of the same warp, or the
// same block, so that readers of several blocks and warps stay.
inline Access& place_for_read(Cell& cell, const Access& now, const Knowledge& knowledge) {
  Access *free = nullptr, *of_warp = nullptr, *of_block = nullptr;
  for (Access& read : cell.reads) {
    if (read.line && is_ordered(read, now, knowledge)) return read;
    if (!read.line) {
      free = &read;
    } else if (read.block == now.block) {
      of_block = &read;
      if (read.thread / kWarp == now.thread / kWarp) of_warp = &read;
    }
  }
  return free ? *free : of_warp ? *of_warp : of_block ? *of_block : cell.reads[now.block % 3];
}

struct Conflict {
  Access access;
  bool is_write;
};

// Notes a read; returns the write that it races with.
inline std::optional<Conflict> note_read(Cell& cell, const Access& now, const Knowledge& knowledge) {
  place_for_read(cell, now, knowledge) = now;
  if (cell.write.line && !is_ordered(cell.write, now, knowledge)) return Conflict{cell.write, true};
  return std::nullopt;
}

// Notes a write; returns an access that it races with.
inline std::optional<Conflict> note_write(Cell& cell, const Access& now, const Knowledge& knowledge) {
  std::optional<Conflict> against;
  for (const Access& read : cell.reads)
    if (read.line && !is_ordered(read, now, knowledge)) against = Conflict{read, false};
  if (cell.write.line && !is_ordered(cell.write, now, knowledge)) against = Conflict{cell.write, true};
  cell = {now, {}};
  return against;
}

}  // namespace ptx
