// The network.
#include "exports.hpp"
#include "network.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_pose_body_##suffix(const Weights<T>* weights, const BodyFeed<T>* feed, PosedBody<T>* body,      \
                                      Scratch* scratch) {                                                              \
    const Flushed flushed;                                                                                             \
    pose_body(*weights, *feed, *body, *scratch);                                                                       \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_jets_##suffix(const Weights<T>* weights, const PatchRows<T>* rows, const PosedBody<T>* body,    \
                                 int64_t passes, PosedJets<T>* jets, Scratch* scratch) {                               \
    const Flushed flushed;                                                                                             \
    bool finite = network::pose_jets(*weights, *rows, *body, passes, *jets, *scratch);                                 \
    return scratch->overflowed ? -1 : finite;                                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_vertices_##suffix(const PosedJets<T>* jets, const Tiles<T>* tiles, T* vertices, int64_t count,  \
                                     Scratch* scratch) {                                                               \
    const Flushed flushed;                                                                                             \
    network::blend_vertices(*jets, *tiles, vertices, count, *scratch);                                                 \
    return -scratch->overflowed;                                                                                       \
  }

INSTANCES
