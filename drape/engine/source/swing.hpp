// One frame of swing: the network's drape of a still body in, cloth with inertia out.
//
// Cloth that hangs freely is a coarse mesh of nodes with their mass. A node goes on where it went,
//
//     c' = c0 + h v,
//
// air slows v along the surface's normal, and the fabric damps it. Weight then pulls the node back to where still cloth
// would be, and the length of the cloth holds it, both by implicit Euler. The vertices move and turn as the nodes do
// beside the still cloth (swing_carry.hpp), so that on a still body all comes to rest at the network's drape. A node that
// the network has near the skin is held there; in a wide skirt hardly. Colliders of the scene hold nodes too. Cloth that
// lies on one comes to rest there, and a frame without a past begins where it rests.
//
// Falling back. Every column of hanging cloth is a string. With T the weight below, s the way down and u how far the
// nodes are from where still cloth would be,
//
//     m (u - u') / h^2 + K u = 0,   u K u = sum of A T |du/ds|^2,
//
// u' where inertia leads. The rows of K are the mesh's pull.
//
// Length. Cloth does not stretch, and it keeps its area. With G Green's strain of a coarse triangle, G0 that of the still
// cloth, and ( )+ and ( )- the parts of a matrix that have its positive and its negative principal values, the energy per
// area is
//
//     Y/2 |(G - G0+)+|^2 + q Y/2 |(G - G0-)-|^2,   q = COMPRESSED.
//
// Between still cloth, whose folds are finer than the mesh, and flat cloth a triangle is free (tension field theory).
// Where it became shorter than it is in still cloth, folds would have to hide what it lacks, and they are too fine for
// that. Y is the cloth's stiffness, but no more than a few sweeps can follow.
#pragma once
#include "colliders.hpp"
#include "folds.hpp"
#include "swing_carry.hpp"

