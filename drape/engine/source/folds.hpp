// One frame of folds: the network's drape and the memory of the frame before in, folded cloth and a new memory out.
//
// The memory holds the folds as a residual r and a velocity u in local frames R of the network's surface X. The frame
// starts from them,
//
//     x = X + R^T r,   v = R^T u dt,
//
// and steps of the whole take from x what is stretched beside the frame before (carry.hpp). Rounds follow: steps of the
// whole cloth, each from x + m v with the momentum m, and sweeps of vertex block descent. v is the way of the last
// step. It is kept from frame to frame, so that the descent has the memory of a heavy ball. Lift and limit end a frame,
// and the new memory is r = R (x - X), u = R v / dt.
#pragma once
#include "carry.hpp"
#include "colliders.hpp"
#include "lift.hpp"
#include "limit.hpp"
#include "numbers.hpp"
#include "pace.hpp"
#include "places.hpp"
#include "residual.hpp"
#include "room.hpp"
#include "untangle.hpp"

constexpr double FAR_M = 0.25;  // a vertex farther from the network's drape is no fold
constexpr double CUT_M = 0.30;  // a frame in which the network moved a vertex farther has no past
constexpr double FIRST_STEP_S = 1.0 / 30.0;  // the step of a frame without a past
constexpr double FADE_S = 1.0;               // in which folds without steps come down to 1/e
constexpr double HOLD = 0.4;  // the share of contact's stiffness that steps of the whole cloth allow leash and friction
constexpr double MOVED_M = 1e-4;  // a vertex lifted farther counts as lifted

// The result of a frame of folds, as the caller reads it.
struct FoldOutcome {
  int64_t settled, reset, lost, turn;
  double untangle_m, lifted_share, lifted_max_m;
};

// The cloth of a frame: its places x [m] (P, 3) and, if it goes on from a frame, those that it came from, both with
// room for one number behind them; how far [m] each was lifted (P,); the planes that held it; and the samples (P,) that
// it lies at.
template <class T> struct Laid {
  T *x, *came, *lifted, *planes;
  int32_t* at;
  INLINE_MEMBER Laid(int64_t places, Scratch& scratch)
      : x(scratch.take<T>(3 * places)), came(scratch.take<T>(3 * places)), lifted(scratch.take<T>(places)),
        planes(scratch.take<T>(PLANES * (places / LANES))), at(scratch.take<int32_t>(places)) {}
};

template <class T> struct FoldSchedule {
  T step_s, kept, momentum;     // kept: of the residual
  int64_t rounds, steps, turn;  // turn: negative without a past
  Pace pace;
  bool within;  // cloth keeps apart from itself
  T friction, clearance, untangle;
};

// Writes the vertices [m] (V, 3), each from its place (V,) of the cloth, and into outcome the share of them that were
// lifted by more than MOVED_M and the farthest way [m] of any.
template <class T>
DEVICE void delivered(const Laid<T>& laid, const Array<int32_t>& place, T* vertices, FoldOutcome& outcome) {
  int64_t count = 0;
  T farthest = 0;
  for (int64_t v : each(place.count)) {
    put_point(vertices, v, point(laid.x, place[v]));
    const T own = laid.lifted[place[v]];
    count += own > T(MOVED_M);
    farthest = more<T>(own, farthest);
  }
  outcome.lifted_share = double(sum_of_all(count)) / double(place.count);
  outcome.lifted_max_m = double(most_of_all(farthest));
}

// Writes the stiffness and slack that hold each place: those of waistband and leash; the place to which the skin has
// taken it; and friction times the stiffness of contact. The planes' own numbers are not set yet.
template <class T> DEVICE void hold_places(const Sheet<T>& sheet, const T* stuck, T friction, T* planes) {
  for (int64_t block : each_block(sheet.fan_start.count - 1)) {
    const T* own = sheet.own + OWN * block;
    T* to = planes + PLANES * block;
    for (int row = 0; row < PLANES; row += LANES) put(to + row, T(0));
    put(to + HELD_ROW, row_at(own + LEASH));
    put(to + SLACK_ROW, T(sheet.constants.slack));
    if (!stuck) continue;
    put3(to + STUCK, points_in(stuck + 3 * LANES * block));
    put(to + FRICTION_ROW, friction * row_at(own + CONTACT));
  }
}

