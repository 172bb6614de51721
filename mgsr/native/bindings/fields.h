// Reads the structs of mgsr/native/structs.py, field by field and by name.
#pragma once

#include <string>
#include <unordered_map>
#include <vector>

#include "bindings/arrays.h"
#include "math/camera.h"

namespace mgsr {

// Returns a literal as Python's interned string, by which Python finds attributes faster. It is made once.
inline PyObject* interned(const char* literal) {
  static std::unordered_map<const char*, PyObject*> made;
  PyObject*& name = made[literal];
  if (!name) name = PyUnicode_InternFromString(literal);
  return name;
}

// The fields of a Python struct. Values that are read stay valid as long as the struct.
class Fields {
 public:
  // name: the argument's name, for errors. It and the names of fields must be literals.
  Fields(nb::handle given, const char* name) : given_(given), name_(name) {}

  nb::object get(const char* field) const {
    PyObject* value = PyObject_GetAttr(given_.ptr(), interned(field));
    if (!value) {
      PyErr_Clear();
      const std::string came = nb::type_name(given_.type()).c_str();
      throw nb::type_error((std::string(name_) + ": expected a struct with the field " + field + ", got " + came).c_str());
    }
    return nb::steal(value);
  }

  template <class A>
  A array(const char* field) const {
    return read<A>(get(field), field);
  }

  template <class A>
  A array_or_none(const char* field) const {
    const nb::object value = get(field);
    return value.is_none() ? A() : read<A>(value, field);
  }

  // Reads a sequence of arrays.
  template <class A>
  std::vector<A> arrays(const char* field) const {
    std::vector<A> found;
    for (const auto& each : value<std::vector<nb::object>>(field)) found.push_back(read<A>(each, field));
    return found;
  }

  // Returns the data of an array of any shape that must hold `size` values.
  template <class T>
  T* data(const char* field, int64_t size) const {
    return sized<T>(get(field), field, size);
  }

  template <class T>
  T* data_or_null(const char* field, int64_t size) const {
    const nb::object value = get(field);
    return value.is_none() ? nullptr : sized<T>(value, field, size);
  }

  // Reads a number, a string, or a sequence or tuple of them.
  template <class T>
  T value(const char* field) const {
    const nb::object given = get(field);
    T value;
    if (!nb::try_cast(given, value)) {
      const std::string came = nb::repr(given).c_str();
      throw nb::type_error((path(field) + ": expected a value of another type, got " + came).c_str());
    }
    return value;
  }

  std::string path(const char* field) const { return std::string(name_) + "." + field; }

 private:
  template <class T>
  T* sized(const nb::object& value, const char* field, int64_t size) const {
    const auto array = read<Array<T>>(value, field);
    if (int64_t(array.size()) != size)
      throw std::invalid_argument(path(field) + ": expected " + std::to_string(size) + " values, got " +
                                  std::to_string(array.size()));
    return array.data();
  }

  template <class A>
  A read(const nb::object& value, const char* field) const {
    A array;
    if (!nb::try_cast(value, array, false)) refuse<A>(value, path(field));
    return array;
  }

  nb::handle given_;
  const char* name_;
};

// Reads a camera. Its matrices are converted, since they are small.
inline Camera<float> camera_of(nb::handle given) {
  using Matrix = Array<const double, nb::ndim<2>>;
  const Fields fields(given, "camera");
  const auto K = fields.value<Matrix>("K"), pose = fields.value<Matrix>("cam_from_world");
  expect(K.shape(0) == 3 && K.shape(1) == 3, "camera.K: expected [3, 3]");
  expect(pose.shape(0) == 4 && pose.shape(1) == 4, "camera.cam_from_world: expected [4, 4]");
  Camera<float> camera;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) camera.R[3 * i + j] = float(pose(i, j));
    camera.t[i] = float(pose(i, 3));
  }
  camera.fx = float(K(0, 0)), camera.fy = float(K(1, 1)), camera.cx = float(K(0, 2)), camera.cy = float(K(1, 2));
  camera.width = float(fields.value<int>("width")), camera.height = float(fields.value<int>("height"));
  return camera;
}

}  // namespace mgsr