namespace swing {

constexpr double NEAR_SKIN_M = 0.008, FREE_M = 0.04;  // over the skin: lower nodes are held, higher ones free
constexpr double HOLD_N_PER_M = 2.0, LEAST_FREE = 0.01;  // the hold of a half free node; the least that a node is free
constexpr int ROUNDS = 20, SWEEPS = 6;  // of conjugate gradients, and of sweeps there and back for length
constexpr double AIR_KG_M3 = 0.72;      // half of air's density times the drag of a plate across
// A body that stands still for longer slows its cloth more and more, but not so much that it creeps.
constexpr double CALM_S = 0.2, CALMER_PER_S2 = 20.0, CALMEST_PER_S = 10.0;
constexpr double STILL_S = 1.8;   // after which nothing swings
constexpr double LOST_M = 1.0;    // a node farther from still cloth does not swing any more
constexpr double LEAST_SWUNG_M = 1e-6;  // a node nearer to it only rounds
constexpr double LYING_M = 0.008, STUCK_N_PER_M = 2.0;  // a node lies on a collider that is nearer, and is held where it lay
constexpr int SETTLE = 60;  // steps of a frame without a past whose cloth is in a collider
constexpr double PAUSE_S = 0.25, SHORTEST_STEP_S = 1.0 / 240.0;  // a later frame has no past; closer ones count as this
constexpr double CONTACT_J_M4 = 3.0e4;  // a tenth of the folds': half a spacing of skin is behind a node
constexpr double GAP_M = 0.004;
constexpr double TOUCH_M = 0.06;        // a sample farther away says nothing of the skin below a node
constexpr double SWEEP_M = 0.01;        // a sweep moves no node farther
constexpr double LEAST_SQUARE = 1e-30;  // a residual's square that is small enough by itself [N m]
constexpr double COMPRESSED = 0.2;
constexpr double LEAST_STRAIN = 1e-9;   // a difference of principal strains that says nothing of their axes
constexpr double LOOSE = 0.05;  // a loose triangle resists a step with this share of the stiffness of one that pulls

// What has become of a frame.
enum Kind : int64_t { CUT, LOST, STILL, MOVED };

template <class T> struct Schedule {
  T step_s, damping, young;
  bool first;
};

// The (inertia + hold + K) u [N] of the nodes that may move.
template <class T> void pulled(const T* u, const SwingMesh<T>& mesh, const T* inertia, const T* hold, T* out) {
  for (int64_t n = 0; n < mesh.order.count; ++n) {
    const int64_t i = mesh.order[n];
    Vector<T> total = scaled(inertia[i] + hold[i], point(u, i));
    for (int64_t e = mesh.pull_start[i]; e < mesh.pull_start[i + 1]; ++e)
      total = plus(total, mesh.pull[e], point(u, mesh.pull_node[e]));
    put_point(out, i, total);
  }
}

// Moves u [m] (N, 3) towards the solution of (inertia + hold + K) u = rhs [N] over the nodes that may move, by rounds of
// conjugate gradients, in place; inertia and hold [N/m] (N,).
template <class T>
void fall_back(T* u, int64_t nodes, const SwingMesh<T>& mesh, const T* inertia, const T* hold, const T* rhs, Scratch& scratch) {
  const int64_t mark = scratch.used, count = mesh.order.count;
  T *r = scratch.take<T>(3 * nodes), *q = scratch.take<T>(3 * nodes), *p = scratch.take<T>(3 * nodes);
  T* diagonal = scratch.take<T>(nodes);
  if (scratch.overflowed) return;
  for (int64_t i = 0; i < nodes; ++i) {
    put_point(r, i, Vector<T>{}), put_point(q, i, Vector<T>{}), put_point(p, i, Vector<T>{});
    diagonal[i] = 0;
  }
  for (int64_t n = 0; n < count; ++n) {
    const int64_t i = mesh.order[n];
    diagonal[i] = inertia[i] + hold[i];
    for (int64_t e = mesh.pull_start[i]; e < mesh.pull_start[i + 1]; ++e)
      if (mesh.pull_node[e] == i) diagonal[i] += mesh.pull[e];
  }
  pulled(u, mesh, inertia, hold, q);
  T old = 0;
  for (int64_t n = 0; n < count; ++n) {
    const int64_t i = mesh.order[n];
    const Vector<T> left = point(rhs, i) - point(q, i), way = scaled(T(1) / diagonal[i], left);
    put_point(r, i, left), put_point(p, i, way);
    old += dot(left, way);
  }
  if (old != old)
    for (int64_t i = 0; i < 3 * nodes; ++i) u[i] = old;  // NaN, which the caller looks for
  // Nothing is won beyond what floats can tell of the first residual, and squares of what is left would go under.
  const T eps = sizeof(T) == 4 ? T(1.1920929e-07) : T(2.220446049250313e-16);
  const T end = more<T>(eps * eps * old, T(LEAST_SQUARE));
  for (int round = 0; round < ROUNDS && old > end; ++round) {
    pulled(p, mesh, inertia, hold, q);
    T down = 0, next = 0;
    for (int64_t n = 0; n < count; ++n) down += dot(point(p, mesh.order[n]), point(q, mesh.order[n]));
    const T a = old / down;
    for (int64_t n = 0; n < count; ++n) {
      const int64_t i = mesh.order[n];
      put_point(u, i, plus(point(u, i), a, point(p, i)));
      const Vector<T> left = plus(point(r, i), -a, point(q, i));
      put_point(r, i, left);
      next += dot(left, left) / diagonal[i];
    }
    const T b = next / old;
    old = next;
    for (int64_t n = 0; n < count; ++n) {
      const int64_t i = mesh.order[n];
      put_point(p, i, mix(T(1) / diagonal[i], point(r, i), b, point(p, i)));
    }
  }
  scratch.used = mark;
}

template <class N> struct Strain { N pp, tt, pt; };

// Green's strain of a triangle.
template <class T> INLINE Strain<Row<T>> strain(Columns<Row<T>> f) {
  return {T(0.5) * (dot(f.p, f.p) - T(1)), T(0.5) * (dot(f.t, f.t) - T(1)), T(0.5) * dot(f.p, f.t)};
}

// A symmetric matrix as mean of its principal values, half of their difference, and that times the cosine and the sine of
// twice the angle of the first one's axis.
template <class T> struct Principal { Row<T> mean, half, cosine, sine; };
template <class T> INLINE Principal<T> principal(Strain<Row<T>> g) {
  Row<T> off = T(0.5) * (g.pp - g.tt);
  return {T(0.5) * (g.pp + g.tt), root<T>(off * off + g.pt * g.pt), off, g.pt};
}

// Mean and half difference of the principal values of the positive part.
template <class T> struct Positive { Row<T> mean, half; };
template <class T> INLINE Positive<T> positive(const Principal<T>& g) {
  const Row<T> zero = row_of(T(0));
  Row<T> high = most<T>(g.mean + g.half, zero), low = most<T>(g.mean - g.half, zero);
  return {T(0.5) * (high + low), T(0.5) * (high - low)};
}

template <class T> struct Slopes { Row<T> p1, p2, t1, t2; };
template <class T> INLINE Slopes<T> slopes_of(const SwingRows<T>& rows, int64_t row) {
  const T* s = rows.slope + 5 * LANES * row;
  return {row_at(s), row_at(s + LANES), row_at(s + 2 * LANES), row_at(s + 3 * LANES)};
}
template <class T>
INLINE Columns<Row<T>> columns_of(const T* x, Points<T> own, const SwingRows<T>& rows, int64_t row, const Slopes<T>& s) {
  const int32_t* other = rows.other + 2 * LANES * row;
  return columns(points_at(x, other) - own, points_at(x, other + LANES) - own, s.p1, s.p2, s.t1, s.t2);
}

// Writes G+ and G- (pp, tt, pt each) of the triangles of all nodes that move, which are at x [m] (P, 3), six rows each.
template <class T> void write_bounds(const T* x, const SwingRows<T>& rows, T* bound) {
  for (int64_t block = 0; block < rows.moving; ++block) {
    Points<T> own = points_in(x + 3 * LANES * block);
    for (int64_t row = rows.start[block]; row < rows.start[block + 1]; ++row) {
      Strain<Row<T>> g = strain<T>(columns_of(x, own, rows, row, slopes_of(rows, row)));
      Principal<T> found = principal<T>(g);
      Positive<T> part = positive(found);
      Row<T> share = part.half / most<T>(found.half, row_of(T(LEAST_STRAIN)));
      Points<T> above = {part.mean + share * found.cosine, part.mean - share * found.cosine, share * found.sine};
      put3(bound + 6 * LANES * row, above);
      put3(bound + 6 * LANES * row + 3 * LANES, Points<T>{g.pp, g.tt, g.pt} - above);
    }
  }
}

// Gradient [N] and Hessian [N/m] of the length's energy by the nodes of a block. The Hessian has what a triangle resists
// by along principal axes u that pull, (m . u)^2 F u (F u)^T, and a small share of the rest; m are the slopes of the
// node's corner.
template <class T> INLINE Model<T> length_model(const T* x, int64_t block, const SwingRows<T>& rows, T young, const T* bound) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1)), little = row_of(T(LEAST_STRAIN));
  Points<T> own = points_in(x + 3 * LANES * block), g = {zero, zero, zero};
  Symmetric<Row<T>> h = {zero, zero, zero, zero, zero, zero};
  for (int64_t row = rows.start[block]; row < rows.start[block + 1]; ++row) {
    const Slopes<T> s = slopes_of(rows, row);
    Columns<Row<T>> f = columns_of(x, own, rows, row, s);
    Row<T> mp = -(s.p1 + s.p2), mt = -(s.t1 + s.t2), stiff = young * row_at(rows.slope + 5 * LANES * row + 4 * LANES);
    Strain<Row<T>> e = strain<T>(f);
    Points<T> over = Points<T>{e.pp, e.tt, e.pt} - rows3_at(bound + 6 * LANES * row);
    Points<T> under = rows3_at(bound + 6 * LANES * row + 3 * LANES) - Points<T>{e.pp, e.tt, e.pt};
    Principal<T> high = principal<T>({over.x, over.y, over.z}), low = principal<T>({under.x, under.y, under.z});
    Positive<T> pull = positive(high), push = positive(low);
    // One division for three: 1 / a = b c / (a b c).
    Row<T> a = most<T>(high.half, little), b = most<T>(low.half, little), c = most<T>(push.mean, little);
    Row<T> per = one / (a * b * c);
    // Twice the axis of the first principal value: cosine and sine of twice its angle.
    Row<T> cosine = b * c * per * high.cosine, sine = b * c * per * high.sine;
    Row<T> cp = stiff * (mp * (pull.mean + pull.half * cosine) + mt * pull.half * sine);
    Row<T> ct = stiff * (mp * pull.half * sine + mt * (pull.mean - pull.half * cosine));
    Row<T> full = where<T>(zero > high.half - high.mean, one, row_of(T(LOOSE)));  // both principal values pull
    Row<T> share = full * stiff;
    Row<T> pt = T(0.5) * share * mp * mt, pp = share * (mp * mp + T(0.5) * mt * mt), tt = share * (mt * mt + T(0.5) * mp * mp);
    Row<T> by_p = T(0.5) * (mp + mp * cosine + mt * sine), by_t = T(0.5) * (mp * sine + mt - mt * cosine);
    share = where<T>(pull.mean > zero, stiff - share, zero);
    pp = pp + share * by_p * by_p, pt = pt + share * by_p * by_t, tt = tt + share * by_t * by_t;
    Row<T> steady = most<T>(cp * mp + ct * mt, zero);
    share = T(COMPRESSED) * stiff;
    cosine = push.half * a * c * per * low.cosine, sine = push.half * a * c * per * low.sine;
    cp = cp - share * (mp * (push.mean + cosine) + mt * sine);
    ct = ct - share * (mp * sine + mt * (push.mean - cosine));
    cosine = a * b * per * cosine, sine = a * b * per * sine;
    by_p = T(0.5) * (mp + mp * cosine + mt * sine), by_t = T(0.5) * (mp * sine + mt - mt * cosine);
    share = where<T>(push.mean > zero, share, zero);
    pp = pp + share * by_p * by_p, pt = pt + share * by_p * by_t, tt = tt + share * by_t * by_t;
    g = g + mix(cp, f.p, ct, f.t);
    h = squares(h, pp, pt, tt, f.p, f.t, steady);
  }
  return {g, h};
}

