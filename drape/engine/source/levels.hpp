// Folds on two levels: steps of a coarse cloth, and sweeps that settle the fine one around it.
//
// What is costly in a frame is contact: with the skin, and of cloth with itself. Folds of a few centimetres need no fine
// cloth for it. So the coarse cloth, about a fifth of the vertices, takes the frame's steps (folds.hpp). Their way from
// the network's drape is carried to all vertices by weights W, and
//
//     x = X + W (x_c - X_c) + share e
//
// is where sweeps of vertex block descent begin. e is what the sweeps of the frame before added; it fades with the time
// KEPT_S. No contact is looked for on the fine cloth. Its planes are those of the sample that its coarse vertex is at,
// blended anew. Where its coarse vertex is kept apart from others, crossings come apart. The lift ends the frame.
#pragma once
#include "folds.hpp"

constexpr int NEAREST = 8;          // coarse vertices that a fine one takes from
constexpr int APART_STEPS = 2;      // of untangling the fine cloth: four leave fewer crossings and cost time and gain
constexpr double KEPT_S = 0.25;     // in which what sweeps added comes down to 1/e: more lets fine folds pass each other
constexpr double EASED_S = 0.65;    // in which what eased cloth without folds comes down to 1/e

// The points of a block of the fine cloth, moved as the coarse places are that went off [m] (P, 3).
template <class T> INLINE Points<T> carried(Points<T> points, const T* off, const FineLevel<T>& fine, int64_t block) {
  for (int64_t row = NEAREST * LANES * block; row < NEAREST * LANES * (block + 1); row += LANES)
    points = plus(points, row_at(fine.weight + row), points_at(off, fine.near + row));
  return points;
}

// Writes the clusters of the fine cloth's tangles with a triangle whose first corner's coarse place is kept apart by its
// planes. Returns their number.
template <class T> int64_t close_clusters(const T* planes, const FineLevel<T>& fine, int32_t* found) {
  int64_t filled = 0;
  for (int64_t c = 0; c < fine.tangles.start.count - 1; ++c) {
    bool close = false;
    for (int lane = 0; lane < LANES; ++lane) {
      const int64_t v = fine.parent[fine.tangles.corner[3 * LANES * c + lane]];
      close |= planes[PLANES * (v / LANES) + APART_ROW + v % LANES] > 0;
    }
    if (close) found[filled++] = int32_t(c);
  }
  return filled;
}

