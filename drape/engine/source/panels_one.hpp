// The solve of a card (whole.hpp): panels of a level of their tree are multiplied at once.
//
// A panel is a level above all those that have rows among its columns. What these leave for a column is kept where it
// was computed and added up column by column, in the order of a processor, so that sums are the same and no two threads
// write one number. So are the parts that sixteen threads have of a column on the way up.
#pragma once
#include "records.hpp"
#include "rows.hpp"

template <class T> INLINE int64_t solve_room(const StiffnessFactor<T>& factor) {
  return 3 * more<int64_t>(factor.member.count, LANES * factor.place.count);
}

// What a panel has left in entry of all members.
template <class T> INLINE Vector<T> left_in(const T* s, int64_t entry) {
  return lane3(s + 3 * LANES * (entry / LANES), int(entry % LANES));
}

template <class T> INLINE void go_down(const StiffnessFactor<T>& factor, int64_t level, T* y, T* s) {
  const PanelLevels<T>& levels = factor.levels;
  for (int64_t c : each(levels.column_start[level + 1] - levels.column_start[level])) {
    const int64_t j = levels.column[levels.column_start[level] + c];
    for (int64_t n = levels.left_start[j]; n < levels.left_start[j + 1] - 1; ++n)  // the last one is its own panel's
      put_point(y, j, point(y, j) + left_in(s, levels.left[n]));
  }
  for (int64_t block : each_block(levels.row_start[level], levels.row_start[level + 1])) {
    const int64_t panel = levels.row_panel[block], row = levels.row[block], begin = factor.start[panel];
    const int64_t rows = factor.start[panel + 1] - begin;
    const T* value = factor.value + factor.entry[panel] + row;
    Points<T> sum = {};
    for (int64_t j = factor.column[panel]; j < factor.column[panel + 1]; ++j, value += rows)
      sum = plus(sum, row_at(value), point(y, j));
    put3(s + 3 * (begin + row), sum);
  }
}

template <class T> INLINE void go_up(const StiffnessFactor<T>& factor, int64_t level, T* y, T* s) {
  const PanelLevels<T>& levels = factor.levels;
  const int32_t* column = levels.column + levels.column_start[level];
  const int64_t count = levels.column_start[level + 1] - levels.column_start[level];
  for (int64_t c : each_block(count)) {
    const int64_t j = column[c], panel = levels.panel[j], begin = factor.start[panel];
    const int64_t rows = factor.start[panel + 1] - begin;
    const T* value = factor.value + factor.entry[panel] + (j - factor.column[panel]) * rows;
    Points<T> sum = {};
    for (int64_t row = 0; row < rows; row += LANES)
      sum = plus(sum, row_at(value + row), points_at(y, factor.member + begin + row));
    put3(s + 3 * LANES * c, sum);
  }
  for (int64_t c : each(count)) put_point(y, column[c], point(y, column[c]) + sums_in(s + 3 * LANES * c));
}

template <class T> DEVICE void solve(const StiffnessFactor<T>& factor, T* y, T* s) {
  const PanelLevels<T>& levels = factor.levels;
  const int64_t count = levels.row_start.count - 1;
  for (int64_t level = 0; level < count; ++level) go_down(factor, level, y, s);
  for (int64_t i : each(factor.place.count)) {
    const Vector<T> own = left_in(s, levels.left[levels.left_start[i + 1] - 1]);
    put_point(y, i, scaled(factor.inverse[i], point(y, i) + own));
  }
  for (int64_t level = count - 1; level >= 0; --level) go_up(factor, level, y, s);
}
