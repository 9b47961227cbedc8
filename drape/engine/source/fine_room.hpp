// Room between sheets of the fine cloth, looked for where the coarse cloth is near itself.
//
// The planes and the untangling are those of room.hpp and untangle.hpp. What is searched is less: only places whose
// coarse vertex found other cloth within its reach. Two of them are of one sheet where their coarse vertices are, so
// that the fine cloth needs no lists of its own.
#pragma once
#include "grid.hpp"
#include "room.hpp"
#include "untangle.hpp"

// Returns whether the coarse place of a fine place lies near other cloth, as its planes say.
template <class T> INLINE bool lies_near(const T* planes, const FineLevel<T>& fine, int64_t place) {
  const int64_t c = fine.parent[place];
  return planes[PLANES * (c / LANES) + NEAR_ROW + c % LANES] > 0;
}

// Returns whether a triangle of the fine cloth's cluster c has a first corner that lies near other cloth.
template <class T> INLINE bool is_close(const T* planes, const FineLevel<T>& fine, int64_t c) {
  bool close = false;
  for (int lane = 0; lane < LANES; ++lane) close |= lies_near(planes, fine, fine.tangles.corner[3 * LANES * c + lane]);
  return close;
}

// Writes to found the fine cloth's clusters with such a triangle, and returns their number.
template <class T> DEVICE int64_t close_clusters(const T* planes, const FineLevel<T>& fine, int32_t* found) {
  const int64_t count = fine.tangles.start.count - 1;
  return collect(count, found, count, [&](int64_t c, int32_t* to, int64_t room) {
    const bool close = is_close(planes, fine, c);
    if (close && room > 0) *to = int32_t(c);
    return int64_t(close);
  });
}

// Writes the planes that keep the fine cloth x [m] (P, 3) apart from itself into the planes of other body parts.
template <class T>
DEVICE void keep_fine_apart(const T* x, const T* coarse_planes, const Levels<T>& levels, T* planes, Scratch& scratch) {
  const FineLevel<T>& fine = levels.fine;
  const int32_t *coarse_vertex = levels.coarse.sheet.vertex.begin, *parent = fine.parent.begin;
  const int64_t mark = scratch.used, places = fine.sheet.vertex.count;
  const Spacing<T> spacing(fine.sheet);
  T* points = scratch.take<T>(3 * places);
  int32_t* chosen = scratch.take<int32_t>(places);
  if (scratch.overflowed) return;
  const int64_t count = collect(places, chosen, places, [&](int64_t p, int32_t* to, int64_t room) {
    const bool near = lies_near(coarse_planes, fine, p);
    if (near && room > 0) *to = int32_t(p);
    return int64_t(near);
  });
  for (int64_t n : each(count)) put_point(points, n, point(x, chosen[n]));
  const Grid grid = grid_of(points, count, 3, 1 / double(spacing.reach), scratch);
  if (scratch.overflowed) return;
  for (int64_t n : each(count)) {
    const Vector<T> here = point(points, n);
    const int32_t v = coarse_vertex[parent[chosen[n]]];
    T square = spacing.reach * spacing.reach;
    int32_t nearest = -1;
    for_each_point(grid, cells_around(grid, here, double(spacing.reach)), [&](int64_t m) {
      const Vector<T> way = point(points, m) - here;
      const T far = dot(way, way);
      if (!(far < square) || is_near(levels.coarse.neighbours, v, coarse_vertex[parent[chosen[m]]], far)) return;
      square = far, nearest = chosen[m];
    });
    if (nearest >= 0) put_apart<T>(x, fine.sheet, chosen[n], nearest, spacing.kept, planes);
  }
  scratch.used = mark;
}
