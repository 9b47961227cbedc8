// What folds keep of the frame before: residuals that tear are mended, and those of another pose are forgotten.
//
// Memory keeps what one pose folded where the next one needs no fold, and thin cloth in motion crumples. A few steps do
// not undo that: to bend costs cloth hardly anything. So in every frame a residual r goes towards the mean m of those
// of its neighbours,
//
//     r += f (m - r),   f = s / (1 + s),   s = FORGET |e - e0| / |e| / (1 + (l / LACK)^2).
//
// e is the vertex's first edge in the network's drape of this frame and e0 that edge in the frame before, so that s
// grows with the way by which the cloth turns and not with the number of frames. Cloth on a body that stands still
// forgets nothing, and comes to rest as a still does. l is the share of its area that the network leaves out around the
// vertex,
//
//     l = max(0, 1 - sum |a x b| / 2 / sum A),
//
// a and b the sides of its triangles and A their areas at rest: there folds are needed, and stay.
//
// Hems are sewn double and do not frill, but along a border the mesh has no hinges. Residuals there also go towards the
// mean of their two neighbours' along the border, by s / (1 + s) with s = HEM |e - e0| / |e|, e the way to the next
// one.
//
// Where cloth still crosses itself at the end of a frame its residual goes towards the mean as well: the network's
// surface is smooth, and a crumple that has passed through itself goes back with it.
#pragma once
#include "frames.hpp"

constexpr double MEND_M = 0.03;  // a residual that far from its neighbours' follows them
constexpr double FORGET = 24.0, LACK = 0.003, HEM = 24.0;
constexpr double EASE = 0.5;  // the share of its way to the mean where cloth crosses and the network moves by WAY_M

// Writes f (P,), the share that a residual forgets; zeros where nothing moved.
template <class T>
DEVICE void write_forget(const T* before, const T* network, const T* frames, const Sheet<T>& sheet, T* forget) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  for (int64_t block : each_block(sheet.fan_start.count - 1)) {
    const int64_t row = sheet.fan_start[block], first = 3 * LANES * block;
    Row<T> f = zero;
    if (row < sheet.fan_start[block + 1]) {
      const int32_t* other = sheet.fan_other + 2 * LANES * row;
      Points<T> edge = points_at(network, other) - points_in(network + first);
      Points<T> turn = edge - (points_at(before, other) - points_in(before + first));
      Row<T> lacks = T(1.0 / LACK) * most<T>(one - row_at(frames + FRAMES * block + COVER), zero);
      Row<T> length = dot(edge, edge);
      Row<T> s = T(FORGET) * root<T>(dot(turn, turn) / where<T>(length > zero, length, one));
      s = s / (one + lacks * lacks);
      f = s / (one + s);
    }
    put(forget + LANES * block, f);
  }
}

// Moves each vector off (P, 3) by its share forget (P,) of the way to its neighbours' mean, and all of the way where
// that is longer than far [m]. A surface that folds over turns its frames about from one frame to the next, and
// residuals turn with them. before is scratch of the size of off, and one number.
template <class T> DEVICE void mend(T* off, const Sheet<T>& sheet, T far, const T* forget, T* before) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  const int64_t count = sheet.fan_start.count - 1;
  copy(before, off, 3 * LANES * count);
  for (int64_t block : each_block(count)) {
    Points<T> own = points_in(before + 3 * LANES * block), mean = {zero, zero, zero};
    Row<T> all = zero;
    for (int64_t row = 2 * sheet.fan_start[block]; row < 2 * sheet.fan_start[block + 1]; ++row) {
      Row<T> real = real_row(sheet, block, row);
      mean = plus(mean, real, points_at(before, sheet.fan_other + LANES * row));
      all = all + real;
    }
    mean = scaled(one / where<T>(all > zero, all, one), mean);
    Points<T> way = mean - own;
    Row<T> share = where<T>(dot(way, way) > row_of(far * far), one, row_at(forget + LANES * block));
    put_points(off + 3 * LANES * block, plus(own, where<T>(all > zero, share, zero), way));
  }
}

// Moves off of every border vertex towards the mean of its neighbours along the hem (H, 3).
template <class T> DEVICE void even_hem(T* off, const T* before, const T* network, const Array<int32_t>& hem, T* even) {
  const int64_t count = hem.count / 3;
  for (int64_t e : each(count)) {
    const int32_t last = hem[3 * e], v = hem[3 * e + 1], after = hem[3 * e + 2];
    const Vector<T> edge = point(network, after) - point(network, v);
    const Vector<T> turn = edge - (point(before, after) - point(before, v));
    const T length = dot(edge, edge), s = length > 0 ? T(HEM) * root(dot(turn, turn) / length) : T(0);
    const Vector<T> own = point(off, v), mean = scaled(T(0.5), point(off, last) + point(off, after));
    put_point(even, e, plus(own, s / (T(1) + s), mean - own));
  }
  for (int64_t e : each(count)) put_point(off, hem[3 * e + 1], point(even, e));
}

// Mends, forgets and evens the residuals off [m] (P, 3) in the world's axes, in place. before and network [m] (P, 3)
// are the network's drapes of the frame before and of this one, and frames those of the latter.
template <class T>
DEVICE void keep_residual(T* off, const T* before, const T* network, const T* frames, const Sheet<T>& sheet,
                          const Array<int32_t>& hem, Scratch& scratch) {
  const int64_t mark = scratch.used, places = sheet.vertex.count;
  T *forget = scratch.take<T>(places), *copy = scratch.take<T>(3 * places + 1), *even = scratch.take<T>(hem.count);
  if (scratch.overflowed) return;
  write_forget(before, network, frames, sheet, forget);
  mend(off, sheet, T(MEND_M), forget, copy);
  even_hem(off, before, network, hem, even);
  scratch.used = mark;
}

// Moves the residuals of x [m] (P, 3) by a share of the way to their neighbours' mean, in place, where crossed (P,) is
// above zero.
template <class T>
DEVICE void ease(T* x, const T* network, const T* crossed, T share, const Sheet<T>& sheet, Scratch& scratch) {
  const int64_t mark = scratch.used, places = sheet.vertex.count;
  T *forget = scratch.take<T>(places), *off = scratch.take<T>(3 * places + 1), *copy = scratch.take<T>(3 * places + 1);
  if (scratch.overflowed) return;
  for (int64_t v : each(places)) {
    forget[v] = crossed[v] > 0 ? share : T(0);
    put_point(off, v, point(x, v) - point(network, v));
  }
  mend(off, sheet, T(__builtin_inf()), forget, copy);
  for (int64_t v : each(places))
    if (crossed[v] > 0) put_point(x, v, point(network, v) + point(off, v));
  scratch.used = mark;
}
