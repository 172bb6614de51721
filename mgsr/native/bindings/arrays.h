// Array arguments of the bindings, and the functions that every family exposes beside its kernels. Arguments come as
// handles and are read by name, so that an error tells what was expected and what came. The types are in the stubs.
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

// Describes an argument for an error: an array's dtype, shape, layout and device, or the name of another type.
inline std::string describe(nb::handle given) {
  nb::ndarray<nb::ro> array;
  if (given.is_none() || !nb::try_cast(given, array, false)) return nb::type_name(given.type()).c_str();
  const auto dtype = array.dtype();
  const auto code = nb::dlpack::dtype_code(dtype.code);
  std::string text = code == nb::dlpack::dtype_code::Float  ? "float"
                     : code == nb::dlpack::dtype_code::Int  ? "int"
                     : code == nb::dlpack::dtype_code::UInt ? "uint"
                     : code == nb::dlpack::dtype_code::Bool ? "bool"
                                                            : "another dtype of ";
  text += std::to_string(dtype.bits) + " [";
  int64_t packed = 1;
  bool contiguous = true;
  for (size_t i = array.ndim(); i-- > 0; packed *= int64_t(array.shape(i)))
    contiguous &= array.shape(i) <= 1 || array.stride(i) == packed;
  for (size_t i = 0; i < array.ndim(); ++i) text += (i ? ", " : "") + std::to_string(array.shape(i));
  text += contiguous ? "]" : "], not contiguous";
  return array.device_type() == nb::device::cpu::value ? text : text + ", on another device";
}

template <class A>
[[noreturn]] void refuse(nb::handle given, const std::string& name) {
  const std::string expected = nb::detail::make_caster<A>::Name.text;
  throw nb::type_error((name + ": expected " + expected + ", got " + describe(given)).c_str());
}

// Reads the array argument of a name. It is never converted, because the kernel would write to a copy.
template <class A>
A read(nb::handle given, const char* name) {
  A array;
  if (!nb::try_cast(given, array, false)) refuse<A>(given, name);
  return array;
}

// Reads an array argument; None gives an invalid array.
template <class A>
A read_or_none(nb::handle given, const char* name) {
  return given.is_none() ? A() : read<A>(given, name);
}

// Returns the pointer of an array, or null if it is None.
template <class A>
auto pointer_or_null(const A& array) {
  return array.is_valid() ? array.data() : nullptr;
}

inline void expect(bool holds, const char* message) {
  if (!holds) throw std::invalid_argument(message);
}

// Binds isas(), isa(), set_isa(name), threads() and set_threads(n), which every family has.
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

// The three tables of a family, null if a variant was not compiled.
#if defined(MGSR_HAVE_avx512)
#define MGSR_TABLES(table) &mgsr::avx512::table, &mgsr::avx2::table, &mgsr::baseline::table
#else
#define MGSR_TABLES(table) nullptr, nullptr, &mgsr::baseline::table
#endif
