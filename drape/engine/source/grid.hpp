// Points in a grid of cubes: which of them may lie within a box is known without looking at the others.
#pragma once
#include "arrays.hpp"
#include "rows.hpp"

constexpr double WIDEST_M = 10.0;  // points farther apart than that, along an axis, are in no cell

// A grid of count cells along each axis, per_m a metre, from the corner low [m] on. The points of cell c are
// member[start[c]] to member[start[c + 1]], in their order; c = (i count[1] + j) count[2] + k.
struct Grid {
  int32_t *start, *member;
  double low[3], per_m;
  int64_t count[3], cells;
};

struct Cells { int64_t first[3], last[3]; };  // along each axis the first cell, and the one behind the last

#ifdef ONE_LANE
#include "grid_one.hpp"
#else
// Returns a grid of the points [m] (N, width), of whose numbers the first three are coordinates, with cells of 1 /
// per_m. It is empty if a coordinate is not finite, or if points lie WIDEST_M apart.
template <class T> DEVICE Grid grid_of(const T* points, int64_t n, int width, double per_m, Scratch& scratch) {
  Grid grid = {};
  T low[3], high[3];
  bool finite = n > 0;
  for (int axis = 0; axis < 3 && n > 0; ++axis) low[axis] = high[axis] = points[axis];
  for (int64_t s = 0; s < n; ++s)
    for (int axis = 0; axis < 3; ++axis) {
      T own = points[width * s + axis];
      low[axis] = own < low[axis] ? own : low[axis];
      high[axis] = own > high[axis] ? own : high[axis];
      finite &= own - own == 0;
    }
  grid.per_m = per_m;
  grid.cells = 1;
  for (int axis = 0; axis < 3; ++axis) {
    double extent = finite ? double(high[axis]) - double(low[axis]) : 0;
    grid.low[axis] = finite ? double(low[axis]) : 0;
    grid.count[axis] = finite && extent < WIDEST_M ? int64_t(extent * per_m) + 1 : 0;
    grid.cells *= grid.count[axis];
  }
  // There are two cells more than the grid has: a cell's count stands two behind it, then its begin one behind it.
  int32_t* start = grid.start = scratch.take<int32_t>(grid.cells + 2);
  grid.member = scratch.take<int32_t>(n);
  int32_t* cell = scratch.take<int32_t>(n);
  if (scratch.overflowed) {
    grid.cells = grid.count[0] = grid.count[1] = grid.count[2] = 0;
    return grid;
  }
  for (int64_t c = 0; c < grid.cells + 2; ++c) start[c] = 0;
  if (grid.cells == 0) return grid;
  for (int64_t s = 0; s < n; ++s) {
    int64_t at[3];
    for (int axis = 0; axis < 3; ++axis) at[axis] = int64_t((points[width * s + axis] - grid.low[axis]) * per_m);
    cell[s] = int32_t((at[0] * grid.count[1] + at[1]) * grid.count[2] + at[2]);
    start[cell[s] + 2] += 1;
  }
  for (int64_t c = 1; c < grid.cells; ++c) start[c + 1] += start[c];
  for (int64_t s = 0; s < n; ++s) grid.member[start[cell[s] + 1]++] = int32_t(s);
  return grid;
}

#endif

// Returns the cells that the box from low to high [m] meets.
INLINE Cells cells_within(const Grid& grid, Vector<double> low, Vector<double> high) {
  const double lower[3] = {low.x, low.y, low.z}, higher[3] = {high.x, high.y, high.z};
  Cells cells;
  for (int axis = 0; axis < 3; ++axis) {
    // The number is clamped before it is rounded, since a point may be anywhere, or be NaN.
    double count = double(grid.count[axis]);
    double first = __builtin_floor((lower[axis] - grid.low[axis]) * grid.per_m);
    double last = __builtin_floor((higher[axis] - grid.low[axis]) * grid.per_m) + 1;
    cells.first[axis] = int64_t(first > 0 ? (first < count ? first : count) : 0);
    cells.last[axis] = int64_t(last > 0 ? (last < count ? last : count) : 0);
  }
  return cells;
}

// Returns the cells that a box around a point meets whose half side is reach [m].
template <class T> INLINE Cells cells_around(const Grid& grid, Vector<T> point, double reach) {
  const Vector<double> at = {double(point.x), double(point.y), double(point.z)}, aside = {reach, reach, reach};
  return cells_within(grid, at - aside, at + aside);
}

// The points of the cells (i, j) of a column: begin and end in grid.member.
struct Run { int64_t begin, end; };
INLINE Run column(const Grid& grid, int64_t i, int64_t j, const Cells& cells) {
  int64_t row = (i * grid.count[1] + j) * grid.count[2], first = cells.first[2];
  int64_t last = cells.last[2] > first ? cells.last[2] : first;
  return {grid.start[row + first], grid.start[row + last]};
}

// Calls see(n) for every point n in the cells.
template <class See> INLINE void for_each_point(const Grid& grid, const Cells& cells, See see) {
  for (int64_t i = cells.first[0]; i < cells.last[0]; ++i)
    for (int64_t j = cells.first[1]; j < cells.last[1]; ++j) {
      const Run run = column(grid, i, j, cells);
      for (int64_t entry = run.begin; entry < run.end; ++entry) see(int64_t(grid.member[entry]));
    }
}