// Writes the folded vertices [m] (V, 3) of two levels and the memory after them: that of the coarse cloth, and what sweeps
// added [m] to the fine one.
template <class T>
FoldOutcome fold_two_levels(const T* vertices, const FoldMemory<T>& past, const Surroundings<T>& around, const Levels<T>& levels,
                            const FoldEffort<T>& effort, FoldMemory<T>& after, T* folded, Scratch& scratch) {
  const FoldConstants<T>& coarse = levels.coarse;
  const FineLevel<T>& fine = levels.fine;
  const Skin<T> skin = skin_of(around.skin, coarse.graph);
  const int64_t mark = scratch.used, places = fine.sheet.vertex.count, below = coarse.sheet.vertex.count;
  T *network = scratch.take<T>(3 * places), *x = scratch.take<T>(3 * places), *lifted = scratch.take<T>(places);
  T *planes = scratch.take<T>(PLANES * (places / LANES)), *start = scratch.take<T>(3 * places), *crossed = scratch.take<T>(places);
  T *off = scratch.take<T>(3 * below), *coarse_x = scratch.take<T>(3 * below), *coarse_lifted = scratch.take<T>(below);
  T *coarse_planes = scratch.take<T>(PLANES * (below / LANES)), *under = scratch.take<T>(3 * below);
  int32_t* close = scratch.take<int32_t>(fine.tangles.start.count);
  if (scratch.overflowed) return {};
  placed(vertices, fine.sheet.vertex, network);
  placed(vertices, levels.kept, under);
  __builtin_memcpy(after.network.begin, under, size_t(3 * below) * sizeof(T));
  FoldEffort<T> coarsely = effort;
  if (effort.steps == 0) coarsely.clearance_m = 0;  // what no step moved is lifted on the fine cloth
  FoldOutcome outcome = fold_places(under, past, skin, around.colliders, coarse, coarsely, after, coarse_x, coarse_lifted,
                                    coarse_planes, scratch);
  if (scratch.overflowed) return outcome;
  for (int64_t i = 0; i < 3 * below; ++i) off[i] = outcome.lost ? T(0) : coarse_x[i] - under[i];

  const T clearance = T(effort.clearance_m);
  const int64_t sweeps = effort.steps * (outcome.settled ? effort.settle : 1);
  const double share = outcome.settled ? 0 : exponential_of(-past.step_s / (effort.steps ? KEPT_S : FADE_S));
  for (int64_t block = 0; block < places / LANES; ++block) {
    const int64_t first = 3 * LANES * block;
    Points<T> points = carried(points_in(network + first), off, fine, block);
    put_points(start + first, points);
    if (share > 0) points = plus(points, row_of(T(share)), points_in(past.added + first));
    put_points(x + first, points);
    put(lifted + LANES * block, T(0));
  }
  hold_places<T>(fine.sheet, nullptr, T(0), planes);
  put_own_planes(x, places, skin, after.own.begin, fine.parent.begin, planes);
  put_other_planes(x, places, skin, after.other.begin, fine.parent.begin, planes);
  put_collider_planes(x, places, around.colliders, planes);
  for (int64_t sweep = 0; sweep < sweeps; ++sweep) descend(x, fine.sheet, planes, network);
  if (sweeps > 0 && effort.cloth_contact)
    untangle(x, places, fine.tangles, close, close_clusters(coarse_planes, fine, close), T(outcome.untangle_m), APART_STEPS,
             crossed, scratch);
  leave_colliders(x, places, around.colliders, planes, clearance);
  if (clearance > 0) lift(x, places, planes, clearance, lifted);
  const bool lost = !(farthest_m(x, network, places) <= T(FAR_M));
  for (int64_t i = 0; i < 3 * places; i += LANES)
    put(after.added + i, lost ? row_of(T(0)) : row_at(x + i) - row_at(start + i));
  if (lost)
    for (int64_t p = 0; p < places; ++p) lifted[p] = 0;
  delivered(x, lifted, fine.sheet.place, folded, outcome);
  if (lost) {
    __builtin_memcpy(folded, vertices, size_t(3 * fine.sheet.place.count) * sizeof(T));
    outcome.reset = 1;
  }
  outcome.lost = lost;
  scratch.used = mark;
  return outcome;
}

// Cloth without folds: the network's drape, eased by one step a frame of the whole coarse cloth, and lifted off the skin.
//
// The network stretches cloth that no triangle of it feels. A step of the stiffness that the coarse cloth has at rest
// takes most of that out, and needs no search: contact is that with the samples of the skin that the cloth is followed
// to. How far a frame was eased goes along with the network's surface, fades with the time EASED_S and is where the next
// step begins. The memory has the network's coarse places, the samples own, and how far each was eased in residual.

// Writes how far [m] (P, 3) so many steps move the coarse cloth from where the network has it, under [m] (P, 3), with room
// for one number behind it: in the world's axes to off, in those of the surface to eased. It begins with a share of what
// it was eased before, if anything. What is no fold is left out.
template <class T>
void ease_off(const T* under, const T* before, T share, const int32_t* own, const Skin<T>& skin, const FoldConstants<T>& cloth,
              int64_t steps, T* eased, T* off, Scratch& scratch) {
  const int64_t mark = scratch.used, places = cloth.sheet.vertex.count, count = cloth.factor.place.count;
  T *x = scratch.take<T>(3 * places), *gradient = scratch.take<T>(3 * places);
  T *frames = scratch.take<T>(FRAMES * (places / LANES)), *planes = scratch.take<T>(PLANES * (places / LANES));
  T *q = scratch.take<T>(3 * count), *s = scratch.take<T>(3 * (count + LANES));
  if (scratch.overflowed) return;
  surface_frames(under, cloth.sheet, frames);
  for (int64_t block = 0; block < places / LANES; ++block) {
    const int64_t first = 3 * LANES * block;
    Points<T> points = points_in(under + first);
    if (before) points = points + to_world(axes_in(frames + FRAMES * block), scaled(row_of(share), points_in(before + first)));
    put_points(x + first, points);
  }
  hold_places<T>(cloth.sheet, nullptr, T(0), planes);
  put_own_planes<T>(x, places, skin, own, nullptr, planes);
  for (int64_t step = 0; step < steps; ++step) {
    gradient_at<T>(x, cloth.sheet, planes, under, T(HOLD), gradient);
    whole_step(x, cloth.factor, gradient, T(1), q, s);
  }
  const bool fits = farthest_m(x, under, places) <= T(FAR_M);
  for (int64_t block = 0; block < places / LANES; ++block) {
    const int64_t first = 3 * LANES * block;
    Points<T> way = fits ? points_in(x + first) - points_in(under + first) : Points<T>{};
    put_points(off + first, way);
    put_points(eased + first, fits ? to_frame(axes_in(frames + FRAMES * block), way) : way);
  }
  scratch.used = mark;
}