// Moves x [m] by a share momentum of its last way, of which no more than the reach [m] counts.
template <class T> DEVICE void go_on(T* x, const T* way, int64_t places, T momentum, T reach) {
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = 3 * LANES * block;
    Points<T> u = points_in(way + first);
    Row<T> share = momentum * reach / root<T>(most<T>(dot(u, u), row_of(reach * reach)));
    put_points(x + first, plus(points_in(x + first), share, u));
  }
}

template <class T> DEVICE void add_to(T* x, const T* other, int64_t places) {
  for (int64_t block : each_block(3 * places / LANES))
    put(x + LANES * block, row_at(x + LANES * block) + row_at(other + LANES * block));
}

template <class T> DEVICE void set_way(T* way, const T* x, const T* before, int64_t places) {
  for (int64_t block : each_block(3 * places / LANES))
    put(way + LANES * block, row_at(x + LANES * block) - row_at(before + LANES * block));
}

// Moves x by the rounds of a schedule and the lift, and writes the way of the last step. The samples of after are moved
// on. planes are left as they held the cloth at last.
template <class T>
DEVICE void descend_rounds(const Laid<T>& laid, T* way, const T* network, const T* stuck, const Surroundings<T>& around,
                           const FoldConstants<T>& cloth, const FoldSchedule<T>& schedule, FoldMemory<T>& after,
                           Scratch& scratch) {
  const Sheet<T>& sheet = cloth.sheet;
  const Skin<T> skin = skin_of(around.skin, cloth.graph);
  const int64_t mark = scratch.used, places = sheet.vertex.count, clusters = cloth.tangles.start.count - 1;
  const int64_t rows = cloth.factor.place.count;
  T *x = laid.x, *planes = laid.planes, *gradient = scratch.take<T>(3 * places), *before = scratch.take<T>(3 * places);
  T *crossed = scratch.take<T>(places), *q = scratch.take<T>(3 * rows), *s = scratch.take<T>(solve_room(cloth.factor));
  int32_t *every = scratch.take<int32_t>(clusters), *own = after.own.begin, *other = after.other.begin;
  if (scratch.overflowed) return;
  for (int64_t c : each(clusters)) every[c] = int32_t(c);
  follow(network, places, skin, own);
  for (int64_t p : each(places)) laid.at[p] = own[p];
  lay_back(x, network, places, skin, own, nullptr);
  hold_places(sheet, stuck, schedule.friction, planes);
  for (int64_t round = 0; round < schedule.rounds; ++round) {
    touch(x, network, places, skin, sheet.vertex.begin, own, other, laid.at, schedule.turn, planes, scratch);
    put_collider_planes(x, places, around.colliders, planes);
    if (schedule.within) keep_apart(x, sheet, cloth.neighbours, planes, scratch);
    if (round == 0 && schedule.turn < 0)
      // Triangles that the network stretches are stiffer than K knows, and steps would run away: sweeps first.
      for (int64_t sweep = 0; sweep < schedule.rounds; ++sweep) descend(x, sheet, planes, network);
    for (int64_t step = 0; step < schedule.steps; ++step) {
      copy(before, x, 3 * places);
      go_on(x, way, places, schedule.momentum, T(sheet.constants.reach));
      gradient_at(x, sheet, planes, network, T(HOLD), gradient);
      whole_step(x, cloth.factor, gradient, q, s);
      set_way(way, x, before, places);
    }
    for (int64_t sweep = 0; sweep < schedule.pace.sweeps; ++sweep) descend(x, sheet, planes, network);
    if (schedule.within &&
        untangle(x, places, cloth.tangles, every, clusters, schedule.untangle, UNTANGLE_STEPS, crossed, scratch) > 0)
      ease(x, network, crossed, T(EASE / WAY_M) * schedule.untangle, sheet, scratch);
  }
  if (schedule.rounds == 0 && (schedule.clearance > 0 || around.colliders.count))  // there are no planes yet
    touch(x, network, places, skin, sheet.vertex.begin, own, other, laid.at, schedule.turn, planes, scratch);
  leave_colliders(x, places, around.colliders, planes, schedule.clearance);
  if (schedule.clearance > 0) {
    lift(x, places, planes, schedule.clearance, laid.lifted);
    limit_strain(x, sheet, scratch);
  }
  scratch.used = mark;
}

