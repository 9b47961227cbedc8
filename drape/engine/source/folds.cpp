// Folds: steps, sweeps and the lift of one frame.
#include "exports.hpp"
#include "levels.hpp"

EXPORT uint64_t drape_records_hash() { return RECORDS_HASH; }

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT void drape_descend_##suffix(T* x, const Sheet<T>* sheet, const T* planes, const T* network) {                 \
    descend(x, *sheet, planes, network);                                                                               \
  }                                                                                                                    \
  EXPORT void drape_gradient_##suffix(const T* x, const Sheet<T>* sheet, const T* planes, const T* network,            \
                                      double hold, T* gradient) {                                                      \
    gradient_at(x, *sheet, planes, network, T(hold), gradient);                                                        \
  }                                                                                                                    \
  EXPORT void drape_whole_step_##suffix(T* x, const StiffnessFactor<T>* factor, const T* gradient, double share,       \
                                        T* q, T* s) {                                                                  \
    whole_step(x, *factor, gradient, T(share), q, s);                                                                  \
  }                                                                                                                    \
  EXPORT int64_t drape_fold_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around,      \
                                 const FoldConstants<T>* cloth, const FoldEffort<T>* effort, FoldMemory<T>* after,     \
                                 T* folded, FoldOutcome* outcome, Scratch* scratch) {                                  \
    const Flushed flushed;                                                                                             \
    *outcome = fold_one_level(vertices, *past, *around, *cloth, *effort, *after, folded, *scratch);                    \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_fold_two_levels_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around,\
                                            const Levels<T>* levels, const FoldEffort<T>* effort, FoldMemory<T>* after,\
                                            T* folded, FoldOutcome* outcome, Scratch* scratch) {                       \
    const Flushed flushed;                                                                                             \
    *outcome = fold_two_levels(vertices, *past, *around, *levels, *effort, *after, folded, *scratch);                  \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_lift_alone_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around,\
                                       const Levels<T>* levels, const FoldEffort<T>* effort, FoldMemory<T>* after,     \
                                       T* folded, FoldOutcome* outcome, Scratch* scratch) {                            \
    const Flushed flushed;                                                                                             \
    *outcome = lift_alone(vertices, *past, *around, *levels, *effort, *after, folded, *scratch);                       \
    return -scratch->overflowed;                                                                                       \
  }

INSTANCES
