// How the nodes of a swing mesh carry the cloth between them: by their ways, and by how they have turned.
//
// The folds of still cloth are finer than the mesh. Nodes that only moved them would flatten folds where cloth turns,
// and it would lose area. So each node j turns what is around it (Sumner, Schmid and Pauly 2007, "Embedded Deformation
// for Shape Manipulation", ACM TOG 26(3)). With X the still nodes, c the swung ones, R their turns and w the weights,
//
//     v = x + sum of w (c - X + (R - 1) (x - X)).
//
// R is the rotation nearest to the sum of M over the node and its neighbours,
//
//     M = sum of b a^T + n N^T |a|^2 / 2,
//
// a and b the sides of the node's coarse triangles in X and in c, N and n its normals there. It is found by turning
// about the sum of r x m over the columns of R and M (Mueller, Bender, Chentanez and Macklin 2016, "A Robust Method to
// Extract the Rotational Part of Deformations", MIG), which has a result for every M.
//
// Nodes that go where their neighbours do not crumple the cloth between them. So each first goes over to
//
//     c <- mean of c + R (X - mean of X)
//
// a few times, means over the node and its neighbours, with R of as wide a surrounding. What many nodes do together
// stays as it is.
#pragma once
#include "turns.hpp"

constexpr int ROTATION_ROUNDS = 8;    // of turning, fewer where the square of the last half turn [rad^2] was ENOUGH
constexpr double ENOUGH = 1e-9;
constexpr int MEANS = 3;  // none leave a walking skirt half again as much curvature, six no less
constexpr double LEAST_ALONG = 1e-3;  // of the squared sides: a smaller sum of r . m says little of a rotation

// Turns the columns e, f, g on towards the rotation nearest to a matrix; sums of r . m below least turn them less.
// Returns the square of the half turn.
template <class T> INLINE Row<T> turn_on(Points<T>& e, Points<T>& f, Points<T>& g, const Matrix<T>& m, Row<T> least_) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Points<T> turn = cross(e, m.a) + cross(f, m.b) + cross(g, m.c);
  Row<T> along = dot(e, m.a) + dot(f, m.b) + dot(g, m.c);
  along = most<T>(most<T>(along, -along), least_);
  Points<T> q = scaled(T(0.5) / where<T>(along > zero, along, one), turn);
  Row<T> square = dot(q, q), w = one / root<T>(one + square);
  const Turns<T> half = {w, scaled(w, q)};
  e = turned_by(half, e), f = turned_by(half, f), g = turned_by(half, g);
  return square;
}

// The nodes of a swing mesh at their places, still x and swung c [m] (P, 3).
template <class T> struct Nodes { T *x, *c; };

// Returns for each lane 1 where this row has a triangle, and 0 where it is empty: it then has the place itself, and no
// area.
template <class T> INLINE Row<T> real_triangle(const SwingRows<T>& rows, int64_t row) {
  const Row<T> area = row_at(rows.slope + 5 * LANES * row + 4 * LANES);
  return where<T>(area > row_of(T(0)), row_of(T(1)), row_of(T(0)));
}

// Matrices at every place, by their three columns (3, P, 3).
template <class T> struct Matrices {
  T *a, *b, *c;
  INLINE_MEMBER Matrices(int64_t places, Scratch& scratch)
      : a(scratch.take<T>(3 * places)), b(scratch.take<T>(3 * places)), c(scratch.take<T>(3 * places)) {}
  INLINE_MEMBER Matrix<T> in(int64_t at) const { return {points_in(a + at), points_in(b + at), points_in(c + at)}; }
  INLINE_MEMBER Matrix<T> at(const int32_t* index) const {
    return {points_at(a, index), points_at(b, index), points_at(c, index)};
  }
  INLINE_MEMBER void set(int64_t at, const Matrix<T>& m) const {
    put_points(a + at, m.a), put_points(b + at, m.b), put_points(c + at, m.c);
  }
};

