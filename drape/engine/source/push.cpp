// The push-out.
#include "exports.hpp"
#include "push.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_push_out_##suffix(const T* vertices, const T* skin, const PushFeed<T>* feed,                    \
                                         const T* logs, double clearance, int64_t rounds, T* pushed, T* way,           \
                                         T* coefficients, T* left, Scratch* scratch) {                                 \
    const Flushed flushed;                                                                                             \
    network::push_out(vertices, skin, *feed, logs, T(clearance), rounds, pushed, way, coefficients, left, *scratch);   \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT void drape_pose_cloth_##suffix(const T* under, const int32_t* member, const T* rows, int64_t clusters,        \
                                        T* samples) {                                                                  \
    const Flushed flushed;                                                                                             \
    network::pose_cloth(under, member, rows, clusters, samples);                                                       \
  }

INSTANCES
