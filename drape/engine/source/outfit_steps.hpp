// Folds of garments that are worn over each other: inner ones are ground for outer ones, which press them to the skin
// (layers.hpp). Part of frame_steps.hpp.
#pragma once
#include "layers.hpp"

namespace outfit {

// A garment of an outfit in a frame: the samples own (P,) of the ground (S, 8) that its places lie at, and the ceiling
// (S, 5) over it.
struct Lying {
  const float* ground;
  int32_t* own;
  float* ceiling;
};

// Writes the samples own (P,) that the places of a folded garment lie at.
DEVICE void put_own(const LayerCall<float>& layer, int32_t* own) {
  const FrameParts<float>& parts = *layer.parts;
  const int32_t* parent = parts.levels.count ? parts.levels[0].fine.parent.begin : nullptr;
  for (int64_t p : each(parts.laid[0].sheet.vertex.count)) own[p] = layer.folded[0].own[parent ? parent[p] : p];
}

// Writes the ceilings over all garments but the outermost, which the vertices [m] (V, 3) of the garments above each
// make over the body's skin.
DEVICE void put_ceilings(const FrameCall<float>& call, const float* const* vertices, const Array<float>& skin,
                         const Lying* lying, Scratch& scratch) {
  const int64_t samples = skin.count / 8;
  for (int64_t n = call.layers.count - 1; n > 0; --n) {
    float* made = lying[n - 1].ceiling;
    drape_ceiling_f32(vertices[n], call.layers[n].parts[0].laid, skin, samples, made, &scratch);
    if (n == call.layers.count - 1) continue;
    const float* above = lying[n].ceiling;  // the lower one counts
    for (int64_t s : each(samples))
      for (int i = 0; above[layers::CEILING * s] < made[layers::CEILING * s] && i < layers::CEILING; ++i) {
        const int at = layers::CEILING - 1 - i;
        made[layers::CEILING * s + at] = above[layers::CEILING * s + at];
      }
  }
}

// Presses a folded garment below its ceiling, in place.
DEVICE void press(const LayerCall<float>& layer, const Lying& lies, int64_t samples, Scratch& scratch) {
  float* vertices = layer.vertices;
  drape_press_f32(vertices, layer.parts[0].laid, lies.own, lies.ground, samples, lies.ceiling, vertices, &scratch);
}

// Folds garments in place of their drapes, the innermost first, each over the skin as the garments below have raised
// it.
DEVICE void fold(const FrameCall<float>& call, float* const* drapes, const Surroundings<float>& around, bool novel,
                 FrameOutcome* told, Scratch& scratch) {
  const int64_t count = call.layers.count, samples = around.skin.count / 8;
  float *height = scratch.take<float>(samples), *vertices[MOST_LAYERS];
  Lying lying[MOST_LAYERS];
  for (int64_t n = 0; n < count; ++n) {
    vertices[n] = call.layers[n].vertices;
    lying[n].own = scratch.take<int32_t>(call.layers[n].parts[0].laid[0].sheet.vertex.count);
    lying[n].ceiling = scratch.take<float>(layers::CEILING * samples);
  }
  if (scratch.overflowed) return;
  put_ceilings(call, drapes, around.skin, lying, scratch);
  Surroundings<float> below = around;
  bool read = false;
  for (int64_t n = 0; n < count && !scratch.overflowed; ++n) {
    const LayerCall<float>& layer = call.layers[n];
    lying[n].ground = below.skin;
    fold_cloth(layer, drapes[n], below, novel, told[n].folds, scratch);
    put_own(layer, lying[n].own);
    if (n == count - 1) break;
    read |= layer.parts[0].read != 0;
    press(layer, lying[n], samples, scratch);
    const Array<float> raised = room(8 * samples, scratch);
    if (scratch.overflowed) return;
    drape_heights_f32(vertices[n], layer.parts[0].laid, lying[n].own, below.skin, samples, height, &scratch);
    drape_raise_f32(below.skin, samples, height, raised);
    below.skin = raised;
  }
  if (!read || scratch.overflowed) return;
  put_ceilings(call, vertices, around.skin, lying, scratch);  // what is folded presses once more
  for (int64_t n = 0; n < count - 1; ++n)
    if (call.layers[n].parts[0].read) press(call.layers[n], lying[n], samples, scratch);
}

}  // namespace outfit
