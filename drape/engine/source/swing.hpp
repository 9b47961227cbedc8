// One frame of swing: the network's drape of a still body in, cloth with inertia out.
//
// Cloth that hangs freely is a coarse mesh of nodes with their mass. A node goes on where it went,
//
//     c' = c0 + h v,
//
// air slows v along the surface's normal, and the fabric damps it. Weight then pulls the node back to where still cloth
// would be, and the length of the cloth holds it (swing_nodes.hpp), both by implicit Euler. The vertices move and turn
// as the nodes do beside the still cloth (swing_carry.hpp), so that on a still body all comes to rest at the network's
// drape. A node that the network has near the skin is held there; in a wide skirt hardly.
//
// Colliders of the scene hold nodes too. Cloth that lies on one comes to rest there, and a frame without a past begins
// where it rests.
#pragma once
#include "folds.hpp"
#include "swing_carry.hpp"
#include "swing_nodes.hpp"

namespace swing {

constexpr double NEAR_SKIN_M = 0.008, FREE_M = 0.04;  // over the skin: lower nodes are held, higher ones free
constexpr double HOLD_N_PER_M = 2.0, LEAST_FREE = 0.01;  // the hold of a half free node; the least a node is free
constexpr int ROUNDS = 20, SWEEPS = 6;  // of conjugate gradients, and of sweeps there and back for length
constexpr double AIR_KG_M3 = 0.72;      // half of air's density times the drag of a plate across
// A body that stands still for longer slows its cloth more and more, but not so much that it creeps.
constexpr double CALM_S = 0.2, CALMER_PER_S2 = 20.0, CALMEST_PER_S = 10.0;
constexpr double STILL_S = 1.8;         // after which nothing swings
constexpr double LOST_M = 1.0;          // a node farther from still cloth does not swing any more
constexpr double LEAST_SWUNG_M = 1e-6;  // a node nearer to it only rounds
constexpr double LYING_M = 0.008, STUCK_N_PER_M = 2.0;  // a node nearer to a collider lies on it, and is held there
constexpr double GRAVITY_M_S2 = 9.81, HEAVIEST = 2.0, SLACK_M = 0.02;
constexpr double LONGEST_STEP_S = 0.04;  // a slower frame takes several steps: longer ones damp what swings
constexpr int SETTLE = 60;              // steps of a frame without a past whose cloth is in a collider
constexpr double PAUSE_S = 0.25, SHORTEST_STEP_S = 1.0 / 240.0;  // a later frame has no past; closer ones count as this

// What has become of a frame.
enum Kind : int64_t { CUT, LOST, STILL, MOVED };

template <class T> struct Schedule {
  T step_s, damping, young, weight;  // weight: in parts of that of cloth at rest
  bool first;
};

// Returns the unit normal of the coarse triangles around node i, zeros where they have no area.
template <class T> INLINE Vector<T> normal_at(const T* c, int64_t i, const SwingMesh<T>& mesh) {
  Vector<T> total = {};
  const Vector<T> own = point(c, i);
  for (int64_t e = mesh.start[i]; e < mesh.start[i + 1]; ++e)
    total = total + cross(point(c, mesh.other[2 * e]) - own, point(c, mesh.other[2 * e + 1]) - own);
  const T square = dot(total, total);
  return square > 0 ? scaled(T(1) / root(square), total) : total;
}

// Returns how stiffly [N/m] a node is held where the network has it.
template <class T> INLINE T hold_of(Vector<T> at, const T* sample, T held) {
  const Vector<T> off = at - point(sample, 0);
  T height = dot(off, point(sample + 4, 0));
  if (dot(off, off) > T(TOUCH_M * TOUCH_M)) height = T(FREE_M);  // above another part of the body than the sample's
  const T share = less<T>(more<T>((height - T(NEAR_SKIN_M)) / T(FREE_M - NEAR_SKIN_M), T(0)), T(1));
  const T free = share * share * (T(3) - share - share);
  return held * T(HOLD_N_PER_M) * (T(1) - free) / more<T>(free, T(LEAST_FREE));
}

template <class T> struct State { const T *network, *swung, *speed; };  // the frame before, (N, 3) each

// Writes the swung nodes [m] (N, 3) and their speed [m/s] (N, 3). touched (N,) are the samples below still cloth.
template <class T>
DEVICE void advance(const State<T>& before, const T* network, const Skin<T>& skin, const Array<double>& colliders,
             const int32_t* touched, const SwingConstants<T>& cloth, const Schedule<T>& schedule, T* swung, T* speed,
             Scratch& scratch) {
  const SwingMesh<T>& mesh = cloth.mesh;
  const SwingRows<T>& rows = mesh.rows;
  const int64_t mark = scratch.used, nodes = mesh.vertex.count, places = rows.node.count;
  T *held = scratch.take<T>(nodes), *inertia = scratch.take<T>(nodes), *deep = scratch.take<T>(nodes);
  T *u = scratch.take<T>(3 * nodes), *rhs = scratch.take<T>(3 * nodes), *x = scratch.take<T>(3 * places);
  T *planes = scratch.take<T>(8 * nodes), *laid = scratch.take<T>(HELD * rows.moving);
  T* bound = scratch.take<T>(6 * LANES * rows.start[rows.moving]);
  int32_t* here = scratch.take<int32_t>(nodes);
  if (scratch.overflowed) return;
  const T h = schedule.step_s;
  write_node_planes(before.swung, before.swung, nodes, schedule.first, colliders, skin.samples, touched, planes);
  for (int64_t i : each(nodes)) {
    held[i] = hold_of<T>(point(network, i), skin.samples + 8 * int64_t(touched[i]), cloth.held[i]);
    inertia[i] = deep[i] = 0;
    put_point(u, i, Vector<T>{}), put_point(rhs, i, Vector<T>{}), put_point(swung, i, point(network, i));
  }
  for (int64_t n : each(mesh.order.count)) {
    const int64_t i = mesh.order[n];
    const Vector<T> was = point(before.swung, i), still = point(network, i);
    Vector<T> v = scaled(T(1) / (T(1) + h * schedule.damping), point(before.speed, i));
    const Vector<T> across = normal_at(before.swung, i, mesh);
    const T wind = dot(v, across), strength = wind < 0 ? -wind : wind;
    const T slow = T(AIR_KG_M3) * mesh.area_m2[i] / mesh.mass_kg[i] * strength * h;
    v = plus(v, -(wind * slow / (T(1) + slow)), across);
    inertia[i] = mesh.mass_kg[i] / (h * h);
    put_point(u, i, was - point(before.network, i));
    put_point(rhs, i, scaled(inertia[i], plus(was, h, v) - still));
    // The node lies on the first of its planes, beyond which the network has it.
    const Vector<T> normal = point(planes + 8 * i, 0);
    const T where_ = planes[8 * i + 3];
    if (dot(normal, was) - where_ < T(LYING_M) && dot(normal, still) < where_) {
      held[i] += T(STUCK_N_PER_M);
      put_point(rhs, i, scaled(inertia[i] + T(STUCK_N_PER_M), was - still));
    }
    const T* sample = skin.samples + 8 * int64_t(touched[i]);
    deep[i] = more<T>(T(GAP_M) - dot(still - point(sample, 0), point(sample + 4, 0)), T(0));
  }
  fall_back(u, mesh, inertia, held, schedule.weight, rhs, ROUNDS, scratch);
  for (int64_t i : each(nodes)) {
    put_point(swung, i, point(swung, i) + point(u, i));
    inertia[i] += held[i];
    here[i] = touched[i];
  }
  at_places(network, rows, x);
  write_bounds(x, rows, bound);
  follow(swung, nodes, skin, here);
  for (int64_t i : each(nodes)) {
    // Cloth that lies near a part of the body while it is still stays on its side of that, however far it swings.
    const Vector<T> off = point(network, i) - skin.point_of(touched[i]);
    if (dot(off, off) < T(TOUCH_M * TOUCH_M)) here[i] = touched[i];
  }
  write_node_planes(swung, before.swung, nodes, schedule.first, colliders, skin.samples, touched, planes);
  const bool beside = lay_held(swung, inertia, {skin.samples, touched, here, deep, planes}, mesh, laid);
  at_places(swung, rows, x);
  keep_length(swung, x, rows, schedule.young, bound, laid, beside, SWEEPS);
  for (int64_t i : each(nodes)) put_point(speed, i, scaled(T(1) / h, point(swung, i) - point(before.swung, i)));
  scratch.used = mark;
}

// Lets weight take hanging cloth along with a body that goes down, so that none is left behind in the air: its speed
// [m/s] (N, 3) changes by as much as that of still cloth does, by gravity's at most. A body that goes up takes along
// taut cloth, which is swung [m] (N, 3) and beside it no higher than SLACK_M. Cloth without a past moves as still
// cloth, from before to network [m] (N, 3) in step_s [s]. climb [m/s] (N,) is how fast still cloth went up in the frame
// before, NaN without one, and is replaced. Returns the weight that is left, as a share of that at rest.
template <class T>
DEVICE T fall_along(const T* before, const T* network, const T* swung, T step_s, int64_t nodes, T* climb, T* speed, T* room) {
  const T gained = sum_in_order(nodes, room, [&](int64_t i) {
    const Vector<T> pace = scaled(T(1) / step_s, point(network, i) - point(before, i));
    const T gain = pace.y - climb[i];
    if (gain == gain) {
      const T risen = swung[3 * i + 1] - network[3 * i + 1];
      const T taut = less<T>(more<T>(T(1) - risen / T(SLACK_M), T(0)), T(1));
      speed[3 * i + 1] += gain > 0 ? taut * gain : more<T>(gain, T(-GRAVITY_M_S2) * step_s);
    } else {
      put_point(speed, i, pace);
    }
    climb[i] = pace.y;
    return gain == gain ? gain : T(0);
  });
  const T weight = T(1) + gained / (T(nodes) * T(GRAVITY_M_S2) * step_s);
  return less<T>(more<T>(weight, T(0)), T(HEAVIEST));
}

// Returns whether two tables have the same numbers.
template <class N> DEVICE bool is_same(const N* one, int64_t count, const N* other, int64_t other_count) {
  if (count != other_count) return false;
  int differs = 0;
  for (int64_t i : each(count)) differs |= int(!(one[i] == other[i]));
  return !most_of_all(differs);
}

template <class T> DEVICE T farthest_node_m(const T* x, const T* y, int64_t nodes) {
  T square = 0;
  for (int64_t i : each(nodes)) {
    const Vector<T> way = point(x, i) - point(y, i);
    if (square == square && !(dot(way, way) <= square)) square = dot(way, way);  // NaN, once met, stays
  }
  return root(most_of_all(square));
}

// Moves the vertices [m] (V, 3) by a share of the way and turn of the nodes that swung; returns the kind of frame that
// it is.
template <class T>
DEVICE Kind carry(const T* vertices, int64_t count, const T* network, const T* swung, const SwingMesh<T>& mesh, T share,
           T* out, Scratch& scratch) {
  const T far = farthest_node_m(swung, network, mesh.vertex.count);
  if (!(far <= T(LOST_M))) return LOST;
  if (far < T(LEAST_SWUNG_M)) return STILL;
  move_vertices(vertices, count, network, swung, mesh, share, out, scratch);
  return MOVED;
}

// Moves the nodes on from the frame before: writes to after the nodes, their speed, samples and since when nothing
// moved, and to out the vertices [m] (V, 3). Returns CUT where no swing leads from that frame to this one.
template <class T>
DEVICE Kind go_on(const T* vertices, int64_t count, const SwingMemory<T>& past, const Skin<T>& skin,
           const Array<double>& colliders, const SwingConstants<T>& cloth, T share, SwingMemory<T>& after, T* out,
           Scratch& scratch) {
  const int64_t mark = scratch.used, nodes = cloth.mesh.vertex.count;
  const T* network = after.network;
  T *swung = after.swung, *speed = after.speed, *climb = after.climb, *start = scratch.take<T>(3 * nodes);
  T *before = scratch.take<T>(3 * nodes), *pace = scratch.take<T>(3 * nodes);
  const double since_s = after.time_s - past.time_s;
  if (scratch.overflowed || !(since_s > 0 && since_s <= PAUSE_S)) return CUT;
  if (!(farthest_node_m<T>(network, past.network, nodes) <= T(CUT_M))) return CUT;
  double shift[3];
  bool moved = !is_same(network, 3 * nodes, past.network.begin, past.network.count) ||
               !is_same(colliders.begin, colliders.count, past.colliders.begin, past.colliders.count);
  for (int axis = 0; axis < 3; ++axis) {
    shift[axis] = after.origin[axis] - past.origin[axis];
    moved |= shift[axis] != 0;
  }
  const double since = moved ? after.time_s : past.still_since_s[0];
  if (is_first_thread()) after.still_since_s[0] = since;
  const double still_s = after.time_s - since;
  for (int64_t i : each(nodes)) after.touched[i] = past.touched[i];
  if (!moved && still_s >= STILL_S) {
    const T* rests = colliders.count ? past.swung.begin : network;
    for (int64_t i : each(3 * nodes)) swung[i] = rests[i], speed[i] = 0;
    for (int64_t i : each(nodes)) climb[i] = 0;
  } else {
    const double calming = smaller(CALMER_PER_S2 * larger(still_s - CALM_S, 0), CALMEST_PER_S);
    const T step_s = T(larger(since_s, SHORTEST_STEP_S));
    follow(network, nodes, skin, after.touched.begin);
    for (int64_t i : each(3 * nodes)) {
      before[i] = past.network[i] - T(shift[i % 3]), speed[i] = past.speed[i];
      swung[i] = past.swung[i] - past.network[i] + network[i];
      if (i < nodes) climb[i] = past.climb[i];
    }
    const T weight = fall_along<T>(before, network, swung, step_s, nodes, climb, speed, start);
    const int64_t steps = colliders.count ? 1 : int64_t(1.0 + double(step_s) / LONGEST_STEP_S);
    for (int64_t i : each(3 * nodes)) before[i] = network[i] - (network[i] - before[i]) / T(steps);
    for (int64_t step = 0; step < steps && !scratch.overflowed; ++step) {
      // Still cloth is at its new place already; nodes come from where it was a step before.
      for (int64_t i : each(3 * nodes)) start[i] = swung[i] - network[i] + before[i], pace[i] = speed[i];
      advance<T>({before, start, pace}, network, skin, colliders, after.touched, cloth,
                 {step_s / T(steps), T(cloth.damping_per_s + calming), T(cloth.young_n_per_m), weight, false}, swung,
                 speed, scratch);
    }
  }
  scratch.used = mark;
  return carry(vertices, count, network, swung, cloth.mesh, share, out, scratch);
}

// Lets cloth that hangs still and is in a collider come to rest on it: writes the nodes of after.
template <class T>
DEVICE void come_to_rest(const Skin<T>& skin, const Array<double>& colliders, const SwingConstants<T>& cloth,
                  SwingMemory<T>& after, Scratch& scratch) {
  const int64_t mark = scratch.used, nodes = cloth.mesh.vertex.count;
  const T* network = after.network;
  T *swung = after.swung, *speed = after.speed, *planes = scratch.take<T>(8 * nodes);
  T *start = scratch.take<T>(3 * nodes), *pace = scratch.take<T>(3 * nodes);
  if (scratch.overflowed) return;
  if (write_node_planes(network, network, nodes, true, colliders, skin.samples, after.touched.begin, planes)) {
    for (int step = 0; step < SETTLE && !scratch.overflowed; ++step) {
      for (int64_t i : each(3 * nodes)) start[i] = swung[i], pace[i] = speed[i];
      advance<T>({network, start, pace}, network, skin, colliders, after.touched, cloth,
                 {T(FIRST_STEP_S), T(cloth.damping_per_s + CALMEST_PER_S), T(cloth.young_n_per_m), T(1), true}, swung, speed,
                 scratch);
    }
    for (int64_t i : each(3 * nodes)) speed[i] = 0;
  }
  scratch.used = mark;
}

// Writes the vertices [m] (V, 3) of a frame with a share of their swing, and the memory for the next frame: its time,
// origin and colliders are the frame's, from the caller. past.origin and after.origin are those of the coordinates in
// the world. Without a past, and where no swing leads to a frame, cloth hangs still. Returns whether the vertices were
// written; where not, the frame's own stay.
template <class T>
DEVICE bool frame(const T* vertices, int64_t count, const SwingMemory<T>& past, const Surroundings<T>& around,
           const SwingConstants<T>& cloth, T share, SwingMemory<T>& after, T* out, Scratch& scratch) {
  const Skin<T> skin = skin_of(around.skin, cloth.graph);
  const int64_t nodes = cloth.mesh.vertex.count;
  T *network = after.network, *swung = after.swung, *speed = after.speed;
  for (int64_t i : each(nodes)) put_point(network, i, point(vertices, cloth.mesh.vertex[i]));
  Kind kind = go_on(vertices, count, past, skin, around.colliders, cloth, share, after, out, scratch);
  if (kind >= STILL) return kind == MOVED;
  for (int64_t i : each(nodes)) {
    after.touched[i] = cloth.index[i];
    after.climb[i] = T(__builtin_nan(""));  // not known
    put_point(swung, i, point(network, i)), put_point(speed, i, Vector<T>{});
  }
  follow(network, nodes, skin, after.touched.begin);
  if (is_first_thread()) after.still_since_s[0] = after.time_s;
  if (kind == LOST) return false;
  come_to_rest(skin, around.colliders, cloth, after, scratch);
  kind = carry(vertices, count, network, swung, cloth.mesh, share, out, scratch);
  if (kind == LOST)
    for (int64_t i : each(3 * nodes)) swung[i] = network[i];
  return kind == MOVED;
}

}  // namespace swing