// What holds a block of nodes: target and stiffness of the springs; the sample, the normal there, the gap less how deep
// still cloth is, and the square of the distance from which the sample says nothing; contact's stiffness; and the normal
// and height of two planes.
constexpr int TARGET = 0, SPRING = 3 * LANES, SAMPLE = 4 * LANES, AXIS = 7 * LANES, TOP = 10 * LANES, WITHIN = 11 * LANES;
constexpr int STIFF = 12 * LANES, PLANE = 13 * LANES, HELD = 21 * LANES;

// Moves the nodes c [m] (N, 3) in place by sweeps there and back, each to its own quadratic minimum. x [m] (P, 3) are
// the nodes at their places, held what holds them; beside: whether any has a plane.
template <class T>
void keep_length(T* c, T* x, const SwingRows<T>& rows, T young, const T* bound, const T* held, bool beside) {
  const Row<T> zero = row_of(T(0));
  for (int turn = 0; turn < 2 * SWEEPS; ++turn)
    for (int64_t n = 0; n < rows.moving; ++n) {
      const int64_t block = turn % 2 == 0 ? n : rows.moving - 1 - n;
      const T* own_held = held + HELD * block;
      Points<T> own = points_in(x + 3 * LANES * block);
      Model<T> model = length_model(x, block, rows, young, bound);
      Points<T> g = model.gradient;
      Symmetric<Row<T>> h = model.hessian;
      Row<T> spring = row_at(own_held + SPRING);
      g = plus(g, spring, own - rows3_at(own_held + TARGET));
      h.xx = h.xx + spring, h.yy = h.yy + spring, h.zz = h.zz + spring;
      Points<T> normal = rows3_at(own_held + AXIS), off = own - rows3_at(own_held + SAMPLE);
      Row<T> depth = row_at(own_held + TOP) - dot(off, normal), contact = row_at(own_held + STIFF);
      Row<T> stiff = where<T>(row_at(own_held + WITHIN) > dot(off, off), contact, zero);
      stiff = where<T>(depth > zero, stiff, zero);
      g = plus(g, -stiff * depth, normal);
      h = outer(h, stiff, normal);
      for (int m = 0; beside && m < 2; ++m) {
        normal = rows3_at(own_held + PLANE + 4 * LANES * m);
        depth = row_at(own_held + PLANE + 4 * LANES * m + 3 * LANES) - dot(own, normal);
        stiff = where<T>(depth > zero, contact, zero);
        g = plus(g, -stiff * depth, normal);
        h = outer(h, stiff, normal);
      }
      Points<T> step = solved(h, g);
      Row<T> share = T(SWEEP_M) / root<T>(most<T>(dot(step, step), row_of(T(SWEEP_M * SWEEP_M))));
      put_points(x + 3 * LANES * block, plus(own, -share, step));
    }
  for (int64_t p = 0; p < LANES * rows.moving; ++p) put_point(c, rows.node[p], point(x, p));
}

