// One frame of one stream: a pose in, draped vertices of its garments, memories and coordinates of the wire out.
//
// It calls what makes a frame stage by stage, one after the other, and so has the same bits: the functions of other
// units of a processor (parts.hpp), or a card's own (parts_one.hpp), of which one is included before this. What is
// between them, the posed body and its skin, jets, still and swung vertices, never leaves the scratch.
#pragma once
#include "body.hpp"
#include "folds.hpp"

constexpr int FULL_JET = 45, MOST_LAYERS = 8;
enum Part { NOVELTY, NETWORK, SWING, FOLDS, ENCODE, PARTS };

// The outcome of a garment in a frame, as the caller reads it: its folds; and, in that of the innermost garment, how
// unlike kept poses the pose is, the ticks of each part, low corner and step size of quantised vertices, and what the
// frame returns.
struct FrameOutcome {
  FoldOutcome folds;
  double novelty;
  uint64_t ticks[PARTS];
  float box[6];
  int64_t returned;
};

INLINE Array<float> room(int64_t count, Scratch& scratch) { return {{scratch.take<float>(count)}, count}; }

// Writes the joints' local quaternions (24, 4) of the frame's pose, and returns how unlike kept poses it is.
DEVICE double read_pose(const FrameCall<float>& call, float* local, Scratch& scratch) {
  const Array<KeptPoses<float>>& kept = call.layers[0].parts[0].kept;
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

// Returns the posed body with its skin samples.
DEVICE PosedBody<float> posed(const FrameCall<float>& call, float* local, Array<float> skin, Scratch& scratch) {
  const Weights<float>* weights = call.layers[0].parts[0].weights;
  BodyFeed<float> feed = *call.body;
  feed.local = {{local}, 4 * JOINTS};
  PosedBody<float> body = {room(4 * JOINTS, scratch), room(9 * JOINTS, scratch), room(3 * JOINTS, scratch),
                           room(3 * JOINTS, scratch), room(weights[0].from_body.bias.count, scratch), feed.betas, skin,
                           room(4 * (skin.count / (8 * REGION_SIZE)), scratch)};
  if (!scratch.overflowed) drape_pose_body_f32(weights, &feed, &body, &scratch);
  return body;
}

// Writes the network's vertices [m] (V, 3) of a garment. Returns whether all numbers are finite.
DEVICE bool drape_layer(const FrameParts<float>& parts, const PosedBody<float>& body, float* vertices, int64_t count,
                        Scratch& scratch) {
  const int64_t patches = parts.tiles[0].scale.count;
  PosedJets<float> jets = {room(FULL_JET * patches, scratch), room(9 * patches, scratch), room(3 * patches, scratch)};
  if (scratch.overflowed) return false;
  const bool finite = drape_jets_f32(parts.weights, parts.patches, &body, parts.passes, &jets, &scratch) == 1;
  drape_vertices_f32(&jets, parts.tiles, vertices, count, &scratch);
  return finite;
}

// Writes the folded or lifted vertices [m] (V, 3) of a garment; these are the given ones where the folds are lost.
DEVICE void fold_cloth(const LayerCall<float>& layer, const float* vertices, const Surroundings<float>& around,
                       bool novel, FoldOutcome& told, Scratch& scratch) {
  const FrameParts<float>& parts = *layer.parts;
  const FoldEffort<float>* effort = novel ? parts.novel_effort : parts.effort;
  float* folded = layer.vertices;
  if (parts.cloth.count)
    drape_fold_f32(vertices, layer.folded_before, &around, parts.cloth, effort, layer.folded, folded, &told, &scratch);
  else if (layer.lifts)
    drape_lift_alone_f32(vertices, layer.folded_before, &around, parts.levels, effort, layer.folded, folded, &told,
                         &scratch);
  else
    drape_fold_two_levels_f32(vertices, layer.folded_before, &around, parts.levels, effort, layer.folded, folded,
                              &told, &scratch);
  if (told.lost) copy(folded, vertices, layer.vertices.count);
}

#include "outfit_steps.hpp"

// Folds all garments, in place of their drapes [m] (V, 3), or leaves these as they are where nothing folds.
DEVICE void fold_layers(const FrameCall<float>& call, float* const* drapes, const Surroundings<float>& around,
                        FrameOutcome* told, Scratch& scratch) {
  const bool novel = told[0].novelty > 1;
  if (call.layers[0].parts[0].laid.count) return outfit::fold(call, drapes, around, novel, told, scratch);
  for (int64_t n = 0; n < call.layers.count; ++n) {
    const LayerCall<float>& layer = call.layers[n];
    if (layer.parts[0].cloth.count || layer.parts[0].levels.count)
      fold_cloth(layer, drapes[n], around, novel, told[n].folds, scratch);
    else
      copy(layer.vertices.begin, drapes[n], layer.vertices.count);
  }
}

// Draws a frame of up to MOST_LAYERS garments. Returns 1; 0 where the network's numbers are not finite, and nothing
// that it wrote is to be read; and -1 where scratch is too small.
DEVICE int64_t draw_frame(const FrameCall<float>& call, FrameOutcome* told, Scratch& scratch) {
  uint64_t ends[PARTS + 1] = {ticks()};
  float *local = scratch.take<float>(4 * JOINTS), *drapes[MOST_LAYERS];
  const Array<float> skin = room(8 * PART_SIZE * call.body[0].skin_counts.count, scratch);
  const Surroundings<float> around = {skin, call.colliders};
  if (scratch.overflowed) return -1;
  told[0].novelty = read_pose(call, local, scratch);
  ends[1 + NOVELTY] = ticks();
  const PosedBody<float> body = posed(call, local, skin, scratch);
  bool finite = !scratch.overflowed;
  for (int64_t n = 0; n < call.layers.count && finite; ++n) {
    const int64_t count = call.layers[n].vertices.count;
    drapes[n] = scratch.take<float>(count);
    if (!scratch.overflowed) finite = drape_layer(*call.layers[n].parts, body, drapes[n], count / 3, scratch);
  }
  if (scratch.overflowed) return -1;
  if (!finite) return 0;
  ends[1 + NETWORK] = ticks();
  for (int64_t n = 0; n < call.layers.count; ++n) {
    const LayerCall<float>& layer = call.layers[n];
    float* swung = scratch.take<float>(layer.parts[0].swing.count ? layer.vertices.count : 0);
    if (layer.parts[0].swing.count && !scratch.overflowed &&
        drape_swing_f32(drapes[n], layer.vertices.count / 3, layer.swung_before, &around, layer.parts[0].swing,
                        layer.parts[0].share, layer.swung, swung, &scratch) == 1)
      drapes[n] = swung;
  }
  if (scratch.overflowed) return -1;
  ends[1 + SWING] = ticks();
  fold_layers(call, drapes, around, told, scratch);
  ends[1 + FOLDS] = ticks();
  if (call.steps.count)
    drape_quantise_f32(call.shown, call.shown.count / 3, call.step_count, call.steps, told[0].box);
  ends[1 + ENCODE] = ticks();
  for (int64_t part : each(PARTS)) told[0].ticks[part] = ends[part + 1] - ends[part];
  return scratch.overflowed ? -1 : 1;
}
