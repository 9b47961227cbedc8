// Turns as unit quaternions: of a surface from one frame to the next, and of what nodes carry with them.
//
// A vertex turns by Q = R^T R', R and R' the frames of the surface now and before (frames.hpp). Such a turn is rough
// where triangles are small, so it goes over to the mean with its neighbours'. Q and -Q are one turn: each counts with
// the sign that is nearer.
#pragma once
#include "frames.hpp"

constexpr int SHARED = 8;  // nodes that carry a vertex

template <class T> struct Turns { Row<T> w; Points<T> v; };

template <class T> INLINE Points<T> turned_by(Turns<T> q, Points<T> a) {
  Points<T> b = cross(q.v, a);
  b = b + b;
  return plus(a, q.w, b) + cross(q.v, b);
}

template <class T> INLINE Turns<T> unit_turns(Turns<T> q) {
  Row<T> per = T(1) / root<T>(q.w * q.w + dot(q.v, q.v));
  return {per * q.w, scaled(per, q.v)};
}

// Returns sum + share q, with the sign of q that is nearer to own.
template <class T> INLINE Turns<T> joined(Turns<T> sum, Turns<T> own, Row<T> share, Turns<T> q) {
  share = where<T>(own.w * q.w + dot(own.v, q.v) < row_of(T(0)), -share, share);
  return {sum.w + share * q.w, plus(sum.v, share, q.v)};
}

// Returns turns (P, 4), which lie one after the other in memory, by index.
template <class T> INLINE Turns<T> turns_at(const T* turns, const int32_t* index) {
  FourRows<T> t = fours_at(turns, index, 4);
  return {t.a, {t.b, t.c, t.d}};
}
template <class T> INLINE Turns<T> turns_in(const T* turns) {
  FourRows<T> t = own_fours(turns);
  return {t.a, {t.b, t.c, t.d}};
}
template <class T> INLINE void put_turns(T* turns, Turns<T> q) { put_fours(turns, {q.w, q.v.x, q.v.y, q.v.z}); }

// Returns the turns (quaternions) from the axes then to the axes now; the identity where either are zero. Of the four
// squares that make a quaternion the largest is at least 1.
template <class T> INLINE Turns<T> turns_between(const AxesOf<T>& then, const AxesOf<T>& now) {
  Points<T> x = plus(plus(scaled(now.n.x, then.n), now.e.x, then.e), now.b.x, then.b);  // a row of Q
  Points<T> y = plus(plus(scaled(now.n.y, then.n), now.e.y, then.e), now.b.y, then.b);
  Points<T> z = plus(plus(scaled(now.n.z, then.n), now.e.z, then.e), now.b.z, then.b);
  const Row<T> one = row_of(T(1)), xy = y.x + x.y, xz = z.x + x.z, yz = z.y + y.z;
  const Points<T> about = {z.y - y.z, x.z - z.x, y.x - x.y};
  const Turns<T> by_x = {about.x, {one + x.x - y.y - z.z, xy, xz}}, by_y = {about.y, {xy, one - x.x + y.y - z.z, yz}};
  const Turns<T> by_z = {about.z, {xz, yz, one - x.x - y.y + z.z}};
  Turns<T> q = {one + x.x + y.y + z.z, about};
  Row<T> most_ = q.w;
  auto choose = [&](Turns<T> other, Row<T> square) {
    const Mask<T> larger = square > most_;
    q.w = where<T>(larger, other.w, q.w);
    q.v.x = where<T>(larger, other.v.x, q.v.x);
    q.v.y = where<T>(larger, other.v.y, q.v.y);
    q.v.z = where<T>(larger, other.v.z, q.v.z);
    most_ = where<T>(larger, square, most_);
  };
  choose(by_x, by_x.v.x), choose(by_y, by_y.v.y), choose(by_z, by_z.v.z);
  return unit_turns(q);
}

// Replaces each of the turns (P, 4), so many times, by the mean of its own and its neighbours', each of which counts
// once for every triangle that they share.
template <class T> DEVICE void smooth_turns(T* turns, const Sheet<T>& sheet, int passes, Scratch& scratch) {
  const int64_t mark = scratch.used, count = sheet.fan_start.count - 1;
  T* before = scratch.take<T>(4 * LANES * count);
  if (scratch.overflowed) return;
  for (int pass = 0; pass < passes; ++pass) {
    copy(before, turns, 4 * LANES * count);
    for (int64_t block : each_block(count)) {
      Turns<T> own = turns_in(before + 4 * LANES * block), sum = own;
      for (int64_t row = 2 * sheet.fan_start[block]; row < 2 * sheet.fan_start[block + 1]; ++row)
        sum = joined<T>(sum, own, real_row(sheet, block, row), turns_at(before, sheet.fan_other + LANES * row));
      put_turns(turns + 4 * LANES * block, unit_turns(sum));
    }
  }
  scratch.used = mark;
}

// Writes the turns (P, 4) from a surface with the frames then to one with the frames now, smoothed so many times.
template <class T>
DEVICE void surface_turns(const T* then, const T* now, const Sheet<T>& sheet, int passes, T* turns, Scratch& scratch) {
  for (int64_t block : each_block(sheet.fan_start.count - 1))
    put_turns(turns + 4 * LANES * block, turns_between(axes_in(then + FRAMES * block), axes_in(now + FRAMES * block)));
  smooth_turns(turns, sheet, passes, scratch);
}

template <class T> struct Matrix { Points<T> a, b, c; };  // by columns

template <class T> INLINE Matrix<T> matrix_of(Turns<T> q) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  return {turned_by<T>(q, {one, zero, zero}), turned_by<T>(q, {zero, one, zero}), turned_by<T>(q, {zero, zero, one})};
}

// Writes to their rows of a table (N, 16), by index, how nodes carry cloth along: a share of Q - 1 and of c - c' - (Q -
// 1) c', four columns of four numbers, for turns Q and nodes that went from c' to c.
template <class T>
INLINE void put_nodes(T* table, const int32_t* index, Matrix<T> q, Points<T> from, Points<T> to, T share) {
  const Row<T> one = row_of(T(1));
  q.a.x = q.a.x - one, q.b.y = q.b.y - one, q.c.z = q.c.z - one;
  const Points<T> turned = plus(mix(from.x, q.a, from.y, q.b), from.z, q.c);
  const Points<T> columns[4] = {q.a, q.b, q.c, to - from - turned};
  for (int k = 0; k < WIDTH; ++k) {
    T* row = table + LANES * (int64_t)index[k];
    for (int column = 0; column < 4; ++column) {
      row[4 * column] = share * number_in(columns[column].x, k);
      row[4 * column + 1] = share * number_in(columns[column].y, k);
      row[4 * column + 2] = share * number_in(columns[column].z, k);
      row[4 * column + 3] = 0;
    }
  }
}

// Returns where a point is after SHARED nodes of a table have carried it, by weights; stride is the distance from one
// of them to the next.
template <class T>
INLINE Vector<T> carried_by(const T* table, const int32_t* node, const T* weight, int stride, Vector<T> p) {
  // There are two sums, so that neither waits for the other.
  Moves<T> one = weight[0] * moves_at(table + LANES * node[0]);
  Moves<T> two = weight[stride] * moves_at(table + LANES * node[stride]);
  for (int n = 2; n < SHARED; n += 2) {
    one = joined<T>(one, weight[n * stride], moves_at(table + LANES * node[n * stride]));
    two = joined<T>(two, weight[(n + 1) * stride], moves_at(table + LANES * node[(n + 1) * stride]));
  }
  return p + moved<T>(one + two, p);
}