// Writes the places x [m] (P, 3) of residuals (P, 3) [m] in the frames of a surface [m] (P, 3).
template <class T>
DEVICE void put_folded(const T* surface, const T* frames, const T* residual, int64_t places, T* x) {
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = 3 * LANES * block;
    const Points<T> off = to_world(axes_in(frames + FRAMES * block), points_in(residual + first));
    put_points(x + first, points_in(surface + first) + off);
  }
}

// Writes the places of the cloth after a schedule, and moves after on in place. Returns how far [m] the farthest place
// is from the network's, NaN where a place is NaN.
template <class T>
DEVICE T advance(const Laid<T>& laid, const T* before, const T* network, const Surroundings<T>& around,
                 const FoldConstants<T>& cloth, const FoldSchedule<T>& schedule, FoldMemory<T>& after,
                 Scratch& scratch) {
  const Sheet<T>& sheet = cloth.sheet;
  const Skin<T> skin = skin_of(around.skin, cloth.graph);
  const int64_t mark = scratch.used, places = sheet.vertex.count, blocks = places / LANES;
  T *x = laid.x, *stuck = scratch.take<T>(3 * places), *way = scratch.take<T>(3 * places);
  T* kept = scratch.take<T>(3 * places);  // where the cloth was, without what it forgets
  T *then = scratch.take<T>(FRAMES * blocks), *frames = scratch.take<T>(FRAMES * blocks);
  if (scratch.overflowed) return T(__builtin_nan(""));
  stuck_places<T>(after.grip, places, after.own, skin, stuck);
  surface_frames(network, sheet, frames);
  if (schedule.turn >= 0) {
    surface_frames(before, sheet, then);
    put_folded<T>(before, then, after.residual, places, laid.came);
  }
  for (int64_t block : each_block(blocks)) {
    const int64_t first = 3 * LANES * block;
    const AxesOf<T> axes = axes_in(frames + FRAMES * block);
    put_points(x + first, to_world(axes, scaled(row_of(schedule.kept), points_in(after.residual + first))));
    put_points(way + first, to_world(axes, scaled(row_of(schedule.step_s), points_in(after.velocity + first))));
  }
  keep_residual(x, before, network, frames, sheet, cloth.hem, scratch);
  add_to(x, network, places);
  if (schedule.turn >= 0 && schedule.rounds > 0) {
    set_way(kept, laid.came, before, places);
    keep_residual(kept, before, network, frames, sheet, cloth.hem, scratch);
    add_to(kept, before, places);
    carry<T>(x, kept, then, frames, sheet, cloth.factor, schedule.pace.carries, scratch);
  }
  for (int64_t block : each_block(blocks)) put(laid.lifted + LANES * block, T(0));
  descend_rounds(laid, way, network, stuck, around, cloth, schedule, after, scratch);
  write_grip<T>(x, places, schedule.turn < 0 ? x : stuck, after.own, skin, after.grip);
  const Row<T> per_s = row_of(T(1) / schedule.step_s);
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = 3 * LANES * block;
    const AxesOf<T> axes = axes_in(frames + FRAMES * block);
    put_points(after.residual + first, to_frame(axes, points_in(x + first) - points_in(network + first)));
    put_points(after.velocity + first, to_frame(axes, scaled(per_s, points_in(way + first))));
  }
  scratch.used = mark;
  return farthest_m(x, network, places);
}

