// Folds: steps, sweeps and the lift of one frame, and what is made of a garment for them.
#include "eased.hpp"
#include "parts.hpp"
#include "reached.hpp"

EXPORT uint64_t drape_records_hash() { return RECORDS_HASH; }

#define FRAME(name, frame, Cloth, T, suffix)                                                                           \
  EXPORT int64_t drape_##name##_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around,  \
                                         const Cloth<T>* cloth, const FoldEffort<T>* effort, FoldMemory<T>* after,     \
                                         T* folded, FoldOutcome* outcome, Scratch* scratch) {                          \
    const Flushed flushed;                                                                                             \
    *outcome = frame(vertices, *past, *around, *cloth, *effort, *after, folded, *scratch);                             \
    return -scratch->overflowed;                                                                                       \
  }

#define FOR_TYPE(T, suffix)                                                                                            \
  FRAME(fold, fold_one_level, FoldConstants, T, suffix)                                                                \
  FRAME(fold_two_levels, fold_two_levels, Levels, T, suffix)                                                           \
  FRAME(lift_alone, lift_alone, Levels, T, suffix)                                                                     \
  EXPORT void drape_write_grip_##suffix(const T* x, int64_t places, const T* stuck, const int32_t* own, const T* skin, \
                                        int64_t samples, const SkinGraph<T>* graph, T* grip) {                         \
    const Flushed flushed;                                                                                             \
    write_grip(x, places, stuck, own, skin_of(skin, samples, *graph), grip);                                           \
  }                                                                                                                    \
  EXPORT void drape_leave_##suffix(T* x, int64_t places, const Surroundings<T>* around, double clearance) {            \
    const Flushed flushed;                                                                                             \
    leave_colliders<T>(x, places, around->colliders, nullptr, T(clearance));                                           \
  }

INSTANCES

#ifndef FOR_TESTS
EXPORT int64_t drape_reached_f64(const int32_t* start, const int32_t* other, const double* length, int64_t count,
                                 double most, int32_t* begins, int32_t* found, double* ways, int64_t room,
                                 Scratch* scratch) {
  return reached(start, other, length, count, most, begins, found, ways, room, *scratch);
}
#endif
