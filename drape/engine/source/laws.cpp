// Parts of kernels that tests hold to their laws one by one. The library that is delivered has none of them.
#include "exports.hpp"

#define FOR_TYPE(T, suffix)

FOR_TYPE(float, f32)
FOR_TYPE(double, f64)
