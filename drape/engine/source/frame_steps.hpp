// One frame of one garment: a pose in, draped vertices, memories and coordinates of the wire out.
//
// It calls what makes a frame stage by stage, one after the other, and so has the same bits: the functions of other
// units of a processor (parts.hpp), or a card's own (parts_one.hpp), of which one is included before this. What is
// between them, the posed body and its skin, jets, still and swung vertices, never leaves the scratch.
#pragma once
#include "body.hpp"
#include "folds.hpp"

constexpr int FULL_JET = 45;
enum Part { NOVELTY, NETWORK, SWING, FOLDS, ENCODE, PARTS };

// What became of a frame, as the caller reads it: folds, how unlike kept poses the pose is, the ticks of each part, low
// corner and step size of quantised vertices.
struct FrameOutcome {
  FoldOutcome folds;
  double novelty;
  uint64_t ticks[PARTS];
  float box[6];
};

INLINE Array<float> room(int64_t count, Scratch& scratch) { return {{scratch.take<float>(count)}, count}; }

// Writes the joints' local quaternions (24, 4) of a pose. Returns how unlike kept poses it is.
DEVICE double read_pose(const FrameCall<float>& call, float* local, Scratch& scratch) {
  const Array<KeptPoses<float>>& kept = call.parts[0].kept;
  double *quaternion = scratch.take<double>(4 * JOINTS), *matrix = scratch.take<double>(9 * JOINTS);
  float *matrices = scratch.take<float>(9 * JOINTS), *novelty = scratch.take<float>(1);
  if (scratch.overflowed) return 0;
  drape_turns_f64(call.turns, JOINTS, quaternion, matrix);
  for (int64_t i : each(4 * JOINTS)) local[i] = float(quaternion[i]);
  for (int64_t i : each(9 * JOINTS)) matrices[i] = float(matrix[i]);
  for (int64_t i : each(1)) novelty[i] = 0;
  if (kept.count) drape_novelty_f32(kept, matrices, 1, novelty, &scratch);
  return double(*novelty);
}

// Writes the network's vertices [m] (V, 3) and the samples of the skin. Returns whether all numbers are finite.
DEVICE bool drape_body(const FrameCall<float>& call, float* local, Array<float> skin, float* vertices, int64_t count,
                       Scratch& scratch) {
  const FrameParts<float>& parts = *call.parts;
  const int64_t patches = parts.tiles[0].scale.count, code = parts.weights[0].from_body.bias.count;
  BodyFeed<float> feed = *call.body;
  feed.local = {{local}, 4 * JOINTS};
  PosedBody<float> body = {room(4 * JOINTS, scratch), room(9 * JOINTS, scratch), room(3 * JOINTS, scratch),
                           room(3 * JOINTS, scratch), room(code, scratch), feed.betas, skin,
                           room(4 * (skin.count / (8 * REGION_SIZE)), scratch)};
  PosedJets<float> jets = {room(FULL_JET * patches, scratch), room(9 * patches, scratch), room(3 * patches, scratch)};
  if (scratch.overflowed) return false;
  drape_pose_body_f32(parts.weights, &feed, &body, &scratch);
  const bool finite = drape_jets_f32(parts.weights, parts.patches, &body, parts.passes, &jets, &scratch) == 1;
  drape_vertices_f32(&jets, parts.tiles, vertices, count, &scratch);
  return finite;
}

// Writes the folded or lifted vertices [m] (V, 3), which are the given ones where nothing led to a fold.
DEVICE void fold_cloth(const FrameCall<float>& call, const float* vertices, int64_t count,
                       const Surroundings<float>& around, FrameOutcome& told, Scratch& scratch) {
  const FrameParts<float>& parts = *call.parts;
  const FoldEffort<float>* effort = told.novelty > 1 ? parts.novel_effort : parts.effort;
  float* folded = call.vertices;
  if (parts.cloth.count)
    drape_fold_f32(vertices, call.folded_before, &around, parts.cloth, effort, call.folded, folded, &told.folds,
                   &scratch);
  else if (call.lifts)
    drape_lift_alone_f32(vertices, call.folded_before, &around, parts.levels, effort, call.folded, folded, &told.folds,
                         &scratch);
  else
    drape_fold_two_levels_f32(vertices, call.folded_before, &around, parts.levels, effort, call.folded, folded,
                              &told.folds, &scratch);
  if (told.folds.lost) copy(folded, vertices, 3 * count);
}

// Draws a frame. Returns whether the network's numbers are finite, of which nothing is to be read where not, and -1
// where scratch is too small.
DEVICE int64_t draw_frame(const FrameCall<float>& call, FrameOutcome& told, Scratch& scratch) {
  const FrameParts<float>& parts = *call.parts;
  const int64_t count = call.vertices.count / 3;
  const bool folds = parts.cloth.count || parts.levels.count;
  uint64_t ends[PARTS + 1] = {ticks()};
  float *local = scratch.take<float>(4 * JOINTS), *still = scratch.take<float>(3 * count);
  float* swung = scratch.take<float>(3 * count);
  const Array<float> skin = room(8 * PART_SIZE * call.body[0].skin_counts.count, scratch);
  const Surroundings<float> around = {skin, call.colliders};
  if (scratch.overflowed) return -1;
  told.novelty = read_pose(call, local, scratch);
  ends[1 + NOVELTY] = ticks();
  const bool finite = drape_body(call, local, skin, still, count, scratch);
  if (scratch.overflowed) return -1;
  if (!finite) return 0;
  ends[1 + NETWORK] = ticks();
  const float* drape = still;
  if (parts.swing.count && drape_swing_f32(still, count, call.swung_before, &around, parts.swing, parts.share,
                                           call.swung, swung, &scratch) == 1)
    drape = swung;
  if (scratch.overflowed) return -1;
  ends[1 + SWING] = ticks();
  if (folds)
    fold_cloth(call, drape, count, around, told, scratch);
  else
    copy(call.vertices.begin, drape, 3 * count);
  ends[1 + FOLDS] = ticks();
  if (call.steps.count) drape_quantise_f32(call.vertices, count, parts.step_count, call.steps, told.box);
  ends[1 + ENCODE] = ticks();
  for (int part = 0; part < PARTS; ++part) told.ticks[part] = ends[part + 1] - ends[part];
  return scratch.overflowed ? -1 : 1;
}