// Writes to found the matrix M of each node's own triangles, and to square (P,) the squares [m^2] of their sides.
template <class T>
DEVICE void write_sides(const Nodes<T>& nodes, const SwingRows<T>& rows, const Matrices<T>& found, T* square) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  for (int64_t block : each_block(rows.start.count - 1)) {
    const int64_t at = 3 * LANES * block;
    const Points<T> own = points_in(nodes.x + at), moved = points_in(nodes.c + at), none = {zero, zero, zero};
    Points<T> before = none, after = none;
    Matrix<T> m = {none, none, none};
    Row<T> sides = zero;
    for (int64_t row = rows.start[block]; row < rows.start[block + 1]; ++row) {
      const int32_t* other = rows.other + 2 * LANES * row;
      Points<T> a = points_at(nodes.x, other) - own, b = points_at(nodes.c, other) - moved;
      Points<T> p = points_at(nodes.x, other + LANES) - own, q = points_at(nodes.c, other + LANES) - moved;
      m = {m.a + mix(a.x, b, p.x, q), m.b + mix(a.y, b, p.y, q), m.c + mix(a.z, b, p.z, q)};
      before = before + cross(a, p), after = after + cross(b, q);
      sides = sides + dot(a, a) + dot(p, p);
    }
    Row<T> length = root<T>(dot(before, before) * dot(after, after));
    after = scaled(where<T>(length > zero, T(0.5) * sides / where<T>(length > zero, length, one), zero), after);
    found.set(at, {plus(m.a, before.x, after), plus(m.b, before.y, after), plus(m.c, before.z, after)});
    put(square + LANES * block, sides);
  }
}

#ifdef ONE_LANE
// Writes the rotation R of every node, from its sums M. The rounds of a block end together, so that lanes tell each
// other their last half turns.
template <class T>
DEVICE void write_rotations(const Matrices<T>& sums, const T* square, int64_t blocks, const Matrices<T>& turns,
                            Scratch& scratch) {
  const T zero = 0, one = 1;
  const Matrices<T> found(LANES * blocks, scratch);
  T* half = scratch.take<T>(2 * LANES * blocks);  // of this round and of the one before
  if (scratch.overflowed) return;
  for (int round = 0; round < ROTATION_ROUNDS; ++round)
    for (int64_t block : each_block(blocks)) {
      const int64_t at = 3 * LANES * block, first = LANES * block, other = LANES * blocks;
      T *now = half + (round % 2 ? other : 0) + first, *before = half + (round % 2 ? 0 : other) + first;
      put(now, T(0));
      if (round > 0 && !(most_in(before) > T(ENOUGH))) continue;
      Matrix<T> r = {{one, zero, zero}, {zero, one, zero}, {zero, zero, one}};
      if (round > 0) r = found.in(at);
      put(now, turn_on<T>(r.a, r.b, r.c, sums.in(at), T(LEAST_ALONG) * row_at(square + first)));
      found.set(at, r);
    }
  for (int64_t block : each_block(blocks)) turns.set(3 * LANES * block, found.in(3 * LANES * block));
}
#else
// Returns the rotation nearest to a matrix, the identity where that is zero.
template <class T> INLINE Matrix<T> rotation_of(const Matrix<T>& m, Row<T> least_) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Points<T> e = {one, zero, zero}, f = {zero, one, zero}, g = {zero, zero, one};
  for (int round = 0; round < ROTATION_ROUNDS; ++round)
    if (!lanes_of<T>(turn_on<T>(e, f, g, m, least_) > row_of(T(ENOUGH)))) break;
  return {e, f, g};
}
template <class T>
void write_rotations(const Matrices<T>& sums, const T* square, int64_t blocks, const Matrices<T>& turns, Scratch&) {
  for (int64_t block = 0; block < blocks; ++block) {
    const int64_t at = 3 * LANES * block;
    turns.set(at, rotation_of<T>(sums.in(at), T(LEAST_ALONG) * row_at(square + LANES * block)));
  }
}
#endif

// Writes the rotation R of every node, of the matrices M summed over the nodes at most so many rings away.
template <class T>
DEVICE void write_turns(const Nodes<T>& nodes, const SwingRows<T>& rows, int rings, const Matrices<T>& turns,
                 Scratch& scratch) {
  const int64_t mark = scratch.used, places = rows.node.count;
  T* square = scratch.take<T>(places);
  Matrices<T> before = turns, sums(places, scratch);
  if (scratch.overflowed) return;
  write_sides(nodes, rows, before, square);
  for (int ring = 0; ring < rings; ++ring) {
    for (int64_t block : each_block(rows.start.count - 1)) {
      Matrix<T> m = before.in(3 * LANES * block);
      for (int64_t row = 2 * rows.start[block]; row < 2 * rows.start[block + 1]; ++row) {
        const Row<T> real = real_triangle(rows, row / 2);
        const Matrix<T> other = before.at(rows.other + LANES * row);
        m = {plus(m.a, real, other.a), plus(m.b, real, other.b), plus(m.c, real, other.c)};
      }
      sums.set(3 * LANES * block, m);
    }
    const Matrices<T> spare = before;
    before = sums, sums = spare;
  }
  write_rotations(before, square, rows.start.count - 1, turns, scratch);
  scratch.used = mark;
}

