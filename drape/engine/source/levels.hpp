// Folds on two levels: steps of a coarse cloth, and sweeps that settle the fine one around it.
//
// What is costly in a frame is contact: with the skin, and of cloth with itself. Folds of a few centimetres need no
// fine cloth for it. So the coarse cloth, about a fifth of the vertices, takes the frame's steps (folds.hpp) and two
// more: a step of it costs a third of a sweep, and a circle skirt with four crosses itself. Their way from the
// network's drape is carried to all vertices by weights W, and
//
//     x = (1 - share) (X + W (x_c - X_c)) + share W (x_c + Q (y - y_c))
//
// is where sweeps of vertex block descent begin. y and y_c are the fine and the coarse places of the frame before, and
// Q the turns of the coarse cloth since then (turns.hpp). The share comes down with the time KEPT_S, and less so for a
// place that moves slowly: what rests would otherwise never settle, since what is forgotten comes back crumpled. No
// contact with the skin is looked for on the fine cloth: its planes are those of the sample that its coarse vertex is
// at, blended anew.
// Cloth beside cloth is looked at where the coarse vertex is near other cloth (fine_room.hpp). Lift and limit are last.
#pragma once
#include "fine_room.hpp"
#include "folds.hpp"

constexpr int NEAREST = 8;       // coarse vertices that a fine one takes from
constexpr int APART_STEPS = 4;   // of untangling the fine cloth, before its sweeps and after them
constexpr Pace COARSE_PACE = {3, 1};  // sweeps are the fine cloth's
constexpr int FINE_PASSES = 2;   // of the coarse cloth's turns: none leave jitter
constexpr int64_t MORE_STEPS = 2;  // of the coarse cloth than sweeps of the fine one
constexpr double KEPT_S = 1.5;    // in which the share that is carried on comes down to 1/e, of cloth that moves
constexpr double SLOW_M_S = 0.2;  // speed of a place that forgets half as much

// Returns the points of a block of the fine cloth, moved as their coarse places are, which went by off [m] (P, 3).
template <class T> INLINE Points<T> carried(Points<T> points, const T* off, const FineLevel<T>& fine, int64_t block) {
  for (int64_t row = NEAREST * LANES * block; row < NEAREST * LANES * (block + 1); row += LANES)
    points = plus(points, row_at(fine.weight + row), points_at(off, fine.near + row));
  return points;
}

// Writes the table (P, 16) by which coarse places carry fine ones, from the coarse places of the frame before to those
// of this one.
template <class T>
DEVICE void write_carriers(const Laid<T>& coarse, const Sheet<T>& sheet, T* table, Scratch& scratch) {
  const int64_t mark = scratch.used, places = sheet.vertex.count, blocks = places / LANES;
  T *then = scratch.take<T>(FRAMES * blocks), *now = scratch.take<T>(FRAMES * blocks);
  T* turns = scratch.take<T>(4 * places);
  if (scratch.overflowed) return;
  surface_frames(coarse.came, sheet, then);
  surface_frames(coarse.x, sheet, now);
  surface_turns(then, now, sheet, FINE_PASSES, turns, scratch);
  for (int64_t block : each_block(blocks)) {
    const int64_t first = 3 * LANES * block;
    int32_t index[WIDTH];
    for (int k = 0; k < WIDTH; ++k) index[k] = int32_t(LANES * block) + lane_of(k);
    put_nodes(table, index, matrix_of(turns_in(turns + 4 * LANES * block)), points_in(coarse.came + first),
              points_in(coarse.x + first), T(1));
  }
  scratch.used = mark;
}

// How the fine cloth is laid. The share of its start that coarse places carry on from the frame before by their table,
// and the share that it has more at rest, half of that where the way [m] times slow_per_m is 1; how far [m] crossing
// cloth comes apart in a step; the clearance [m] of the lift; and the number of sweeps.
template <class T> struct FineSchedule {
  T share, more, slow_per_m, untangle, clearance;
  int64_t sweeps;
  const T* table;
};

