// Array arguments of the bindings, and what every family exposes beside its kernels.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <stdexcept>
#include <string>

#include "kernels/common/isa.h"
#include "kernels/common/parallel.h"

namespace mgsr {

namespace nb = nanobind;

template <class T, class... Options>
using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu, Options...>;

// An array argument that may be None: its pointer, or null.
template <class A>
auto pointer_or_null(const A& array) {
  return array.is_valid() ? array.data() : nullptr;
}

inline void expect(bool holds, const char* message) {
  if (!holds) throw std::invalid_argument(message);
}

// isas(), isa(), set_isa(name), set_threads(n): the same in every family.
template <class Table>
void bind_choices(nb::module_& m, IsaChoice<Table>& choice) {
  m.def("isas", [] { return usable_isas(); }, "Variants that this processor runs, fastest first.");
  m.def("isa", [&choice] { return choice.name(); }, "The variant in use.");
  m.def("set_isa", [&choice](const std::string& name) { choice.choose(name); }, nb::arg("name"));
  m.def("threads", [] { return ThreadPool::instance().threads(); });
  m.def(
      "set_threads", [](int n) { ThreadPool::instance().set_threads(n); }, nb::arg("n"),
      "Threads of the kernels; 0 means all processors of this process.");
}

}  // namespace mgsr

// The three tables of a family, null where a variant was not compiled.
#if defined(MGSR_HAVE_avx512)
#define MGSR_TABLES(table) &mgsr::avx512::table, &mgsr::avx2::table, &mgsr::baseline::table
#else
#define MGSR_TABLES(table) nullptr, nullptr, &mgsr::baseline::table
#endif
