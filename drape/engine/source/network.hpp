// The network's drape of one garment on one body: posed jets of its patches, and the vertices of these.
//
// It computes what training.onefit.OneFit does, by the constants that drape.graph.packing lays out.
#pragma once
#include "felt.hpp"

namespace network {

// Writes full jets [patch scales] (K, 45), rotations (K, 9) and centres [m] (K, 3) of a garment's patches on a body
// after so many passes, corrections of the network. Patches that fill up the last row are left out. Returns whether all
// numbers are finite.
template <class T>
DEVICE bool pose_jets(const Weights<T>& weights, const PatchRows<T>& rows, const PosedBody<T>& body, int64_t passes,
    PosedJets<T>& out, Scratch& scratch) {
  const int64_t mark = scratch.used, blocks = rows.scale.count / LANES, patches = out.centre.count / 3;
  T *frames = scratch.take<T>(FRAME * blocks), *said = scratch.take<T>(3 * LANES * MEMBERS * blocks);
  T *anchors = scratch.take<T>(3 * (rows.anchor.count / 4)), *planes = scratch.take<T>(LANES * PLANES_FELT * blocks);
  auto rows_of = [&](int64_t count) { return Rows<T>{scratch.take<T>(LANES * count * blocks), count, 0}; };
  auto from = [](const Rows<T>& all, int64_t first) { return Rows<T>{all.values, all.count, first}; };
  const Rows<T> nothing = {nullptr, 1, 0}, seen = rows_of(SEEN + JETS), closed = rows_of(FULL);
  if (scratch.overflowed) return false;
  T* signs = scratch.take<T>(JOINTS * JOINTS);
  if (scratch.overflowed) return false;
  pose_frames(body, rows, blocks, signs, frames);
  say(nothing, frames, rows, blocks, said);
  place_anchors(said, rows.anchor, anchors);
  see_surroundings(body, frames, blocks, seen);
  fit_anchors(anchors, frames, rows, blocks, false, from(seen, SEEN), scratch);  // the agreed base

  Layer<T> near = weights.surroundings;
  T* bias = scratch.take<T>(near.bias.count);
  Rows<T> x = rows_of(near.bias.count);
  if (scratch.overflowed) return false;
  for (int64_t i : each(near.bias.count)) bias[i] = near.bias[i] + body.code[i];
  near.bias.begin = bias;
  run_layer(near, seen, Rows<T>{rows.first.begin, near.bias.count, 0}, x, blocks, scratch);
  for (int64_t number = 0; number + 1 < weights.trunk.count; ++number) {
    const Rows<T> after = rows_of(weights.trunk[number].bias.count);
    if (scratch.overflowed) return false;
    run_layer(weights.trunk[number], x, nothing, after, blocks, scratch);
    x = after;
  }
  const Layer<T>& last = weights.trunk[weights.trunk.count - 1];
  const int64_t code = last.bias.count, force = code + STRAIN;
  const Rows<T> felt = rows_of(force + 2 * JETS + 2 * POINTS + JETS);  // what corrections read
  if (scratch.overflowed) return false;
  run_layer(last, x, nothing, felt, blocks, scratch);
  Rows<T> jet = felt;
  for (int64_t number = 0; number < weights.heads.count; ++number) {
    const Rows<T> after = rows_of(weights.heads[number].bias.count);
    if (scratch.overflowed) return false;
    run_layer(weights.heads[number], jet, nothing, after, blocks, scratch);
    jet = after;  // 32 rows a block: the last five are zero
  }
  visit_parts(blocks, JETS, [&](int64_t block, int64_t i) {
    put(jet.at(block) + LANES * i, row_at(jet.at(block) + LANES * i) + row_at(seen.at(block) + LANES * (SEEN + i)));
  });

  const Rows<T> hidden = passes ? rows_of(weights.first[0].bias.count) : nothing;
  if (scratch.overflowed) return false;
  for (int64_t number = 0; number < passes; ++number) {
    say(jet, frames, rows, blocks, said);
    place_anchors(said, rows.anchor, anchors);
    fit_anchors(anchors, frames, rows, blocks, false, jet, scratch);
    feel_strain(weights, jet, rows, blocks, from(felt, code), scratch);
    if (number == 0) find_planes(weights, jet, body, frames, rows, blocks, planes, scratch);
    feel_body(weights, jet, rows, planes, blocks, from(felt, force + 2 * JETS), scratch);
    visit_parts(blocks, JETS, [&](int64_t block, int64_t i) {
      put(felt.at(block) + LANES * (force + JETS + i), row_at(jet.at(block) + LANES * i));
    });
    run_layer(weights.first[number], felt, nothing, hidden, blocks, scratch);
    run_layer(weights.second[number], hidden, jet, jet, blocks, scratch);
    hold_corrections(weights, from(felt, force + JETS), rows, planes, blocks, jet, scratch);
    if (scratch.overflowed) return false;
  }
  say(jet, frames, rows, blocks, said);
  place_anchors(said, rows.anchor, anchors);
  fit_anchors(anchors, frames, rows, blocks, true, closed, scratch);
  T odd = 0;  // 0 unless a number is not finite
  for (int64_t patch : each(patches)) {
    const int64_t block = patch / LANES, lane = patch % LANES;
    const T *own = closed.at(block) + lane, *frame = frames + FRAME * block + lane;
    for (int i = 0; i < FULL; ++i) odd += (out.jet[FULL * patch + i] = own[LANES * i]) * T(0);
    for (int i = 0; i < 9; ++i) odd += (out.rotation[9 * patch + i] = frame[ROTATION + LANES * i]) * T(0);
    for (int i = 0; i < 3; ++i) odd += (out.centre[3 * patch + i] = frame[CENTRE + LANES * i]) * T(0);
  }
  scratch.used = mark;
  return most_of_all(odd) == 0;
}

constexpr int REST = 3, TILE_COLUMNS = REST + HEIGHT, TILE_CHARTS = 32;  // numbers of a chart; charts of a tile

// Writes the vertices [m] (V, 3) of posed jets: each is the sum of what its four charts contribute.
template <class T>
DEVICE void blend_vertices(const PosedJets<T>& jets, const Tiles<T>& tiles, T* vertices, int64_t count,
    Scratch& scratch) {
  const int64_t mark = scratch.used, patches = jets.centre.count / 3, quantity = tiles.patch.count;
  const int64_t width = jets.jet.count / patches, plane = (width - HEIGHT) / 2, said_count = quantity * TILE_CHARTS;
  T *posed = scratch.take<T>(3 * TILE_COLUMNS * patches), *said = scratch.take<T>(3 * said_count);
  if (scratch.overflowed) return;
  for (int64_t way : each(3 * patches)) {
    // The frames in metres, and their products with the three polynomials; the centre is added to these once, as the
    // weights of a vertex sum to one.
    const int64_t k = way / 3, axis = way % 3;
    T* own = posed + TILE_COLUMNS * way;
    const T* jet = jets.jet + width * k;
    for (int i = 0; i < 3; ++i) own[i] = jets.rotation[9 * k + 3 * axis + i] * tiles.scale[k];
    for (int i = 0; i < HEIGHT; ++i) own[REST + i] = own[2] * jet[2 * plane + i];
    for (int64_t i = 0; i < plane; ++i) own[REST + i] += own[0] * jet[i] + own[1] * jet[plane + i];
    own[REST] += jets.centre[way];
  }
  for (int64_t tile : each_block(quantity)) {
    const T *own = posed + 3 * TILE_COLUMNS * tiles.patch[tile];
    const T* columns = tiles.columns + TILE_COLUMNS * TILE_CHARTS * tile;
    Row<T> sum[3][2] = {};
    for (int i = 0; i < TILE_COLUMNS; ++i) {
      Row<T> a = row_at(columns + TILE_CHARTS * i), b = row_at(columns + TILE_CHARTS * i + LANES);
#pragma clang loop unroll(full)
      for (int axis = 0; axis < 3; ++axis) {
        sum[axis][0] = sum[axis][0] + own[TILE_COLUMNS * axis + i] * a;
        sum[axis][1] = sum[axis][1] + own[TILE_COLUMNS * axis + i] * b;
      }
    }
    for (int half = 0; half < 2; ++half)
      put_points(said + 3 * (TILE_CHARTS * tile + LANES * half), Points<T>{sum[0][half], sum[1][half], sum[2][half]});
  }
  const int64_t stride = (tiles.charts.count ? tiles.charts.count : tiles.wide_charts.count) / 4;
  for (int64_t v : each(count)) {
    Vector<T> p[4];
    for (int i = 0; i < 4; ++i) {
      const int64_t place = stride * i + v;
      p[i] = point(said, tiles.charts.count ? int64_t(tiles.charts[place]) : int64_t(tiles.wide_charts[place]));
    }
    put_point(vertices, v, (p[0] + p[1]) + (p[2] + p[3]));
  }
  scratch.used = mark;
}

}  // namespace network
