// The solve of a card (whole.hpp): panels of a level of their tree are multiplied at once, one range a level and way.
//
// A panel is a level above all those that have rows among its columns. What these leave for a column is kept, one after
// the other as panels come. Sixteen threads that share rows of a panel add it up themselves, a column each, and tell
// each other; so they do with the parts that they have of a column on the way up. Sums have the order of a processor,
// and no two threads write one number.
#pragma once
#include "records.hpp"
#include "rows.hpp"

// The results of visit() of the sixteen threads that share a block.
template <class T, class Visit> struct OfThreads {
#ifdef __CUDACC__
  Vector<T> own;
  INLINE_MEMBER explicit OfThreads(Visit visit) : own(visit()) {}
  INLINE_MEMBER static unsigned threads() { return 0xffffu << (threadIdx.x & 16); }
  INLINE_MEMBER Vector<T> at(int n) const {
    return {__shfl_sync(threads(), own.x, n, LANES), __shfl_sync(threads(), own.y, n, LANES),
            __shfl_sync(threads(), own.z, n, LANES)};
  }
  INLINE_MEMBER Vector<T> sum() const {
    Vector<T> found = own;
    for (int way = LANES / 2; way; way /= 2)
      found = found + Vector<T>{__shfl_xor_sync(threads(), found.x, way), __shfl_xor_sync(threads(), found.y, way),
                                __shfl_xor_sync(threads(), found.z, way)};
    return found;
  }
#else
  Visit visit;
  INLINE_MEMBER explicit OfThreads(Visit visit) : visit(visit) {}
  INLINE_MEMBER Vector<T> at(int n) const {
    const int thread = group.thread;
    group.thread += n - lane();
    const Vector<T> found = visit();
    group.thread = thread;
    return found;
  }
  INLINE_MEMBER Vector<T> sum() const {  // for the first of them
    T rows[3 * LANES] = {};
    for (int n = 0; n < LANES && lane() == 0; ++n) put_lane3(rows, n, at(n));
    return sums_in(rows);
  }
#endif
};
template <class T, class Visit> INLINE OfThreads<T, Visit> of_threads(Visit visit) {
  return OfThreads<T, Visit>(visit);
}

// Returns the numbers of the room s: what panels leave for later columns, and then the columns between the two ways.
template <class T> INLINE int64_t solve_room(const StiffnessFactor<T>& factor) { return 3 * factor.member.count; }
template <class T> INLINE int64_t all_left(const StiffnessFactor<T>& factor) {
  return factor.levels.left[factor.place.count];
}

template <class T> INLINE void go_down(const StiffnessFactor<T>& factor, int64_t level, const T* y, T* s) {
  const PanelLevels<T>& levels = factor.levels;
  for (int64_t block : each_block(levels.row_start[level], levels.row_start[level + 1])) {
    const int64_t panel = levels.row_panel[block], row = levels.row[block], last = factor.column[panel + 1];
    const int64_t begin = factor.start[panel], rows = factor.start[panel + 1] - begin, left = all_left(factor);
    const int64_t to = levels.to[begin + row + lane()];
    const T* value = factor.value + factor.entry[panel] + row;
    Vector<T> sum = {}, own = {};
    for (int64_t first = factor.column[panel]; first < last; first += LANES) {
      const auto column = of_threads<T>([&]() {
        const int64_t j = first + lane();
        Vector<T> found = {};
        if (j >= last) return found;
        found = point(y, j);
        for (int64_t n = levels.left[j]; n < levels.left[j + 1]; ++n) found = found + point(s, n);
        return found;
      });
      for (int n = 0; n < LANES && first + n < last; ++n, value += rows) {
        const Vector<T> one = column.at(n);
        sum = plus(sum, row_at(value), one);
        if (to == left + first + n) own = one;
      }
    }
    if (to < 0) continue;
    put_point(s, to, to < left ? sum : scaled(factor.inverse[to - left], own + sum));
  }
}

template <class T> INLINE void go_up(const StiffnessFactor<T>& factor, int64_t level, T* y, const T* s) {
  const PanelLevels<T>& levels = factor.levels;
  const T* between = s + 3 * all_left(factor);
  for (int64_t c : each_block(levels.column_start[level], levels.column_start[level + 1])) {
    const int64_t j = levels.column[c], panel = levels.panel[j], last = factor.column[panel + 1];
    const int64_t begin = factor.start[panel], rows = factor.start[panel + 1] - begin;
    const T* value = factor.value + factor.entry[panel] + (j - factor.column[panel]) * rows;
    const Vector<T> sum = of_threads<T>([&]() {
      Vector<T> found = {};
      for (int64_t row = 0; row < rows; row += LANES) {
        const int64_t i = factor.member[begin + row + lane()];
        found = plus(found, row_at(value + row), point(i < last ? between : y, i));
      }
      return found;
    }).sum();
    if (lane() == 0) put_point(y, j, point(between, j) + sum);
  }
}

template <class T> DEVICE void solve(const StiffnessFactor<T>& factor, T* y, T* s) {
  const int64_t levels = factor.levels.row_start.count - 1;
  for (int64_t level = 0; level < levels; ++level) go_down(factor, level, y, s);
  for (int64_t level = levels - 1; level >= 0; --level) go_up(factor, level, y, s);
}