// The unit normal of the coarse triangles around node i, zeros where they have no area.
template <class T> Vector<T> normal_at(const T* c, int64_t i, const SwingMesh<T>& mesh) {
  Vector<T> total = {};
  const Vector<T> own = point(c, i);
  for (int64_t e = mesh.start[i]; e < mesh.start[i + 1]; ++e)
    total = total + cross(point(c, mesh.other[2 * e]) - own, point(c, mesh.other[2 * e + 1]) - own);
  const T square = dot(total, total);
  return square > 0 ? scaled(T(1) / root(square), total) : total;
}

// How stiffly [N/m] a node is held where the network has it.
template <class T> T hold_of(Vector<T> at, const T* sample, T held) {
  const Vector<T> off = at - point(sample, 0);
  T height = dot(off, point(sample + 4, 0));
  if (dot(off, off) > T(TOUCH_M * TOUCH_M)) height = T(FREE_M);  // above another part of the body than the sample's
  const T share = less<T>(more<T>((height - T(NEAR_SKIN_M)) / T(FREE_M - NEAR_SKIN_M), T(0)), T(1));
  const T free = share * share * (T(3) - share - share);
  return held * T(HOLD_N_PER_M) * (T(1) - free) / more<T>(free, T(LEAST_FREE));
}

template <class T> struct State { const T *network, *swung, *speed; };  // the frame before, (N, 3) each

