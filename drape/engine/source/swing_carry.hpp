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
#pragma once
#include "turns.hpp"

constexpr int ROTATION_ROUNDS = 8;    // of turning, fewer where the square of the last half turn [rad^2] was ENOUGH
constexpr double ENOUGH = 1e-9;
constexpr double LEAST_ALONG = 1e-3;  // of the squared sides: a smaller sum of r . m says little of a rotation

// The rotation nearest to a matrix, of 1 where that is zero. Sums of r . m below least turn it less.
template <class T> INLINE Matrix<T> rotation_of(const Matrix<T>& m, Row<T> least_) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Points<T> e = {one, zero, zero}, f = {zero, one, zero}, g = {zero, zero, one};
  for (int round = 0; round < ROTATION_ROUNDS; ++round) {
    Points<T> turn = cross(e, m.a) + cross(f, m.b) + cross(g, m.c);
    Row<T> along = dot(e, m.a) + dot(f, m.b) + dot(g, m.c);
    along = most<T>(most<T>(along, -along), least_);
    Points<T> q = scaled(T(0.5) / where<T>(along > zero, along, one), turn);
    Row<T> square = dot(q, q), w = one / root<T>(one + square);
    const Turns<T> half = {w, scaled(w, q)};
    e = turned_by(half, e), f = turned_by(half, f), g = turned_by(half, g);
    if (!lanes_of<T>(square > row_of(T(ENOUGH)))) break;
  }
  return {e, f, g};
}

// Writes a share of R - 1 and of c - X - (R - 1) X of every node to table, sixteen numbers each: four columns of four.
template <class T>
void write_turns(const T* still, const T* swung, const SwingMesh<T>& mesh, T share, T* table, Scratch& scratch) {
  const SwingRows<T>& rows = mesh.rows;
  const int64_t mark = scratch.used, places = rows.node.count, blocks = rows.start.count - 1;
  T *x = scratch.take<T>(3 * places), *c = scratch.take<T>(3 * places), *square = scratch.take<T>(places);
  T *first = scratch.take<T>(3 * places), *second = scratch.take<T>(3 * places), *third = scratch.take<T>(3 * places);
  if (scratch.overflowed) return;
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  for (int64_t p = 0; p < places; ++p) {
    put_point(x, p, point(still, rows.node[p]));
    put_point(c, p, point(swung, rows.node[p]));
  }
  for (int64_t block = 0; block < blocks; ++block) {
    const int64_t at = 3 * LANES * block;
    const Points<T> own = points_in(x + at), moved = points_in(c + at), none = {zero, zero, zero};
    Points<T> before = none, after = none;
    Matrix<T> m = {none, none, none};
    Row<T> sides = zero;
    for (int64_t row = rows.start[block]; row < rows.start[block + 1]; ++row) {
      const int32_t* other = rows.other + 2 * LANES * row;
      Points<T> a = points_at(x, other) - own, b = points_at(c, other) - moved;
      Points<T> p = points_at(x, other + LANES) - own, q = points_at(c, other + LANES) - moved;
      m = {m.a + mix(a.x, b, p.x, q), m.b + mix(a.y, b, p.y, q), m.c + mix(a.z, b, p.z, q)};
      before = before + cross(a, p), after = after + cross(b, q);
      sides = sides + dot(a, a) + dot(p, p);
    }
    Row<T> length = root<T>(dot(before, before) * dot(after, after));
    after = scaled(where<T>(length > zero, T(0.5) * sides / where<T>(length > zero, length, one), zero), after);
    put_points(first + at, plus(m.a, before.x, after));
    put_points(second + at, plus(m.b, before.y, after));
    put_points(third + at, plus(m.c, before.z, after));
    put(square + LANES * block, sides);
  }
  for (int64_t block = 0; block < blocks; ++block) {
    const int64_t at = 3 * LANES * block;
    Matrix<T> m = {points_in(first + at), points_in(second + at), points_in(third + at)};
    for (int64_t row = 2 * rows.start[block]; row < 2 * rows.start[block + 1]; ++row) {
      // An empty row has the place itself, and no area.
      Row<T> real = where<T>(row_at(rows.slope + 5 * LANES * (row / 2) + 4 * LANES) > zero, one, zero);
      const int32_t* other = rows.other + LANES * row;
      m = {plus(m.a, real, points_at(first, other)), plus(m.b, real, points_at(second, other)),
           plus(m.c, real, points_at(third, other))};
    }
    const Matrix<T> r = rotation_of<T>(m, T(LEAST_ALONG) * row_at(square + LANES * block));
    put_nodes(table, rows.node + LANES * block, r, points_in(x + at), points_in(c + at), share);
  }
  scratch.used = mark;
}

// Writes the vertices [m] (V, 3), moved by a share of the nodes' way and turn from still to swung [m] (N, 3), to out.
template <class T>
void move_vertices(const T* vertices, int64_t count, const T* still, const T* swung, const SwingMesh<T>& mesh, T share,
                   T* out, Scratch& scratch) {
  const int64_t mark = scratch.used;
  T* table = scratch.take<T>(LANES * mesh.vertex.count);
  if (scratch.overflowed) return;
  write_turns(still, swung, mesh, share, table, scratch);
  for (int64_t v = 0; v < count; ++v) {
    const int64_t first = SHARED * v;
    put_point(out, v, carried_by(table, mesh.weight_node + first, mesh.weight + first, 1, point(vertices, v)));
  }
  scratch.used = mark;
}
