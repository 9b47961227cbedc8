// The network: bodies, posed jets, vertices, and its single layers.
#include "motion.hpp"
#include "network.hpp"
#include "parts.hpp"

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
  }                                                                                                                    \
  EXPORT int64_t drape_advance_##suffix(const MotionEncoder<T>* weights, const T* features, const T* state,            \
                                        const T* dt_s, int64_t bodies, T* code, T* next, Scratch* scratch) {           \
    const Flushed flushed;                                                                                             \
    advance_motion(*weights, features, state, dt_s, bodies, code, next, *scratch);                                     \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_layer_##suffix(const Layer<T>* layer, T* inputs, int64_t input_count, int64_t input_first,      \
                                      T* added, int64_t added_count, T* outputs, int64_t output_count,                 \
                                      int64_t output_first, int64_t blocks, Scratch* scratch) {                        \
    const Flushed flushed;                                                                                             \
    const Rows<T> more = {added_count ? added : nullptr, added_count, 0}, x = {inputs, input_count, input_first};      \
    run_layer(*layer, x, more, Rows<T>{outputs, output_count, output_first}, blocks, *scratch);                        \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT void drape_body_layer_##suffix(const Layer<T>* layer, const T* inputs, int64_t bodies, T* outputs) {          \
    const Flushed flushed;                                                                                             \
    const int64_t count = layer->weight.count / layer->bias.count;                                                     \
    for (int64_t body = 0; body < bodies; ++body)                                                                      \
      run_body_layer(*layer, inputs + count * body, outputs + layer->bias.count * body);                               \
  }

INSTANCES

// Poses come in doubles, and so is what motion is measured by.
#ifndef FOR_TESTS
EXPORT int64_t drape_novelty_f32(const KeptPoses<float>* kept, const float* matrices, int64_t frames, float* novelty,
                                 Scratch* scratch) {
  compare_poses(*kept, matrices, frames, novelty, *scratch);
  return -scratch->overflowed;
}
EXPORT void drape_turns_f64(const double* turns, int64_t count, double* quaternion, double* matrix) {
  describe_turns(turns, count, quaternion, matrix);
}
EXPORT void drape_moments_f64(const double* local, const double* trans, const double* rest, int64_t frames,
                              double* features, double* joints, double* rotations) {
  describe_bodies(local, trans, rest, frames, features, joints, rotations);
}
#endif
