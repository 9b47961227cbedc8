// The grid of a card (grid.hpp): cells are counted by all threads at once, and the points of each are put in order.
#pragma once

template <class T> INLINE bool bounds_of(const T* points, int64_t n, int width, Grid& grid, double (&extent)[3]) {
  bool finite = n > 0;
  for (int axis = 0; axis < 3; ++axis) {
    double low = n > 0 ? double(points[axis]) : 0, high = low;
    int wrong = 0;
    for (int64_t s : each(n)) {
      const T own = points[width * s + axis];
      low = own < low ? double(own) : low;
      high = own > high ? double(own) : high;
      wrong |= !(own - own == 0);
    }
    grid.low[axis] = -most_of_all(-low);
    extent[axis] = most_of_all(high) - grid.low[axis];
    finite &= !most_of_all(wrong);
  }
  return finite;
}

template <class T> DEVICE Grid grid_of(const T* points, int64_t n, int width, double per_m, Scratch& scratch) {
  Grid grid = {};
  double extent[3];
  const bool finite = bounds_of(points, n, width, grid, extent);
  grid.per_m = per_m;
  grid.cells = 1;
  for (int axis = 0; axis < 3; ++axis) {
    grid.count[axis] = finite && extent[axis] < WIDEST_M ? int64_t(extent[axis] * per_m) + 1 : 0;
    grid.cells *= grid.count[axis];
  }
  int32_t* start = grid.start = scratch.take<int32_t>(grid.cells + 2);
  grid.member = scratch.take<int32_t>(n);
  int32_t *cell = scratch.take<int32_t>(n), *filled = scratch.take<int32_t>(grid.cells);
  if (scratch.overflowed) {
    grid.cells = grid.count[0] = grid.count[1] = grid.count[2] = 0;
    return grid;
  }
  for (int64_t c : each(grid.cells + 2)) start[c] = 0;
  if (grid.cells == 0) return grid;
  for (int64_t s : each(n)) {
    int64_t at[3];
    for (int axis = 0; axis < 3; ++axis) at[axis] = int64_t((points[width * s + axis] - grid.low[axis]) * per_m);
    cell[s] = int32_t((at[0] * grid.count[1] + at[1]) * grid.count[2] + at[2]);
    count_up(start + cell[s]);
  }
  sum_up(start, grid.cells);
  copy(filled, start, grid.cells);
  for (int64_t s : each(n)) grid.member[count_up(filled + cell[s])] = int32_t(s);
  for (int64_t c : each(grid.cells))
    for (int64_t i = start[c] + 1; i < start[c + 1]; ++i) {
      const int32_t own = grid.member[i];
      int64_t to = i;
      for (; to > start[c] && grid.member[to - 1] > own; --to) grid.member[to] = grid.member[to - 1];
      grid.member[to] = own;
    }
  return grid;
}
