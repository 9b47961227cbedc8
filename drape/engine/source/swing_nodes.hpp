// The equations of a swing mesh: nodes that fall back, and cloth that keeps its length.
//
// Falling back. Every column of hanging cloth is a string. With T the weight below, s the way down and u how far the
// nodes are from where still cloth would be,
//
//     m (u - u') / h^2 + K u = 0,   u K u = sum of A T |du/ds|^2,
//
// u' where inertia leads. The rows of K are the mesh's pull.
//
// Length. Cloth does not stretch, and it keeps its area. With G Green's strain of a coarse triangle, G0 that of the
// still cloth, and ( )+ and ( )- the parts of a matrix that have its positive and its negative principal values, the
// energy per area is
//
//     Y/2 |(G - G0+)+|^2 + q Y/2 |(G - G0-)-|^2,   q = COMPRESSED.
//
// Between still cloth, whose folds are finer than the mesh, and flat cloth a triangle is free (tension field theory).
// Where it became shorter than it is in still cloth, folds would have to hide what it lacks, and they are too fine for
// that. Y is the cloth's stiffness, but no more than a few sweeps can follow.
#pragma once
#include "colliders.hpp"

namespace swing {

constexpr double CONTACT_J_M4 = 3.0e4;  // a tenth of the folds': half a spacing of skin is behind a node
constexpr double GAP_M = 0.004;
constexpr double TOUCH_M = 0.06;        // a sample farther away says nothing of the skin below a node
constexpr double SWEEP_M = 0.01;        // a sweep moves no node farther
constexpr double LEAST_SQUARE = 1e-30;  // a residual's square that is small enough by itself [N m]
constexpr double COMPRESSED = 0.2;
constexpr double LEAST_STRAIN = 1e-9;  // a difference of principal strains that says nothing of their axes
constexpr double LOOSE = 0.05;  // a loose triangle resists a step with this share of the stiffness of one that pulls

// Writes (inertia + hold + weight K) u [N] of the nodes that may move.
template <class T>
DEVICE void pulled(const T* u, const SwingMesh<T>& mesh, const T* inertia, const T* hold, T weight, T* out) {
  for (int64_t n : each(mesh.order.count)) {
    const int64_t i = mesh.order[n];
    Vector<T> total = scaled(inertia[i] + hold[i], point(u, i));
    for (int64_t e = mesh.pull_start[i]; e < mesh.pull_start[i + 1]; ++e)
      total = plus(total, weight * mesh.pull[e], point(u, mesh.pull_node[e]));
    put_point(out, i, total);
  }
}

// Moves u [m] (N, 3) in place towards the solution of (inertia + hold + weight K) u = rhs [N] over the nodes that may
// move, by rounds of conjugate gradients; inertia and hold [N/m] (N,).
template <class T>
DEVICE void fall_back(T* u, const SwingMesh<T>& mesh, const T* inertia, const T* hold, T weight, const T* rhs,
               int64_t rounds, Scratch& scratch) {
  const int64_t mark = scratch.used, count = mesh.order.count, nodes = mesh.vertex.count;
  T *r = scratch.take<T>(3 * nodes), *q = scratch.take<T>(3 * nodes), *p = scratch.take<T>(3 * nodes);
  T *diagonal = scratch.take<T>(nodes), *room = scratch.take<T>(count);
  if (scratch.overflowed) return;
  for (int64_t i : each(nodes)) {
    put_point(r, i, Vector<T>{}), put_point(q, i, Vector<T>{}), put_point(p, i, Vector<T>{});
    diagonal[i] = 0;
  }
  for (int64_t n : each(count)) {
    const int64_t i = mesh.order[n];
    diagonal[i] = inertia[i] + hold[i];
    for (int64_t e = mesh.pull_start[i]; e < mesh.pull_start[i + 1]; ++e)
      if (mesh.pull_node[e] == i) diagonal[i] += weight * mesh.pull[e];
  }
  pulled(u, mesh, inertia, hold, weight, q);
  T old = sum_in_order(count, room, [&](int64_t n) {
    const int64_t i = mesh.order[n];
    const Vector<T> left = point(rhs, i) - point(q, i), way = scaled(T(1) / diagonal[i], left);
    put_point(r, i, left), put_point(p, i, way);
    return dot(left, way);
  });
  if (old != old)
    for (int64_t i : each(3 * nodes)) u[i] = old;  // NaN, which the caller looks for
  // Rounds stop where floats cannot tell more of the first residual; squares of smaller residuals would underflow.
  const T eps = sizeof(T) == 4 ? T(1.1920929e-07) : T(2.220446049250313e-16);
  const T end = more<T>(eps * eps * old, T(LEAST_SQUARE));
  for (int64_t round = 0; round < rounds && old > end; ++round) {
    pulled(p, mesh, inertia, hold, weight, q);
    const T down = sum_in_order(count, room, [&](int64_t n) {
      return dot(point(p, mesh.order[n]), point(q, mesh.order[n]));
    });
    const T a = old / down;
    const T next = sum_in_order(count, room, [&](int64_t n) {
      const int64_t i = mesh.order[n];
      put_point(u, i, plus(point(u, i), a, point(p, i)));
      const Vector<T> left = plus(point(r, i), -a, point(q, i));
      put_point(r, i, left);
      return dot(left, left) / diagonal[i];
    });
    const T b = next / old;
    old = next;
    for (int64_t n : each(count)) {
      const int64_t i = mesh.order[n];
      put_point(p, i, mix(T(1) / diagonal[i], point(r, i), b, point(p, i)));
    }
  }
  scratch.used = mark;
}

template <class N> struct Strain { N pp, tt, pt; };

// Returns Green's strain of a triangle.
template <class T> INLINE Strain<Row<T>> strain(Columns<Row<T>> f) {
  return {T(0.5) * (dot(f.p, f.p) - T(1)), T(0.5) * (dot(f.t, f.t) - T(1)), T(0.5) * dot(f.p, f.t)};
}

// A symmetric matrix by its principal values: their mean, half of their difference, and that times the cosine and the
// sine of twice the angle of the first one's axis.
template <class T> struct Principal { Row<T> mean, half, cosine, sine; };
template <class T> INLINE Principal<T> principal(Strain<Row<T>> g) {
  Row<T> off = T(0.5) * (g.pp - g.tt);
  return {T(0.5) * (g.pp + g.tt), root<T>(off * off + g.pt * g.pt), off, g.pt};
}

// The mean and half difference of the principal values of a matrix's positive part.
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
INLINE Columns<Row<T>> columns_of(const T* x, Points<T> own, const SwingRows<T>& rows, int64_t row,
                                  const Slopes<T>& s) {
  const int32_t* other = rows.other + 2 * LANES * row;
  return columns(points_at(x, other) - own, points_at(x, other + LANES) - own, s.p1, s.p2, s.t1, s.t2);
}

// Writes to x (P, 3) the nodes c [m] (N, 3) at their places.
template <class T> DEVICE void at_places(const T* c, const SwingRows<T>& rows, T* x) {
  for (int64_t p : each(rows.node.count)) put_point(x, p, point(c, rows.node[p]));
}

// Writes G+ and G-, each by pp, tt and pt, of the triangles of all nodes that may move and are at x [m] (P, 3): six
// rows each.
template <class T> DEVICE void write_bounds(const T* x, const SwingRows<T>& rows, T* bound) {
  for (int64_t block : each_block(rows.moving)) {
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

// Returns gradient [N] and Hessian [N/m] of the energy of length by the nodes of a block. The Hessian has what a
// triangle resists by along principal axes u that pull, (m . u)^2 F u (F u)^T, and a small share of the rest; m are the
// slopes of the node's corner.
template <class T>
INLINE Model<T> length_model(const T* x, int64_t block, const SwingRows<T>& rows, T young, const T* bound) {
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
    // One division in place of three: 1 / a = b c / (a b c).
    Row<T> a = most<T>(high.half, little), b = most<T>(low.half, little), c = most<T>(push.mean, little);
    Row<T> per = one / (a * b * c);
    // Twice the axis of the first principal value: cosine and sine of twice its angle.
    Row<T> cosine = b * c * per * high.cosine, sine = b * c * per * high.sine;
    Row<T> cp = stiff * (mp * (pull.mean + pull.half * cosine) + mt * pull.half * sine);
    Row<T> ct = stiff * (mp * pull.half * sine + mt * (pull.mean - pull.half * cosine));
    Row<T> full = where<T>(zero > high.half - high.mean, one, row_of(T(LOOSE)));  // both principal values pull
    Row<T> share = full * stiff;
    Row<T> pp = share * (mp * mp + T(0.5) * mt * mt), tt = share * (mt * mt + T(0.5) * mp * mp);
    Row<T> pt = T(0.5) * share * mp * mt;
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

// Rows of what holds a block of nodes: target and stiffness of the springs; the sample, the normal there, the gap less
// how deep still cloth is, and the square of the distance from which the sample says nothing; contact's stiffness; and
// the normal and height of two planes.
constexpr int TARGET = 0, SPRING = 3 * LANES, SAMPLE = 4 * LANES, AXIS = 7 * LANES, TOP = 10 * LANES;
constexpr int WITHIN = 11 * LANES, STIFF = 12 * LANES, PLANE = 13 * LANES, HELD = 21 * LANES;

// The ground of the nodes: the samples of the skin (S, 8); for each node (N,) the sample below still cloth and the one
// touched now; how deep [m] below the gap still cloth is; and the planes (N, 2, 4) of write_node_planes.
template <class T> struct Ground {
  const T* samples;
  const int32_t *still, *touched;
  const T *deep, *planes;
};

// Writes to held what holds the nodes that may move, HELD numbers a block: springs [N/m] (N,) to their targets [m] (N,
// 3), and the ground. Returns whether any node has a plane.
template <class T>
DEVICE bool lay_held(const T* target, const T* spring, const Ground<T>& ground, const SwingMesh<T>& mesh, T* held) {
  int beside = 0;
  for (int64_t p : each(LANES * mesh.rows.moving)) {
    const int64_t i = mesh.rows.node[p];
    const T* sample = ground.samples + 8 * int64_t(ground.touched[i]);
    T* to = held + HELD * (p / LANES);
    const int lane = int(p % LANES);
    put_lane3(to + TARGET, lane, point(target, i));
    put_lane3(to + SAMPLE, lane, point(sample, 0));
    put_lane3(to + AXIS, lane, point(sample + 4, 0));
    to[SPRING + lane] = spring[i];
    to[TOP + lane] = T(GAP_M) - ground.deep[i];
    to[WITHIN + lane] = T(ground.touched[i] == ground.still[i] ? INFINITE : TOUCH_M * TOUCH_M);
    to[STIFF + lane] = T(2.0 * CONTACT_J_M4) * mesh.area_m2[i];
    for (int m = 0; m < 2; ++m) {
      const T* plane = ground.planes + 8 * i + 4 * m;
      const bool there = dot(point(plane, 0), point(plane, 0)) > 0;
      beside |= int(there);
      put_lane3(to + PLANE + 4 * LANES * m, lane, point(plane, 0));
      to[PLANE + 4 * LANES * m + 3 * LANES + lane] = there ? T(GAP_M) + plane[3] : T(-1);
    }
  }
  return most_of_all(beside) > 0;
}

// Moves the nodes c [m] (N, 3) in place by sweeps there and back, each node to the minimum of its own quadratic model.
// x [m] (P, 3) are the nodes at their places, held is that of lay_held, and beside says whether any node has a plane.
template <class T>
DEVICE void keep_length(T* c, T* x, const SwingRows<T>& rows, T young, const T* bound, const T* held, bool beside,
                 int64_t sweeps) {
  const Row<T> zero = row_of(T(0));
  for (int64_t turn = 0; turn < 2 * sweeps; ++turn)
    for (int64_t n = 0, at = turn % 2 == 0 ? 0 : rows.moving - 1; n < rows.moving; ++n, at += turn % 2 == 0 ? 1 : -1)
    for (int64_t block : each_block(at, at + 1)) {  // one after the other, since a block reads those before
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
  for (int64_t p : each(LANES * rows.moving)) put_point(c, rows.node[p], point(x, p));
}

}  // namespace swing
