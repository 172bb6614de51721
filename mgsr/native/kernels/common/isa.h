// The choice of the compiled variant that kernel calls use. Each bindings file instantiates one choice for its family.
#pragma once

#include <stdexcept>
#include <string>
#include <vector>

namespace mgsr {

inline bool processor_has(const std::string& isa) {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (isa == "avx512")
    return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq") &&
           __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
  if (isa == "avx2") return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
#endif
  return isa == "baseline";
}

// Returns the compiled variants that this processor can run, fastest first.
inline std::vector<std::string> usable_isas() {
  std::vector<std::string> names;
#if defined(MGSR_HAVE_avx512)
  if (processor_has("avx512")) names.push_back("avx512");
#endif
#if defined(MGSR_HAVE_avx2)
  if (processor_has("avx2")) names.push_back("avx2");
#endif
  names.push_back("baseline");
  return names;
}

// Table is a struct of function pointers. The tables come fastest first, as the names of usable_isas do.
template <class Table>
class IsaChoice {
 public:
  IsaChoice(const Table* avx512, const Table* avx2, const Table* baseline)
      : avx512_(avx512), avx2_(avx2), baseline_(baseline) {
    choose(usable_isas().front());
  }

  void choose(const std::string& isa) {
    for (const auto& name : usable_isas())
      if (name == isa) {
        name_ = isa;
        current_ = isa == "avx512" ? avx512_ : isa == "avx2" ? avx2_ : baseline_;
        return;
      }
    throw std::invalid_argument("isa: expected one that this processor runs, got " + isa);
  }

  const Table* operator->() const { return current_; }
  const std::string& name() const { return name_; }

 private:
  const Table *avx512_, *avx2_, *baseline_;
  const Table* current_ = nullptr;
  std::string name_;
};

}  // namespace mgsr
