// The functions of other units that one frame is made of (frame.cpp). Units that define them include this, so that the
// compiler compares.
#pragma once
#include "exports.hpp"

#ifndef FOR_TESTS
struct FoldOutcome;

EXPORT void drape_turns_f64(const double* turns, int64_t count, double* quaternion, double* matrix);
EXPORT int64_t drape_novelty_f32(const KeptPoses<float>* kept, const float* matrices, int64_t frames, float* novelty,
                                 Scratch* scratch);
EXPORT int64_t drape_pose_body_f32(const Weights<float>* weights, const BodyFeed<float>* feed, PosedBody<float>* body,
                                   Scratch* scratch);
EXPORT int64_t drape_jets_f32(const Weights<float>* weights, const PatchRows<float>* rows, const PosedBody<float>* body,
                              int64_t passes, PosedJets<float>* jets, Scratch* scratch);
EXPORT int64_t drape_vertices_f32(const PosedJets<float>* jets, const Tiles<float>* tiles, float* vertices,
                                  int64_t count, Scratch* scratch);
EXPORT int64_t drape_swing_f32(const float* vertices, int64_t count, const SwingMemory<float>* past,
                               const Surroundings<float>* around, const SwingConstants<float>* cloth, double share,
                               SwingMemory<float>* after, float* out, Scratch* scratch);
#define FOLDED(name, Cloth)                                                                                            \
  EXPORT int64_t drape_##name##_f32(const float* vertices, const FoldMemory<float>* past,                              \
                                    const Surroundings<float>* around, const Cloth<float>* cloth,                      \
                                    const FoldEffort<float>* effort, FoldMemory<float>* after, float* folded,          \
                                    FoldOutcome* outcome, Scratch* scratch);
FOLDED(fold, FoldConstants)
FOLDED(fold_two_levels, Levels)
FOLDED(lift_alone, Levels)
EXPORT int64_t drape_heights_f32(const float* vertices, const LaidCloth<float>* cloth, const int32_t* own,
                                 const float* skin, int64_t samples, float* height, Scratch* scratch);
EXPORT void drape_raise_f32(const float* ground, int64_t samples, const float* height, float* raised);
EXPORT int64_t drape_ceiling_f32(const float* vertices, const LaidCloth<float>* cloth, const float* skin,
                                 int64_t samples, float* ceiling, Scratch* scratch);
EXPORT int64_t drape_press_f32(const float* vertices, const LaidCloth<float>* cloth, const int32_t* own,
                               const float* ground, int64_t samples, const float* ceiling, float* pressed,
                               Scratch* scratch);
EXPORT void drape_quantise_f32(const float* positions, int64_t vertices, double count, uint16_t* steps, float* box);
#endif
