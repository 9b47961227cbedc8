// Offline physics computes in doubles and solves its systems in floats.
#include "apart.hpp"
#include "blended_planes.hpp"
#include "exports.hpp"
#include "linear.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_galerkin_##suffix(const Charts<T>* charts, const Pattern<T>* pattern, const T* blocks, T* out,  \
                                         int64_t size) {                                                               \
    const Flushed flushed;                                                                                             \
    linear::galerkin(*charts, *pattern, blocks, out, size);                                                            \
    return 0;                                                                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_solve_##suffix(const System<T>* system, const T* force, double share, int64_t limit, T* moved,  \
                                      int64_t* iterations, Scratch* scratch) {                                         \
    const Flushed flushed;                                                                                             \
    *iterations = linear::conjugate_gradients(*system, force, share, limit, moved, *scratch);                          \
    return scratch->overflowed ? -1 : 0;                                                                               \
  }

INSTANCES

#ifndef FOR_TESTS  // tests take what follows from the library that is delivered

EXPORT int64_t drape_energy_f64(const double* x, const Problem<double>* problem, const Around<double>* around,
                                double* gradient, double* energy) {
  const Flushed flushed;
  *energy = physics::energy_and_gradient(x, {*problem, *around}, gradient);
  return 0;
}
EXPORT int64_t drape_sweep_f64(double* x, const Problem<double>* problem, const Around<double>* around,
                               const int32_t* order, int64_t count, int64_t guarded) {
  const Flushed flushed;
  physics::sweep(x, {*problem, *around}, order, count, guarded);
  return 0;
}
EXPORT int64_t drape_diagonal_f64(const double* x, const Problem<double>* problem, const Around<double>* around,
                                  double* blocks) {
  const Flushed flushed;
  physics::diagonal_blocks(x, {*problem, *around}, blocks);
  return 0;
}
EXPORT int64_t drape_hessian_f64(const double* x, const Problem<double>* problem, const Around<double>* around,
                                 const Pattern<double>* pattern, double exact, double* blocks) {
  const Flushed flushed;
  physics::assemble(x, {*problem, *around}, *pattern, exact, blocks);
  return 0;
}

// Pairs: apart.hpp, pairs.hpp. The number of those that are near, of which found (room, 2) has the first.
EXPORT int64_t drape_near_boxes_f64(const double* x, int64_t points, const int32_t* first, int64_t first_count,
                                    int64_t first_width, const int32_t* second, int64_t second_count,
                                    int64_t second_width, int64_t same, double reach, int32_t* found, int64_t room,
                                    Scratch* scratch) {
  const Flushed flushed;
  return pairs::near_boxes({x, points}, {first, first_count, first_width}, {second, second_count, second_width}, same,
                           reach, found, room, *scratch);
}
EXPORT int64_t drape_ways_f64(const double* x, const int32_t* corner, int64_t count, int64_t triangles, double* weights,
                              double* ways) {
  const Flushed flushed;
  pairs::write_ways(x, {corner, count, triangles}, weights, ways);
  return 0;
}
EXPORT int64_t drape_push_apart_f64(const double* x, const int32_t* corner, int64_t count, int64_t triangles,
                                    double reach, double k, double* gradient, double* energy) {
  const Flushed flushed;
  *energy = apart::push_apart(x, {corner, count, triangles}, {reach, k}, gradient);
  return 0;
}
EXPORT int64_t drape_add_curvature_f64(const double* x, const int32_t* corner, int64_t count, int64_t triangles,
                                       double reach, double k, const int32_t* place, double* blocks) {
  const Flushed flushed;
  apart::add_curvature(x, {corner, count, triangles}, {reach, k}, place, blocks);
  return 0;
}
EXPORT int64_t drape_free_shares_f64(const double* x, int64_t points, const double* step, const int32_t* corner,
                                     int64_t count, int64_t triangles, double* share) {
  const Flushed flushed;
  apart::free_shares(x, points, step, {corner, count, triangles}, share);
  return 0;
}
EXPORT int64_t drape_yield_to_f64(const double* x, double* step, const int32_t* corner, int64_t count,
                                  int64_t triangles, double near, double gain, Scratch* scratch) {
  const Flushed flushed;
  apart::yield_to(x, step, {corner, count, triangles}, near, gain, *scratch);
  return scratch->overflowed ? -1 : 0;
}
EXPORT int64_t drape_blend_f64(const double* x, int64_t count, const double* skin, const double* skin_normal,
                               int64_t skin_count, double reach, double gap, double* blended, double* clear,
                               uint8_t* beyond, double* point, double* normal, double* bend, Scratch* scratch) {
  const Flushed flushed;
  blended_planes::blend(x, count, {skin, skin_normal, skin_count}, reach, gap, {blended, clear, beyond},
                        {point, normal, bend}, *scratch);
  return scratch->overflowed ? -1 : 0;
}

#endif
