// The C ABI. Every function takes flat arrays and records (records.hpp) that the caller keeps, and its kernels' type is the
// end of its name. Those that take scratch return what is below zero, or above it where they return nothing else, if that
// was too small.
#pragma once
#include "records.hpp"

#ifdef WITH_DOUBLES
#define INSTANCES FOR_TYPE(float, f32) FOR_TYPE(double, f64)
#else
#define INSTANCES FOR_TYPE(float, f32)
#endif
