// Offline physics.
#include "exports.hpp"
#include "linear.hpp"
#include "physics.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT void drape_energy_##suffix(const T* x, const Problem<T>* problem, const Around<T>* around, T* gradient,       \
                                    double* energy) {                                                                  \
    *energy = physics::energy_and_gradient(x, *problem, *around, gradient);                                            \
  }                                                                                                                    \
  EXPORT void drape_sweep_##suffix(T* x, const Problem<T>* problem, const Around<T>* around, const int32_t* order,     \
                                   int64_t count, int64_t guarded) {                                                   \
    physics::sweep(x, *problem, *around, order, count, guarded);                                                       \
  }                                                                                                                    \
  EXPORT void drape_diagonal_##suffix(const T* x, const Problem<T>* problem, const Around<T>* around, T* blocks) {     \
    physics::diagonal_blocks(x, *problem, *around, blocks);                                                            \
  }                                                                                                                    \
  EXPORT void drape_hessian_##suffix(const T* x, const Problem<T>* problem, const Around<T>* around,                   \
                                     const Pattern<T>* pattern, double exact, T* blocks) {                             \
    physics::assemble(x, *problem, *around, *pattern, T(exact), blocks);                                               \
  }                                                                                                                    \
  EXPORT void drape_galerkin_##suffix(const System<T>* system, T* out, int64_t size) {                                 \
    linear::galerkin(*system, out, size);                                                                              \
  }                                                                                                                    \
  EXPORT int64_t drape_solve_##suffix(const System<T>* system, const T* force, double share, int64_t limit, T* moved,  \
                                      Scratch* scratch) {                                                              \
    return linear::conjugate_gradients(*system, force, share, limit, moved, *scratch);                                 \
  }

// Offline physics computes in doubles, and solves its systems in floats. Tests take it from the same library.
#ifndef FOR_TESTS
FOR_TYPE(float, f32)
FOR_TYPE(double, f64)
#endif
