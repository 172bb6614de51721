// Sizes of images that belong together.
#pragma once

#include "bindings/arrays.h"

namespace mgsr {

// Requires that b, if it is given, has as many rows and columns as a.
template <class A, class B>
void expect_same_size(const A& a, const B& b, const char* message) {
  expect(!b.is_valid() || (a.shape(0) == b.shape(0) && a.shape(1) == b.shape(1)), message);
}

}  // namespace mgsr