// Lays the fine cloth around the network's places [m] (P, 3). The coarse cloth lies off [m] (P, 3) the network's, on
// the samples of after. The fine places [m] (P, 3) of the frame before are read from before, and those of this frame
// are written to after.
template <class T>
DEVICE void settle_fine(const Laid<T>& laid, const Laid<T>& coarse, const T* network, const T* off, const T* before,
                        const Surroundings<T>& around, const Levels<T>& levels, const FineSchedule<T>& schedule,
                        FoldMemory<T>& after, Scratch& scratch) {
  const FineLevel<T>& fine = levels.fine;
  const Skin<T> skin = skin_of(around.skin, levels.coarse.graph);
  const int64_t mark = scratch.used, places = fine.sheet.vertex.count;
  T *x = laid.x, *planes = laid.planes, *crossed = scratch.take<T>(places);
  int32_t* close = scratch.take<int32_t>(fine.tangles.start.count);
  if (scratch.overflowed) return;
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block, entry = NEAREST * first;
    Points<T> points = carried(points_in(network + 3 * first), off, fine, block);
    if (schedule.share > 0) {
      for (int k = 0; k < WIDTH; ++k) {
        const int lane = lane_of(k);
        put_point(x, first + lane, carried_by(schedule.table, fine.near + entry + lane, fine.weight + entry + lane,
                                              LANES, point(before, first + lane)));
      }
      const Points<T> now = points_in(x + 3 * first), way = now - points_in(before + 3 * first);
      const Row<T> slow = row_of(T(1)) / (row_of(T(1)) + schedule.slow_per_m * root<T>(dot(way, way)));
      const Row<T> share = row_of(schedule.share) + schedule.more * slow;
      points = plus(points, share, now - points);
    }
    put_points(x + 3 * first, points);
    put(laid.lifted + first, T(0));
  }
  lay_back(x, network, places, skin, after.own.begin, fine.parent.begin);
  hold_places<T>(fine.sheet, nullptr, T(0), planes);
  put_own_planes<T>(x, places, skin, coarse.at, fine.parent, planes);
  put_other_planes<T>(x, places, skin, after.other, fine.parent, planes);
  put_collider_planes(x, places, around.colliders, planes);
  for (int64_t p : each(places))
    planes[PLANES * (p / LANES) + NEAR_ROW + p % LANES] = T(lies_near(coarse.planes, fine, p));
  const int64_t found = schedule.untangle > 0 ? close_clusters(coarse.planes, fine, close) : 0;
  const auto come_apart = [&] {
    untangle(x, places, fine.tangles, close, found, schedule.untangle, APART_STEPS, crossed, scratch);
  };
  if (found > 0) {
    come_apart();
    keep_fine_apart<T>(x, coarse.planes, levels, planes, scratch);
  }
  for (int64_t sweep = 1; sweep <= schedule.sweeps; ++sweep)
    descend(x, fine.sheet, planes, network, sweep < schedule.sweeps);  // the last leaves no step too long
  if (found > 0) come_apart();
  leave_colliders(x, places, around.colliders, planes, schedule.clearance);
  if (schedule.clearance > 0) {
    lift(x, places, planes, schedule.clearance, laid.lifted);
    limit_strain(x, fine.sheet, scratch);
  }
  copy<T>(after.fine, x, 3 * places);
  scratch.used = mark;
}

// Writes the folded vertices [m] (V, 3) of two levels and the memory after them: that of the coarse cloth, and the fine
// places [m] (P, 3).
template <class T>
DEVICE FoldOutcome fold_two_levels(const T* vertices, const FoldMemory<T>& past, const Surroundings<T>& around,
                                   const Levels<T>& levels, const FoldEffort<T>& effort, FoldMemory<T>& after,
                                   T* folded, Scratch& scratch) {
  const FineLevel<T>& fine = levels.fine;
  const int64_t places = fine.sheet.vertex.count, below = levels.coarse.sheet.vertex.count;
  const Laid<T> laid(places, scratch), coarse(below, scratch);
  T *network = scratch.take<T>(3 * places), *under = scratch.take<T>(3 * below), *off = scratch.take<T>(3 * below);
  if (scratch.overflowed) return {};
  placed(vertices, fine.sheet.vertex, network);
  placed(vertices, levels.kept, under);
  FoldEffort<T> coarsely = effort;
  if (effort.steps == 0) coarsely.clearance_m = 0;  // what no step moved is lifted on the fine cloth
  else coarsely.steps += MORE_STEPS;
  FoldOutcome outcome = fold_places(coarse, under, past, around, levels.coarse, coarsely, COARSE_PACE, after, scratch);
  if (scratch.overflowed) return outcome;
  for (int64_t i : each(3 * below)) off[i] = outcome.lost ? T(0) : coarse.x[i] - under[i];
  const int64_t sweeps = effort.steps * (outcome.settled ? effort.settle : 1);
  const bool goes_on = !outcome.settled && past.fine.count > 0;
  const double share = goes_on ? exponential_of(-past.step_s / (effort.steps ? KEPT_S : FADE_S)) : 0;
  const double untangle_m = sweeps > 0 && effort.cloth_contact ? outcome.untangle_m : 0;
  T* table = scratch.take<T>(LANES * below);
  if (scratch.overflowed) return outcome;
  if (goes_on) write_carriers(coarse, levels.coarse.sheet, table, scratch);
  const double more = effort.steps ? 1 - share : 0, slow_per_m = 1 / (SLOW_M_S * past.step_s);
  const FineSchedule<T> schedule = {T(share), T(more), T(slow_per_m), T(untangle_m), T(effort.clearance_m),
                                    sweeps, table};
  settle_fine<T>(laid, coarse, network, off, past.fine, around, levels, schedule, after, scratch);
  outcome.lost = !(farthest_m(laid.x, network, places) <= T(FAR_M));
  if (outcome.lost) {
    outcome.reset = 1;
    for (int64_t p : each(places)) laid.lifted[p] = 0;
    copy<T>(after.fine, network, 3 * places);
  }
  delivered(laid, fine.sheet.place, folded, outcome);
  if (outcome.lost) copy(folded, vertices, 3 * fine.sheet.place.count);
  return outcome;
}