// Computes the frame after past, or one without a past: writes the places of the cloth and the arrays of after.
template <class T>
DEVICE FoldOutcome advanced(const Laid<T>& laid, const T* network, const FoldMemory<T>& past, bool follows,
                            const Surroundings<T>& around, const FoldConstants<T>& cloth, const FoldEffort<T>& effort,
                            Pace pace, FoldMemory<T>& after, Scratch& scratch) {
  const int64_t mark = scratch.used, places = cloth.sheet.vertex.count;
  T* before = scratch.take<T>(3 * places);  // the network's places, which points_at reads, with room behind them
  if (scratch.overflowed) return {};
  copy<T>(before, follows ? past.network.begin : network, 3 * places);
  const double step_s = follows ? past.step_s : FIRST_STEP_S;
  const int64_t rounds = effort.steps == 0 ? 0 : follows ? 1 : effort.settle;
  const double kept = effort.steps ? 1 : exponential_of(-step_s / FADE_S), still = kept == 1 ? 1 : 0;
  const double way_m = follows ? moved_m<T>(before, network, cloth.sheet.place) : 0;
  const Constants<T>& k = cloth.sheet.constants;  // of which each is half of the fabric's
  const double paced = momentum_of(calmness(way_m), k.warp + k.weft > STIFF_N_PER_M);
  const double momentum = !follows && rounds >= LONG_ROUNDS ? SETTLING_MOMENTUM : paced;
  const double untangle_m = follows ? farthest_way(way_m) : WAY_M;
  const double friction = follows ? grip_left(way_m, step_s) * cloth.friction : 0;
  const FoldSchedule<T> schedule = {T(step_s), T(kept), T(momentum), rounds, effort.steps,
                                    follows ? past.turn : -1, pace, effort.cloth_contact && rounds > 0, T(friction),
                                    T(effort.clearance_m), T(untangle_m)};
  for (int64_t p : each(places)) {
    after.own[p] = follows ? past.own[p] : cloth.index[p];
    after.other[p] = follows ? past.other[p] : -1;
  }
  for (int64_t i : each(3 * places)) {
    after.residual[i] = follows ? past.residual[i] : T(0);
    after.velocity[i] = follows ? T(still) * past.velocity[i] : T(0);
    after.grip[i] = follows ? past.grip[i] : T(0);
  }
  const T far = advance(laid, before, network, around, cloth, schedule, after, scratch);
  scratch.used = mark;
  return {!follows, 0, !(far <= T(FAR_M)), follows ? (past.turn + 1) % TURNS : 1, untangle_m, 0, 0};
}

// Writes the cloth of a frame around the network's places [m] (P, 3). If the result is no fold, the frame is computed
// once more without its past. If that is no fold either, the outcome is lost: the network's drape is delivered, and no
// memory is left.
template <class T>
DEVICE FoldOutcome fold_places(const Laid<T>& laid, const T* network, const FoldMemory<T>& past,
                               const Surroundings<T>& around, const FoldConstants<T>& cloth,
                               const FoldEffort<T>& effort, Pace pace, FoldMemory<T>& after, Scratch& scratch) {
  const int64_t places = cloth.sheet.vertex.count;
  const bool goes_on = past.step_s < INFINITE;
  const bool follows = goes_on && farthest_m<T>(network, past.network, places) <= T(CUT_M);
  copy<T>(after.network, network, 3 * places);
  if (follows) {
    FoldOutcome outcome = advanced(laid, network, past, true, around, cloth, effort, pace, after, scratch);
    if (!outcome.lost) return outcome;
  }
  FoldOutcome outcome = advanced(laid, network, past, false, around, cloth, effort, pace, after, scratch);
  outcome.reset = goes_on || outcome.lost;
  if (!outcome.lost) return outcome;
  outcome.turn = 0;
  for (int64_t p : each(places)) after.own[p] = cloth.index[p], after.other[p] = -1, laid.lifted[p] = 0;
  for (int64_t i : each(3 * places)) after.residual[i] = after.velocity[i] = after.grip[i] = 0;
  return outcome;
}

// Writes the folded vertices [m] (V, 3) of one level and the memory after them.
template <class T>
DEVICE FoldOutcome fold_one_level(const T* vertices, const FoldMemory<T>& past, const Surroundings<T>& around,
                                  const FoldConstants<T>& cloth, const FoldEffort<T>& effort, FoldMemory<T>& after,
                                  T* folded, Scratch& scratch) {
  const int64_t places = cloth.sheet.vertex.count;
  const Laid<T> laid(places, scratch);
  T* network = scratch.take<T>(3 * places);
  if (scratch.overflowed) return {};
  placed(vertices, cloth.sheet.vertex, network);
  const Pace pace = {1, effort.steps};
  FoldOutcome outcome = fold_places(laid, network, past, around, cloth, effort, pace, after, scratch);
  delivered(laid, cloth.sheet.place, folded, outcome);
  if (outcome.lost) copy(folded, vertices, 3 * cloth.sheet.place.count);
  return outcome;
}
