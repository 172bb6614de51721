// The memory that a kernel sees: checks every access, and watches for races and for reads before the first write.
#pragma once

#include <cstdlib>
#include <memory>

#include "problems.h"

namespace ptx {

enum class Kind { kRead, kWrite };

inline const char* name_of(Kind kind) { return kind == Kind::kRead ? "read" : "write"; }

struct Range {
  uint64_t begin, bytes;
};

// The cells of a stretch of memory, one for each `unit` bytes: the smallest access that the kernel makes there, so that
// neighbours that two threads write are not taken for one place.
class Cells {
 public:
  Cells(uint64_t begin, uint64_t end, int unit)
      : unit_(uint64_t(unit)), first_(begin / unit_), cells_(allocate((end + unit_ - 1) / unit_ - first_)) {}

  template <class Visit>
  void visit(uint64_t address, int bytes, const Visit& visit_cell) {
    for (uint64_t unit = address / unit_; unit * unit_ < address + uint64_t(bytes); ++unit)
      visit_cell(cells_.get()[unit - first_]);
  }

 private:
  struct Free {
    void operator()(Cell* cells) const { std::free(cells); }
  };
  // Zeros by calloc: of a large tensor, only what is touched takes memory.
  static Cell* allocate(uint64_t count) {
    void* cells = std::calloc(count ? count : 1, sizeof(Cell));
    if (!cells) throw Fault("no memory for watching " + std::to_string(count) + " places");
    return static_cast<Cell*>(cells);
  }

  uint64_t unit_, first_;
  std::unique_ptr<Cell, Free> cells_;
};

// What global memory consists of in a launch: the tensors handed over, and the module's own variables.
class GlobalMemory {
 public:
  // Ranges that overlap, such as a tensor and a part of it, are one region.
  void start(std::vector<Range> ranges, int unit) {
    regions_.clear();
    std::sort(ranges.begin(), ranges.end(), [](const Range& a, const Range& b) { return a.begin < b.begin; });
    for (size_t i = 0; i < ranges.size();) {
      const uint64_t begin = ranges[i].begin;
      uint64_t end = begin;
      do end = std::max(end, ranges[i].begin + ranges[i].bytes);
      while (++i < ranges.size() && ranges[i].begin < end);
      regions_.push_back({begin, end, Cells(begin, end, unit)});
    }
  }
  void stop() { regions_.clear(); }

  // The cells of an access, or null where a byte of it lies in no region.
  Cells* find(uint64_t address, int bytes) {
    auto region = std::upper_bound(regions_.begin(), regions_.end(), address,
                                   [](uint64_t a, const Region& r) { return a < r.begin; });
    if (region == regions_.begin()) return nullptr;
    --region;
    return address <= region->end && uint64_t(bytes) <= region->end - address ? &region->cells : nullptr;
  }

 private:
  struct Region {
    uint64_t begin, end;
    Cells cells;
  };
  std::vector<Region> regions_;
};

// The arrays of a block. Between them lie bytes that belong to none.
class SharedMemory {
 public:
  void start(size_t bytes, const Range* arrays, int count, int unit) {
    arrays_.assign(arrays, arrays + count);
    memory_.assign(bytes, 0);
    states_.assign(bytes, kOutside);
    unit_ = unit;
  }
  // Garbage that is neither zero nor a number, as a GPU leaves other blocks' values.
  void start_block() {
    cells_ = std::make_unique<Cells>(0, memory_.size(), unit_);
    std::fill(memory_.begin(), memory_.end(), (unsigned char)(0xff));
    for (const Range& array : arrays_)
      std::fill_n(states_.begin() + long(array.begin), array.bytes, (unsigned char)(kUnwritten));
  }
  bool holds(uint64_t offset, int bytes) const {
    if (offset > states_.size() || uint64_t(bytes) > states_.size() - offset) return false;
    for (uint64_t i = offset; i < offset + uint64_t(bytes); ++i)
      if (states_[i] == kOutside) return false;
    return true;
  }
  bool is_written(uint64_t offset, int bytes) const {
    return std::count(&states_[offset], &states_[offset] + bytes, (unsigned char)(kWritten)) == bytes;
  }
  void mark_written(uint64_t offset, int bytes) { std::fill_n(&states_[offset], bytes, (unsigned char)(kWritten)); }
  unsigned char* data() { return memory_.data(); }
  size_t size() const { return memory_.size(); }
  Cells& cells() { return *cells_; }

