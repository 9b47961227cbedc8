// Cloth without folds: the network's drape, eased by one step a frame of the whole coarse cloth, and lifted off the skin.
//
// The network stretches cloth that no triangle of it feels. A step of the stiffness that the coarse cloth has at rest
// takes most of that out. Contact is that with the skin below the cloth and with another part of the body beside it: a
// shirt's hem lies on the lap, and on the trousers that raise it. How far a frame was eased goes along with the
// network's surface, fades with the time EASED_S and is where the next step begins. The memory has the network's coarse
// places, the samples own, and how far each was eased in residual.
#pragma once
#include "levels.hpp"

constexpr double EASED_S = 0.65;  // in which what eased cloth comes down to 1/e

// Writes how far [m] (P, 3) so many steps of folds move the coarse cloth from the network's places under [m] (P, 3),
// which have room for one number behind them: in the world's axes to off, in those of the surface to eased. The steps
// begin with a share of the eased of the frame before, if there is one; a result that is no fold is left out. The
// samples own are moved on, and those of other body parts are found.
template <class T>
DEVICE void ease_off(const T* under, const T* before, T share, int32_t* own, int32_t* other, int32_t* at,
                     const Skin<T>& skin, const FoldConstants<T>& cloth, int64_t steps, T* eased, T* off, Scratch& scratch) {
  const int64_t mark = scratch.used, places = cloth.sheet.vertex.count, count = cloth.factor.place.count;
  T *x = scratch.take<T>(3 * places), *gradient = scratch.take<T>(3 * places);
  T *frames = scratch.take<T>(FRAMES * (places / LANES)), *planes = scratch.take<T>(PLANES * (places / LANES));
  T *q = scratch.take<T>(3 * count), *s = scratch.take<T>(solve_room(cloth.factor));
  if (scratch.overflowed) return;
  surface_frames(under, cloth.sheet, frames);
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = 3 * LANES * block;
    const AxesOf<T> axes = axes_in(frames + FRAMES * block);
    Points<T> points = points_in(under + first);
    if (before) points = points + to_world(axes, scaled(row_of(share), points_in(before + first)));
    put_points(x + first, points);
  }
  hold_places<T>(cloth.sheet, nullptr, T(0), planes);
  for (int64_t p : each(places)) other[p] = -1;
  touch(x, under, places, skin, cloth.sheet.vertex.begin, own, other, at, -1, planes, scratch);
  for (int64_t step = 0; step < steps; ++step) {
    gradient_at<T>(x, cloth.sheet, planes, under, T(HOLD), gradient);
    whole_step(x, cloth.factor, gradient, q, s);
  }
  const bool fits = farthest_m<T>(x, under, places) <= T(FAR_M);
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = 3 * LANES * block;
    Points<T> way = fits ? points_in(x + first) - points_in(under + first) : Points<T>{};
    put_points(off + first, way);
    put_points(eased + first, fits ? to_frame(axes_in(frames + FRAMES * block), way) : way);
  }
  scratch.used = mark;
}

// Lifts the fine cloth up to the clearance [m] over the skin and out of the colliders. at and other (C,) are the
// samples of the coarse places, the latter those of other body parts.
template <class T>
DEVICE void lift_off(const Laid<T>& laid, const int32_t* at, const int32_t* other, const Skin<T>& skin,
                     const Array<double>& colliders, const FineLevel<T>& fine, T clearance) {
  const int64_t places = fine.sheet.vertex.count;
  for (int64_t block : each_block(places / LANES)) put(laid.lifted + LANES * block, T(0));
  for (int64_t block : each_block(PLANES / LANES * (places / LANES))) put(laid.planes + LANES * block, T(0));
  put_own_planes(laid.x, places, skin, at, fine.parent.begin, laid.planes);
  put_other_planes(laid.x, places, skin, other, fine.parent.begin, laid.planes);
  put_collider_planes(laid.x, places, colliders, laid.planes);
  leave_colliders(laid.x, places, colliders, laid.planes, clearance);
  if (clearance > 0) lift(laid.x, places, laid.planes, clearance, laid.lifted);
}

// Writes the eased and lifted vertices [m] (V, 3), and the memory after them.
template <class T>
DEVICE FoldOutcome lift_alone(const T* vertices, const FoldMemory<T>& past, const Surroundings<T>& around,
                              const Levels<T>& levels, const FoldEffort<T>& effort, FoldMemory<T>& after,
                              T* lifted_vertices, Scratch& scratch) {
  const FoldConstants<T>& coarse = levels.coarse;
  const FineLevel<T>& fine = levels.fine;
  const Skin<T> skin = skin_of(around.skin, coarse.graph);
  const int64_t places = fine.sheet.vertex.count, below = coarse.sheet.vertex.count;
  const Laid<T> laid(places, scratch);
  T *x = laid.x, *under = scratch.take<T>(3 * below), *off = scratch.take<T>(3 * below);
  int32_t *other = scratch.take<int32_t>(below), *at = scratch.take<int32_t>(below);
  if (scratch.overflowed) return {};
  placed(vertices, fine.sheet.vertex, x);
  placed(vertices, levels.kept, under);
  copy<T>(after.network, under, 3 * below);
  const bool goes_on = past.step_s < INFINITE;
  const bool follows = goes_on && farthest_m<T>(under, past.network, below) <= T(CUT_M);
  for (int64_t p : each(below)) after.own[p] = follows ? past.own[p] : coarse.index[p];
  follow(under, below, skin, after.own.begin);
  const double share = follows ? exponential_of(-past.step_s / EASED_S) : 0;
  ease_off<T>(under, follows ? past.residual.begin : nullptr, T(share), after.own, other, at, skin, coarse,
              follows ? 1 : effort.settle, after.residual, off, scratch);
  if (scratch.overflowed) return {};
  for (int64_t block : each_block(places / LANES))
    put_points(x + 3 * LANES * block, carried(points_in(x + 3 * LANES * block), off, fine, block));
  lift_off<T>(laid, at, other, skin, around.colliders, fine, T(effort.clearance_m));
  FoldOutcome outcome = {!follows, goes_on && !follows, 0, 0, 0, 0, 0};
  delivered(laid, fine.sheet.place, lifted_vertices, outcome);
  return outcome;
}
