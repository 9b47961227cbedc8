// What lies within a way over the edges of a graph, from each of its vertices: by relaxing, since the lists are short.
#pragma once
#include "arrays.hpp"

// Finds for each vertex those within most [m] along edges. Edges of vertex v are other[start[v]] to other[start[v +
// 1]], with their lengths [m]. Writes where each vertex's list begins, begins (V + 1,), the vertices of the lists,
// itself first, and the ways there [m]; the ends of its own edges count however long these are. Returns the number of
// entries; those for which there is no room are left out.
INLINE int64_t reached(const int32_t* start, const int32_t* other, const double* length, int64_t count, double most,
                       int32_t* begins, int32_t* found, double* ways, int64_t room, Scratch& scratch) {
  double* way = scratch.take<double>(count);
  int32_t* listed = scratch.take<int32_t>(count);
  if (scratch.overflowed) return -1;
  for (int64_t v = 0; v < count; ++v) way[v] = __builtin_inf();
  int64_t total = begins[0] = 0;
  for (int64_t v = 0; v < count; ++v) {
    int64_t filled = 1;
    way[v] = 0, listed[0] = int32_t(v);
    for (bool changed = true; changed;) {
      changed = false;
      for (int64_t i = 0; i < filled; ++i) {
        const int32_t here = listed[i];
        for (int64_t e = start[here]; e < start[here + 1]; ++e) {
          const int32_t u = other[e];
          const double far = way[here] + length[e];
          if (!(far < way[u] && (far <= most || here == v))) continue;
          if (way[u] == __builtin_inf()) listed[filled++] = u;
          way[u] = far, changed = true;
        }
      }
    }
    for (int64_t i = 0; i < filled; ++i, ++total) {
      if (total < room) found[total] = listed[i], ways[total] = way[listed[i]];
      way[listed[i]] = __builtin_inf();
    }
    begins[v + 1] = int32_t(total);
  }
  return total;
}