// Moves x [m] (P, 3) in place up to the clearance [m] over the skin below it and out of the colliders; own (C,) are the
// samples below the coarse places. Writes how far each place was lifted (P,).
template <class T>
void lift_off(T* x, const int32_t* own, const Skin<T>& skin, const Array<double>& colliders, const FineLevel<T>& fine, T clearance,
              T* planes, T* lifted) {
  const int64_t places = fine.sheet.vertex.count;
  for (int64_t i = 0; i < places; i += LANES) put(lifted + i, T(0));
  if (colliders.count == 0) {
    if (clearance > 0) lift_off_skin(x, places, skin, own, fine.parent.begin, clearance, lifted);
    return;
  }
  for (int64_t i = 0; i < PLANES * (places / LANES); i += LANES) put(planes + i, T(0));
  put_own_planes(x, places, skin, own, fine.parent.begin, planes);
  put_collider_planes(x, places, colliders, planes);
  leave_colliders(x, places, colliders, planes, clearance);
  if (clearance > 0) lift(x, places, planes, clearance, lifted);
}

// Writes the eased and lifted vertices [m] (V, 3), and the memory after them.
template <class T>
FoldOutcome lift_alone(const T* vertices, const FoldMemory<T>& past, const Surroundings<T>& around, const Levels<T>& levels,
                       const FoldEffort<T>& effort, FoldMemory<T>& after, T* lifted_vertices, Scratch& scratch) {
  const FoldConstants<T>& coarse = levels.coarse;
  const FineLevel<T>& fine = levels.fine;
  const Skin<T> skin = skin_of(around.skin, coarse.graph);
  const int64_t mark = scratch.used, places = fine.sheet.vertex.count, below = coarse.sheet.vertex.count;
  T *x = scratch.take<T>(3 * places), *lifted = scratch.take<T>(places), *planes = scratch.take<T>(PLANES * (places / LANES));
  T *under = scratch.take<T>(3 * below), *off = scratch.take<T>(3 * below);
  if (scratch.overflowed) return {};
  placed(vertices, fine.sheet.vertex, x);
  placed(vertices, levels.kept, under);
  const bool follows = past.step_s < INFINITE && farthest_m<T>(under, past.network.begin, below) <= T(CUT_M);
  for (int64_t p = 0; p < below; ++p) after.own[p] = follows ? past.own[p] : coarse.index[p];
  follow(under, below, skin, after.own.begin);
  const double share = follows ? exponential_of(-past.step_s / EASED_S) : 0;
  ease_off<T>(under, follows ? past.residual.begin : nullptr, T(share), after.own.begin, skin, coarse, follows ? 1 : effort.settle,
              after.residual.begin, off, scratch);
  if (scratch.overflowed) return {};
  __builtin_memcpy(after.network.begin, under, size_t(3 * below) * sizeof(T));
  for (int64_t block = 0; block < places / LANES; ++block)
    put_points(x + 3 * LANES * block, carried(points_in(x + 3 * LANES * block), off, fine, block));
  lift_off<T>(x, after.own.begin, skin, around.colliders, fine, T(effort.clearance_m), planes, lifted);
  FoldOutcome outcome = {!follows, 0, 0, 0, 0, 0, 0};
  delivered(x, lifted, fine.sheet.place, lifted_vertices, outcome);
  scratch.used = mark;
  return outcome;
}
