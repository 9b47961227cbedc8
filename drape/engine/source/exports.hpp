// The C ABI, as drape/engine/calls.py calls it. Every function takes flat arrays and records (records.hpp) that the caller
// keeps; other numbers are double or int64_t, and so is what it returns. The kernels' type is the end of its name. One that
// takes scratch, as its last argument, returns -1 if that was too small. Then what it reads is still as it was, so that the
// caller can give more and call again.
#pragma once
#include "records.hpp"

// The library that only tests load has the kernels of float64; those of float32 are in the other.
#ifdef FOR_TESTS
#define INSTANCES FOR_TYPE(double, f64)
#else
#define INSTANCES FOR_TYPE(float, f32)
#endif
