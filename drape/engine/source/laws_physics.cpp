// Parts of offline physics that tests hold to their laws one by one.
#include "exports.hpp"
#include "grid.hpp"
#include "numbers.hpp"

// Adds one to times (count,) of every point (count, width) that a walk over the box from low to high meets.
#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_law_walk_##suffix(const T* points, int64_t count, int64_t width, double per_m, double low_x,    \
                                         double low_y, double low_z, double high_x, double high_y, double high_z,      \
                                         int64_t* times, Scratch* scratch) {                                           \
    const Grid grid = grid_of(points, count, int(width), per_m, *scratch);                                             \
    if (scratch->overflowed) return -1;                                                                                \
    const Cells cells = cells_within(grid, {low_x, low_y, low_z}, {high_x, high_y, high_z});                           \
    for_each_point(grid, cells, [&](int64_t n) { times[n] += 1; });                                                    \
    return 0;                                                                                                          \
  }

FOR_TYPE(float, f32)
FOR_TYPE(double, f64)

// Writes e to each of the numbers x (count,), and the logarithms of these.
EXPORT int64_t drape_law_exponentials_f64(const double* x, int64_t count, double* exponential, double* logarithm) {
  for (int64_t i = 0; i < count; ++i) {
    exponential[i] = exponential_of(x[i]);
    logarithm[i] = logarithm_of(exponential[i]);
  }
  return 0;
}