// Writes the swung nodes [m] (N, 3) and their speed [m/s]; touched (N,) are the samples below still cloth.
template <class T>
void advance(const State<T>& before, const T* network, const Skin<T>& skin, const Array<double>& colliders, const int32_t* touched,
             const SwingConstants<T>& cloth, const Schedule<T>& schedule, T* swung, T* speed, Scratch& scratch) {
  const SwingMesh<T>& mesh = cloth.mesh;
  const int64_t mark = scratch.used, nodes = mesh.vertex.count, places = mesh.rows.node.count, moving = mesh.rows.moving;
  T *held = scratch.take<T>(nodes), *inertia = scratch.take<T>(nodes), *deep = scratch.take<T>(nodes), *planes = scratch.take<T>(8 * nodes);
  T *u = scratch.take<T>(3 * nodes), *rhs = scratch.take<T>(3 * nodes), *x = scratch.take<T>(3 * places);
  T *bound = scratch.take<T>(6 * LANES * mesh.rows.start[moving]), *laid = scratch.take<T>(HELD * moving);
  int32_t* here = scratch.take<int32_t>(nodes);
  if (scratch.overflowed) return;
  const T h = schedule.step_s;
  write_node_planes(before.swung, before.swung, nodes, schedule.first, colliders, skin.samples, touched, planes);
  for (int64_t i = 0; i < nodes; ++i) {
    held[i] = hold_of<T>(point(network, i), skin.samples + 8 * int64_t(touched[i]), cloth.held[i]);
    inertia[i] = deep[i] = 0;
    put_point(u, i, Vector<T>{}), put_point(rhs, i, Vector<T>{}), put_point(swung, i, point(network, i));
  }
  for (int64_t n = 0; n < mesh.order.count; ++n) {
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
    // It lies on the first of its planes, beyond which the network has it.
    const Vector<T> normal = point(planes + 8 * i, 0);
    const T where_ = planes[8 * i + 3];
    if (dot(normal, was) - where_ < T(LYING_M) && dot(normal, still) < where_) {
      held[i] += T(STUCK_N_PER_M);
      put_point(rhs, i, scaled(inertia[i] + T(STUCK_N_PER_M), was - still));
    }
    const T* sample = skin.samples + 8 * int64_t(touched[i]);
    deep[i] = more<T>(T(GAP_M) - dot(still - point(sample, 0), point(sample + 4, 0)), T(0));
  }
  fall_back(u, nodes, mesh, inertia, held, rhs, scratch);
  for (int64_t i = 0; i < nodes; ++i) {
    put_point(swung, i, point(swung, i) + point(u, i));
    inertia[i] += held[i];
    here[i] = touched[i];
  }
  for (int64_t p = 0; p < places; ++p) put_point(x, p, point(network, mesh.rows.node[p]));
  write_bounds(x, mesh.rows, bound);
  follow(swung, nodes, skin, here);
  for (int64_t i = 0; i < nodes; ++i) {
    // Still cloth that lies near a part of the body stays on its side of that, however far it swings.
    const Vector<T> off = point(network, i) - skin.point_of(touched[i]);
    if (dot(off, off) < T(TOUCH_M * TOUCH_M)) here[i] = touched[i];
  }
  write_node_planes(swung, before.swung, nodes, schedule.first, colliders, skin.samples, touched, planes);
  bool beside = false;
  for (int64_t p = 0; p < places; ++p) put_point(x, p, point(swung, mesh.rows.node[p]));
  for (int64_t p = 0; p < LANES * moving; ++p) {
    const int64_t i = mesh.rows.node[p];
    T* to = laid + HELD * (p / LANES);
    const int lane = int(p % LANES);
    put_lane3(to + TARGET, lane, point(swung, i));
    put_lane3(to + SAMPLE, lane, skin.point_of(here[i]));
    put_lane3(to + AXIS, lane, skin.normal_of(here[i]));
    to[SPRING + lane] = inertia[i];
    to[TOP + lane] = T(GAP_M) - deep[i];
    to[WITHIN + lane] = here[i] == touched[i] ? T(__builtin_inf()) : T(TOUCH_M * TOUCH_M);
    to[STIFF + lane] = T(2.0 * CONTACT_J_M4) * mesh.area_m2[i];
    for (int m = 0; m < 2; ++m) {
      const T* plane = planes + 8 * i + 4 * m;
      const bool there = dot(point(plane, 0), point(plane, 0)) > 0;
      beside |= there;
      put_lane3(to + PLANE + 4 * LANES * m, lane, point(plane, 0));
      to[PLANE + 4 * LANES * m + 3 * LANES + lane] = there ? T(GAP_M) + plane[3] : T(-1);
    }
  }
  keep_length(swung, x, mesh.rows, schedule.young, bound, laid, beside);
  for (int64_t i = 0; i < nodes; ++i) put_point(speed, i, scaled(T(1) / h, point(swung, i) - point(before.swung, i)));
  scratch.used = mark;
}

