// Folds of the frame before come into the next one turned, and not stretched.
//
// A frame that begins at x = X + R^T r (folds.hpp) stretches its folds wherever the network's surface X does, and swing
// stretches it by a fifth. With x' the folded places of the frame before, and Q the mean turn of a triangle's corners
// (turns.hpp), folds that turn alone would have the energy zero:
//
//     E = 1/2 sum A (k_warp |p(x) - Q p(x')|^2 + k_weft |t(x) - Q t(x')|^2).
//
// k has the shear in it as K has, so that steps of the whole (whole.hpp), x -= K^-1 dE/dx, take from x what is
// stretched, at all lengths at once, and leave the cloth where X has taken it. x' is without what the frame forgets
// (residual.hpp): steps would bring that back.
#pragma once
#include "turns.hpp"
#include "whole.hpp"

constexpr int CARRY_PASSES = 3;  // of turns (smooth_turns): none leave jitter

// Writes the gradient dE/dx [N] (P, 3) at x [m], for places before [m] (P, 3) and turns (P, 4) since then.
template <class T>
DEVICE void carry_gradient(const T* x, const T* before, const T* turns, const Sheet<T>& sheet, T* gradient) {
  const Fabric<T> k(sheet.constants);
  const T warp = T(2) * k.warp + T(4) * k.shear, weft = T(2) * k.weft + T(4) * k.shear;
  const Row<T> one = row_of(T(1));
  for (int64_t block : each_block(sheet.fan_start.count - 1)) {
    const Points<T> own = points_in(x + 3 * LANES * block), old = points_in(before + 3 * LANES * block);
    const Turns<T> turn = turns_in(turns + 4 * LANES * block);
    Points<T> g = {};
    for (int64_t row = sheet.fan_start[block]; row < sheet.fan_start[block + 1]; ++row) {
      const int32_t *first = sheet.fan_other + 2 * LANES * row, *second = first + LANES;
      const T* slope = sheet.fan_slope + 5 * LANES * row;
      Row<T> p1 = row_at(slope), t1 = row_at(slope + LANES), p2 = row_at(slope + 2 * LANES);
      Row<T> t2 = row_at(slope + 3 * LANES), area = row_at(slope + 4 * LANES);
      Turns<T> mean = joined<T>(turn, turn, one, turns_at(turns, first));
      mean = unit_turns(joined<T>(mean, turn, one, turns_at(turns, second)));
      Points<T> a = points_at(x, first) - own - turned_by(mean, points_at(before, first) - old);
      Points<T> b = points_at(x, second) - own - turned_by(mean, points_at(before, second) - old);
      Columns<Row<T>> f = columns(a, b, p1, p2, t1, t2);
      g = g - mix((p1 + p2) * (area * warp), f.p, (t1 + t2) * (area * weft), f.t);
    }
    put_points(gradient + 3 * LANES * block, g);
  }
}

// Moves x [m] (P, 3) in place by so many steps of the carry. before [m] (P, 3) are the places of the frame before; then
// and now are the frames of the network's surface in that frame and in this one.
template <class T>
DEVICE void carry(T* x, const T* before, const T* then, const T* now, const Sheet<T>& sheet,
                  const StiffnessFactor<T>& factor, int64_t steps, Scratch& scratch) {
  const int64_t mark = scratch.used, places = sheet.vertex.count, rows = factor.place.count;
  T *turns = scratch.take<T>(4 * places), *gradient = scratch.take<T>(3 * places);
  T *q = scratch.take<T>(3 * rows), *s = scratch.take<T>(solve_room(factor));
  if (scratch.overflowed) return;
  surface_turns(then, now, sheet, CARRY_PASSES, turns, scratch);
  for (int64_t step = 0; step < steps; ++step) {
    carry_gradient(x, before, turns, sheet, gradient);
    whole_step(x, factor, gradient, q, s);
  }
  scratch.used = mark;
}