// Moves the nodes that may move to the mean around them, plus their way from that mean in still cloth, turned.
template <class T>
DEVICE void smooth_nodes(const Nodes<T>& nodes, const SwingRows<T>& rows, const Matrices<T>& turns, Scratch& scratch) {
  const int64_t mark = scratch.used, places = rows.node.count;
  T* mean = scratch.take<T>(3 * places);
  if (scratch.overflowed) return;
  for (int pass = 0; pass < MEANS; ++pass) {
    for (int64_t block : each_block(rows.moving)) {
      const int64_t at = 3 * LANES * block;
      Points<T> still = points_in(nodes.x + at), swung = points_in(nodes.c + at), off = still;
      Row<T> count = row_of(T(1));
      for (int64_t row = rows.start[block]; row < rows.start[block + 1]; ++row) {
        const int32_t* other = rows.other + 2 * LANES * row;
        const Row<T> real = real_triangle(rows, row);
        still = plus(still, real, points_at(nodes.x, other) + points_at(nodes.x, other + LANES));
        swung = plus(swung, real, points_at(nodes.c, other) + points_at(nodes.c, other + LANES));
        count = count + real + real;
      }
      const Row<T> per = row_of(T(1)) / count;
      off = off - scaled(per, still);
      const Matrix<T> r = turns.in(at);
      put_points(mean + at, scaled(per, swung) + plus(mix(off.x, r.a, off.y, r.b), off.z, r.c));
    }
    copy(nodes.c, mean, 3 * LANES * rows.moving);
  }
  scratch.used = mark;
}

// Writes to table, for every node, a share of R - 1 and of c - X - (R - 1) X: four columns of four numbers.
template <class T>
DEVICE void write_nodes(const T* still, const T* swung, const SwingMesh<T>& mesh, T share, T* table, Scratch& scratch) {
  const SwingRows<T>& rows = mesh.rows;
  const int64_t mark = scratch.used, places = rows.node.count;
  const Nodes<T> nodes = {scratch.take<T>(3 * places), scratch.take<T>(3 * places)};
  const Matrices<T> turns(places, scratch);
  if (scratch.overflowed) return;
  for (int64_t p : each(places)) {
    put_point(nodes.x, p, point(still, rows.node[p]));
    put_point(nodes.c, p, point(swung, rows.node[p]));
  }
  write_turns(nodes, rows, MEANS + 1, turns, scratch);
  smooth_nodes(nodes, rows, turns, scratch);
  write_turns(nodes, rows, 1, turns, scratch);
  for (int64_t block : each_block(places / LANES)) {
    const int64_t at = 3 * LANES * block;
    int32_t index[WIDTH];
    for (int k = 0; k < WIDTH; ++k) index[k] = rows.node[LANES * block + lane_of(k)];
    put_nodes(table, index, turns.in(at), points_in(nodes.x + at), points_in(nodes.c + at), share);
  }
  scratch.used = mark;
}

// Writes to out the vertices [m] (V, 3), moved by a share of the way and turn of the nodes from still to swung [m] (N,
// 3).
template <class T>
DEVICE void move_vertices(const T* vertices, int64_t count, const T* still, const T* swung, const SwingMesh<T>& mesh, T share,
                   T* out, Scratch& scratch) {
  const int64_t mark = scratch.used;
  T* table = scratch.take<T>(LANES * mesh.vertex.count);
  if (scratch.overflowed) return;
  write_nodes(still, swung, mesh, share, table, scratch);
  for (int64_t v : each(count)) {
    const int64_t first = SHARED * v;
    put_point(out, v, carried_by(table, mesh.weight_node + first, mesh.weight + first, 1, point(vertices, v)));
  }
  scratch.used = mark;
}