 private:
  enum State : unsigned char { kOutside, kUnwritten, kWritten };
  std::vector<Range> arrays_;
  std::vector<unsigned char> memory_, states_;
  int unit_ = 1;
  std::unique_ptr<Cells> cells_;
};

struct Memory {
  GlobalMemory global;
  SharedMemory shared;
  const unsigned char* params = nullptr;
  size_t params_bytes = 0, local_bytes = 0;
  uint32_t barriers = 0;  // that the running block has passed
  Problems problems, unwritten;
};

inline Memory memory;

[[noreturn]] inline void fault_outside(const Thread& thread, const char* space, Kind kind, int bytes, int line) {
  throw Fault(std::string("out of bounds: ") + name_of(kind) + " of " + std::to_string(bytes) + " bytes of " + space +
              " memory" + at(line) + " (" + who(thread) + ")");
}

inline void check_alignment(const Thread& thread, const char* space, uint64_t address, int bytes, int line) {
  if (address % uint64_t(bytes) == 0) return;
  throw Fault(std::string("misaligned: access of ") + std::to_string(bytes) + " bytes of " + space +
              " memory at an address that is no multiple of it," + at(line) + " (" + who(thread) + ")");
}

inline void report_race(const Thread& thread, const char* space, Kind kind, int line, const Conflict& with) {
  const Access& before = with.access;
  memory.problems.add(std::string("race: ") + name_of(kind) + " of " + space + " memory" + at(line) +
                          " is not ordered after the " + name_of(with.is_write ? Kind::kWrite : Kind::kRead) +
                          at(before.line),
                      who(thread) + " after " + who(before.block, before.thread));
}

inline void watch(const Thread& thread, Cells& cells, const char* space, uint64_t address, int bytes, Kind kind, int line) {
  const Access now{thread.block, memory.barriers, thread.syncs, uint16_t(thread.index), uint16_t(line)};
  cells.visit(address, bytes, [&](Cell& cell) {
    const auto note = kind == Kind::kRead ? note_read : note_write;
    if (const auto conflict = note(cell, now, thread.knowledge)) report_race(thread, space, kind, line, *conflict);
  });
}

// Where an access goes on this machine. Each takes the address as the kernel computed it, and the bytes of the whole
// access, of a vector too.
inline unsigned char* global_at(const Thread& thread, uint64_t address, int bytes, Kind kind, int line) {
  Cells* cells = memory.global.find(address, bytes);
  if (!cells) fault_outside(thread, "global", kind, bytes, line);
  check_alignment(thread, "global", address, bytes, line);
  watch(thread, *cells, "global", address, bytes, kind, line);
  return reinterpret_cast<unsigned char*>(address);
}

inline unsigned char* shared_at(const Thread& thread, uint64_t offset, int bytes, Kind kind, int line) {
  if (!memory.shared.holds(offset, bytes)) fault_outside(thread, "shared", kind, bytes, line);
  check_alignment(thread, "shared", offset, bytes, line);
  if (kind == Kind::kWrite) memory.shared.mark_written(offset, bytes);
  else if (!memory.shared.is_written(offset, bytes))
    memory.unwritten.add("uninitialised: read of shared memory that nothing wrote" + at(line), who(thread));
  watch(thread, memory.shared.cells(), "shared", offset, bytes, kind, line);
  return memory.shared.data() + offset;
}

inline bool is_within(uint64_t address, int bytes, const unsigned char* begin, size_t size) {
  const uint64_t first = reinterpret_cast<uint64_t>(begin);
  return address >= first && address - first <= size && uint64_t(bytes) <= size - (address - first);
}

inline unsigned char* local_at(const Thread& thread, uint64_t address, int bytes, Kind kind, int line) {
  if (!is_within(address, bytes, thread.local, memory.local_bytes)) fault_outside(thread, "local", kind, bytes, line);
  check_alignment(thread, "local", address, bytes, line);
  return reinterpret_cast<unsigned char*>(address);
}

inline const unsigned char* param_at(const Thread& thread, uint64_t address, int bytes, Kind kind, int line) {
  if (!is_within(address, bytes, memory.params, memory.params_bytes)) fault_outside(thread, "parameter", kind, bytes, line);
  return reinterpret_cast<const unsigned char*>(address);
}

// An address that may be of any space: shared memory's are its window's here, the others are equal in all spaces.
inline uint64_t generic_of_shared(uint64_t offset) { return reinterpret_cast<uint64_t>(memory.shared.data()) + offset; }
inline uint64_t shared_of_generic(uint64_t address) { return address - reinterpret_cast<uint64_t>(memory.shared.data()); }

inline unsigned char* generic_at(const Thread& thread, uint64_t address, int bytes, Kind kind, int line) {
  if (is_within(address, 0, memory.shared.data(), memory.shared.size()))
    return shared_at(thread, shared_of_generic(address), bytes, kind, line);
  if (is_within(address, 0, thread.local, memory.local_bytes)) return local_at(thread, address, bytes, kind, line);
  if (is_within(address, 0, memory.params, memory.params_bytes) && kind == Kind::kRead)
    return const_cast<unsigned char*>(param_at(thread, address, bytes, kind, line));
  return global_at(thread, address, bytes, kind, line);
}

}  // namespace ptx
