// The limit of strain: what the lift tears or presses together is shared out over the cloth beside it.
//
// The lift moves every vertex by itself. Where skin crosses itself, in a lap or behind a knee, planes of neighbours
// look to opposite sides, and a frame would end with edges of twice their length, with which the next one begins. So
// in each of some passes a vertex goes half of the way by which an edge is longer or shorter than the limit allows, the
// mean over its edges of which that is so (Provot 1995, "Deformation Constraints in a Mass-Spring Model to Describe
// Rigid Cloth Behaviour", Graphics Interface). Other edges stay as they are.
#pragma once
#include "sweeps.hpp"

constexpr double LONGEST = 1.3, SHORTEST = 0.7;  // of an edge's length at rest
constexpr int LIMIT_PASSES = 4;

// The sum of the ways by which edges pull a vertex, and their number.
template <class T> struct Asked { Points<T> way; Row<T> count; };

// Adds half of the excess of an edge. rest and per are the squares of its length at rest and of the number by which
// that is too large; where there is no triangle both are zero.
template <class T> INLINE void ask(Points<T> edge, Row<T> rest, Row<T> per, Asked<T>& to) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  const Row<T> square = per * dot(edge, edge);
  const Row<T> longest = T(LONGEST * LONGEST) * rest, shortest = T(SHORTEST * SHORTEST) * rest;
  const Row<T> wanted = where<T>(square > longest, longest, shortest);
  const Mask<T> off = ((square > longest) | (shortest > square)) & (square > zero);
  if (!lanes_of<T>(off)) return;
  const Row<T> share = T(0.5) - T(0.5) * root<T>(wanted / where<T>(off, square, one));
  to = {plus(to.way, where<T>(off, share, zero), edge), to.count + where<T>(off, one, zero)};
}

// Moves x [m] (P, 3) in place so that no edge is beyond the limits. Most frames have no such edge, and look at each
// once.
template <class T> DEVICE void limit_strain(T* x, const Sheet<T>& sheet, Scratch& scratch) {
  const int64_t mark = scratch.used, places = sheet.vertex.count;
  T* before = scratch.take<T>(3 * places + 1);
  if (scratch.overflowed) return;
  const Row<T> zero = row_of(T(0));
  for (int pass = 0; pass < LIMIT_PASSES; ++pass) {
    copy(before, x, 3 * places);
    int64_t moved = 0;
    for (int64_t block : each_block(places / LANES)) {
      const Points<T> own = points_in(before + 3 * LANES * block);
      Asked<T> asked = {{zero, zero, zero}, zero};
      for (int64_t row = sheet.fan_start[block]; row < sheet.fan_start[block + 1]; ++row) {
        const int32_t* other = sheet.fan_other + 2 * LANES * row;
        const T* slope = sheet.fan_slope + 5 * LANES * row;
        const Row<T> p1 = row_at(slope), t1 = row_at(slope + LANES), p2 = row_at(slope + 2 * LANES);
        const Row<T> t2 = row_at(slope + 3 * LANES), per = p1 * t2 - p2 * t1;
        ask<T>(points_at(before, other) - own, p2 * p2 + t2 * t2, per * per, asked);
        ask<T>(points_at(before, other + LANES) - own, p1 * p1 + t1 * t1, per * per, asked);
      }
      if (!lanes_of<T>(asked.count > zero)) continue;
      put_points(x + 3 * LANES * block, plus(own, T(1) / most<T>(asked.count, row_of(T(1))), asked.way));
      ++moved;
    }
    if (sum_of_all(moved) == 0) break;
  }
  scratch.used = mark;
}