// Whether two tables have the same numbers.
template <class N> bool is_same(const N* one, int64_t count, const N* other, int64_t other_count) {
  if (count != other_count) return false;
  for (int64_t i = 0; i < count; ++i)
    if (!(one[i] == other[i])) return false;
  return true;
}

template <class T> T farthest_node_m(const T* x, const T* y, int64_t nodes) {
  T square = 0;
  for (int64_t i = 0; i < nodes; ++i) {
    const Vector<T> way = point(x, i) - point(y, i);
    if (square == square && !(dot(way, way) <= square)) square = dot(way, way);  // NaN, once met, stays
  }
  return root(square);
}

// Moves the vertices [m] (V, 3) by a share of the way and turn of nodes that swung; what has become of them.
template <class T>
Kind carry(const T* vertices, int64_t count, const T* network, const T* swung, const SwingMesh<T>& mesh, T share, T* out, Scratch& scratch) {
  const T far = farthest_node_m(swung, network, mesh.vertex.count);
  if (!(far <= T(LOST_M))) return LOST;
  if (far < T(LEAST_SWUNG_M)) return STILL;
  move_vertices(vertices, count, network, swung, mesh, share, out, scratch);
  return MOVED;
}

// Writes the vertices [m] (V, 3) of a frame with a share of their swing, and the memory for the next frame: its time and
// origin are the frame's, and its colliders are written by the caller. past.origin and after.origin are those of the
// coordinates in the world. Without a past, and where no swing leads to a frame, cloth hangs still. Returns whether the
// vertices were written; where not, the frame's own stay.
template <class T>
bool frame(const T* vertices, int64_t count, const SwingMemory<T>& past, const Surroundings<T>& around, const SwingConstants<T>& cloth,
           T share, SwingMemory<T>& after, T* out, Scratch& scratch) {
  const SwingMesh<T>& mesh = cloth.mesh;
  const Skin<T> skin = skin_of(around.skin, cloth.graph);
  const int64_t mark = scratch.used, nodes = mesh.vertex.count;
  T *network = after.network, *swung = after.swung, *speed = after.speed, *start = scratch.take<T>(3 * nodes);
  if (scratch.overflowed) return false;
  for (int64_t i = 0; i < nodes; ++i) put_point(network, i, point(vertices, mesh.vertex[i]));
  const double since = after.time_s - past.time_s;
  Kind kind = CUT;
  if (since > 0 && since <= PAUSE_S && farthest_node_m<T>(network, past.network, nodes) <= T(CUT_M)) {
    double shift[3];
    bool moved = !is_same(network, 3 * nodes, past.network.begin, past.network.count) ||
                 !is_same(around.colliders.begin, around.colliders.count, past.colliders.begin, past.colliders.count);
    for (int axis = 0; axis < 3; ++axis) {
      shift[axis] = after.origin[axis] - past.origin[axis];
      moved |= shift[axis] != 0;
    }
    after.still_since_s = moved ? after.time_s : past.still_since_s;
    const double still_s = after.time_s - after.still_since_s;
    for (int64_t i = 0; i < nodes; ++i) after.touched[i] = past.touched[i];
    if (!moved && still_s >= STILL_S) {
      for (int64_t i = 0; i < 3 * nodes; ++i) swung[i] = around.colliders.count ? past.swung[i] : network[i], speed[i] = 0;
    } else {
      const double damping = cloth.damping_per_s + smaller(CALMER_PER_S2 * larger(still_s - CALM_S, 0), CALMEST_PER_S);
      follow(network, nodes, skin, after.touched.begin);
      for (int64_t i = 0; i < nodes; ++i)
        for (int axis = 0; axis < 3; ++axis) start[3 * i + axis] = past.swung[3 * i + axis] - T(shift[axis]);
      const Schedule<T> schedule = {T(larger(since, SHORTEST_STEP_S)), T(damping), T(cloth.young_n_per_m), false};
      advance<T>({past.network, start, past.speed}, network, skin, around.colliders, after.touched, cloth, schedule, swung, speed, scratch);
    }
    kind = carry(vertices, count, network, swung, mesh, share, out, scratch);
    scratch.used = mark;
    if (kind >= STILL) return kind == MOVED;
  }
  for (int64_t i = 0; i < nodes; ++i) {
    after.touched[i] = cloth.index[i];
    put_point(swung, i, point(network, i)), put_point(speed, i, Vector<T>{});
  }
  follow(network, nodes, skin, after.touched.begin);
  after.still_since_s = after.time_s;
  if (kind == LOST) return false;
  // Cloth that is in a collider comes to rest on it.
  T *planes = scratch.take<T>(8 * nodes), *other = scratch.take<T>(3 * nodes), *pace = scratch.take<T>(3 * nodes);
  if (scratch.overflowed) return false;
  if (write_node_planes(network, network, nodes, true, around.colliders, skin.samples, after.touched.begin, planes)) {
    const Schedule<T> schedule = {T(FIRST_STEP_S), T(cloth.damping_per_s + CALMEST_PER_S), T(cloth.young_n_per_m), true};
    for (int64_t i = 0; i < 3 * nodes; ++i) start[i] = network[i], pace[i] = 0;
    for (int step = 0; step < SETTLE; ++step) {
      advance<T>({network, start, pace}, network, skin, around.colliders, after.touched, cloth, schedule, other, speed, scratch);
      for (int64_t i = 0; i < 3 * nodes; ++i) start[i] = other[i], pace[i] = speed[i];
    }
    for (int64_t i = 0; i < 3 * nodes; ++i) swung[i] = start[i], speed[i] = 0;
  }
  kind = carry(vertices, count, network, swung, mesh, share, out, scratch);
  if (kind == LOST)
    for (int64_t i = 0; i < 3 * nodes; ++i) swung[i] = network[i];
  scratch.used = mark;
  return kind == MOVED;
}

}  // namespace swing
