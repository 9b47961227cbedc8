// What is made once per garment: its coarse mesh, colours, and the order of a factor.
#include "collapse.hpp"
#include "exports.hpp"
#include "orders.hpp"

// Tests take them from the library that is delivered.
#ifndef FOR_TESTS
EXPORT int64_t drape_collapse_f64(int32_t* faces, int64_t face_count, double* corner, int32_t* lines,
                                  int64_t vertex_count, const int32_t* creased, int64_t creased_count, int64_t panels,
                                  int64_t target, double longest, uint8_t* alive, Scratch* scratch) {
  const collapse::Mesh mesh = {faces, (collapse::Way*)corner, lines, nullptr, nullptr, vertex_count, face_count,
                               panels != 0};
  collapse::coarsened(mesh, creased, creased_count, target, longest, alive, *scratch);
  return -scratch->overflowed;
}
EXPORT int64_t drape_greedy_colours_f64(const int32_t* start, const int32_t* neighbour, int64_t count, int32_t* colour,
                                        Scratch* scratch) {
  orders::greedy_colours({start, neighbour}, count, colour, *scratch);
  return -scratch->overflowed;
}
EXPORT int64_t drape_by_distance_f64(const int32_t* start, const int32_t* neighbour, const int32_t* part,
                                     const int32_t* nodes, int64_t count, int64_t first, int32_t* distance,
                                     int32_t* line) {
  return orders::by_distance({start, neighbour}, part, nodes, count, int32_t(first), distance, line);
}
EXPORT int64_t drape_at_the_other_f64(const int32_t* start, const int32_t* neighbour, const int32_t* part,
                                      const int32_t* nodes, int64_t count, uint8_t* near) {
  orders::at_the_other({start, neighbour}, part, nodes, count, near);
  return 0;
}
EXPORT int64_t drape_runs_f64(const int32_t* start, const int32_t* row, int64_t count, int64_t widest, double by_row,
                              double by_column, double by_members, double by_run, int32_t* begin, Scratch* scratch) {
  orders::runs({start, row}, count, widest, {by_row, by_column, by_members, by_run}, begin, *scratch);
  return -scratch->overflowed;
}
#endif
