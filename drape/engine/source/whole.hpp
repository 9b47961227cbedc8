// A step of the whole cloth: what is too long or too short anywhere is spread over all of it at once.
//
//     K q = -dE/dx,   x += q
//
// K is the stiffness of the cloth at rest, alike in all three axes. It never changes, so its factor L D L^T is made
// once (Liu, Bouaziz and Kavan 2017, "Quasi-Newton Methods for Real-Time Simulation of Hyperelastic Materials", ACM TOG
// 36(3)). Columns J of L whose rows R below are nearly the same make a panel, a dense matrix that stands for all of
// them,
//
//     P = [ L_JJ^-1 - 1 ; -L_RJ L_JJ^-1 ],   y_JR += P y_J  on the way down,   y_J += P^T y_JR  on the way up.
//
// Its entries need no indices, and sixteen of its rows are multiplied at once (partitioned inverse: Alvarado and
// Schreiber 1993, "Optimal Parallel Solution of Sparse Triangular Systems", SIAM J. Sci. Comput. 14(2)).
#pragma once
#include "records.hpp"
#include "rows.hpp"

constexpr double CLAMP_M = 0.02;  // a step moves no vertex farther

#ifdef ONE_LANE
#include "panels_one.hpp"
#else
// Returns how many numbers the room s of solve needs.
template <class T> INLINE int64_t solve_room(const StiffnessFactor<T>& factor) {
  return 3 * (factor.place.count + LANES);
}

// Replaces y (V, 3), in the factor's order, by K^-1 y. s has three rows for every sixteen members of the largest panel.
template <class T> DEVICE void solve(const StiffnessFactor<T>& factor, T* y, T* s) {
  const int64_t panels = factor.size.count, count = factor.place.count;
  for (int64_t panel = 0; panel < panels; ++panel) {
    const int64_t first = factor.column[panel], last = factor.column[panel + 1], begin = factor.start[panel];
    const int64_t rows = factor.start[panel + 1] - begin;
    const T* value = factor.value + factor.entry[panel];
    const int32_t* member = factor.member + begin;
    for (int64_t row = 0; row < rows; row += LANES) {
      Points<T> sum = {};
      for (int64_t j = first; j < last; ++j) {
        Row<T> p = row_at(value + (j - first) * rows + row);
        sum = {sum.x + p * y[3 * j], sum.y + p * y[3 * j + 1], sum.z + p * y[3 * j + 2]};
      }
      put3(s + 3 * row, sum);
    }
    for (int64_t row = 0; row < rows; row += LANES)
      for (int64_t lane = 0; lane < LANES && row + lane < factor.size[panel]; ++lane) {
        const int64_t i = member[row + lane];
        put_point(y, i, point(y, i) + lane3(s + 3 * row, int(lane)));
      }
  }
  for (int64_t i = 0; i < count; ++i) put_point(y, i, scaled(factor.inverse[i], point(y, i)));
  for (int64_t panel = panels - 1; panel >= 0; --panel) {
    const int64_t first = factor.column[panel], last = factor.column[panel + 1], begin = factor.start[panel];
    const int64_t rows = factor.start[panel + 1] - begin;
    const T* value = factor.value + factor.entry[panel];
    for (int64_t row = 0; row < rows; row += LANES) put3(s + 3 * row, points_at(y, factor.member + begin + row));
    for (int64_t j = first; j < last; ++j, value += rows) {
      Points<T> sum = {};
      for (int64_t row = 0; row < rows; row += LANES) sum = plus(sum, row_at(value + row), rows3_at(s + 3 * row));
      put_point(y, j, point(y, j) + sums<T>(sum));
    }
  }
}
#endif

// Moves x [m] (P, 3) in place by -K^-1 gradient [N] (P, 3), scaled down to CLAMP_M. Nothing moves where a number of
// that way is not finite. q has room for V points and one number more, s that of solve.
template <class T> DEVICE void whole_step(T* x, const StiffnessFactor<T>& factor, const T* gradient, T* q, T* s) {
  const int64_t count = factor.place.count;
  for (int64_t i : each(count)) put_point(q, i, scaled(T(-1), point(gradient, factor.place[i])));
  solve(factor, q, s);
  T square = 0;
  for (int64_t i : each(count)) {
    T own = dot(point(q, i), point(q, i));
    if (!(own <= square) && square == square) square = own;  // NaN, once met, stays
  }
  square = most_of_all(square);
  if (!(square < T(__builtin_inf()))) return;
  const T length = root(square), clamp = T(CLAMP_M), share = clamp / (length > clamp ? length : clamp);
  for (int64_t i : each(count)) {
    const int64_t place = factor.place[i];
    put_point(x, place, plus(point(x, place), share, point(q, i)));
  }
}
