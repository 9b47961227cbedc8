// The functions that one frame is made of (frame_steps.hpp), on a card.
#pragma once
#include "body.hpp"
#include "eased.hpp"
#include "layers.hpp"
#include "network.hpp"
#include "quantise.hpp"
#include "swing.hpp"

INLINE void drape_turns_f64(const double* turns, int64_t count, double* quaternion, double* matrix) {
  describe_turns(turns, count, quaternion, matrix);
}
INLINE void drape_novelty_f32(const KeptPoses<float>* kept, const float* matrices, int64_t frames, float* novelty,
                              Scratch* scratch) {
  compare_poses(*kept, matrices, frames, novelty, *scratch);
}
INLINE void drape_pose_body_f32(const Weights<float>* weights, const BodyFeed<float>* feed, PosedBody<float>* body,
                                Scratch* scratch) {
  pose_body(*weights, *feed, *body, *scratch);
}
INLINE int64_t drape_jets_f32(const Weights<float>* weights, const PatchRows<float>* rows, const PosedBody<float>* body,
                              int64_t passes, PosedJets<float>* jets, Scratch* scratch) {
  return network::pose_jets(*weights, *rows, *body, passes, *jets, *scratch);
}
INLINE void drape_vertices_f32(const PosedJets<float>* jets, const Tiles<float>* tiles, float* vertices, int64_t count,
                               Scratch* scratch) {
  network::blend_vertices(*jets, *tiles, vertices, count, *scratch);
}
INLINE int64_t drape_swing_f32(const float* vertices, int64_t count, const SwingMemory<float>* past,
                               const Surroundings<float>* around, const SwingConstants<float>* cloth, double share,
                               SwingMemory<float>* after, float* out, Scratch* scratch) {
  return swing::frame(vertices, count, *past, *around, *cloth, float(share), *after, out, *scratch);
}
#define FOLDED(name, frame, Cloth)                                                                                     \
  INLINE void drape_##name##_f32(const float* vertices, const FoldMemory<float>* past,                                 \
                                 const Surroundings<float>* around, const Cloth<float>* cloth,                         \
                                 const FoldEffort<float>* effort, FoldMemory<float>* after, float* folded,             \
                                 FoldOutcome* outcome, Scratch* scratch) {                                             \
    *outcome = frame(vertices, *past, *around, *cloth, *effort, *after, folded, *scratch);                             \
  }
FOLDED(fold, fold_one_level, FoldConstants)
FOLDED(fold_two_levels, fold_two_levels, Levels)
FOLDED(lift_alone, lift_alone, Levels)
#undef FOLDED
INLINE void drape_heights_f32(const float* vertices, const LaidCloth<float>* cloth, const int32_t* own,
                              const float* skin, int64_t samples, float* height, Scratch* scratch) {
  layers::heights_over(vertices, *cloth, own, skin_of(skin, samples, cloth->graph), height, *scratch);
}
INLINE void drape_raise_f32(const float* ground, int64_t samples, const float* height, float* raised) {
  layers::raise(ground, samples, height, raised);
}
INLINE void drape_ceiling_f32(const float* vertices, const LaidCloth<float>* cloth, const float* skin,
                              int64_t samples, float* ceiling, Scratch* scratch) {
  layers::ceiling_over(vertices, *cloth, skin_of(skin, samples, cloth->graph), ceiling, *scratch);
}
INLINE void drape_press_f32(const float* vertices, const LaidCloth<float>* cloth, const int32_t* own,
                            const float* ground, int64_t samples, const float* ceiling, float* pressed,
                            Scratch* scratch) {
  layers::press(vertices, *cloth, own, skin_of(ground, samples, cloth->graph), ceiling, pressed, *scratch);
}
INLINE void drape_quantise_f32(const float* positions, int64_t vertices, double count, uint16_t* steps, float* box) {
  quantise(positions, vertices, float(count), steps, box);
}
