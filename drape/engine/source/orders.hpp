// Orders of vertices and of columns, made once per garment.
#pragma once
#include "rows.hpp"

namespace orders {

// The neighbours of vertex v are neighbour[start[v] : start[v + 1]], itself allowed.
struct Graph { const int32_t *start, *neighbour; };

// Writes the colour (V,) of each vertex: the least that no earlier neighbour has.
inline void greedy_colours(Graph graph, int64_t count, int32_t* colour, Scratch& scratch) {
  int32_t* taken = scratch.take<int32_t>(count + 1);  // the last vertex that a colour was taken for
  if (scratch.overflowed) return;
  for (int64_t v = 0; v < count; ++v) colour[v] = taken[v] = -1;
  taken[count] = -1;
  for (int32_t v = 0; v < count; ++v) {
    for (int32_t n = graph.start[v]; n < graph.start[v + 1]; ++n)
      if (colour[graph.neighbour[n]] >= 0) taken[colour[graph.neighbour[n]]] = v;
    int32_t least = 0;
    while (taken[least] == v) ++least;
    colour[v] = least;
  }
}

// Writes to line those of the nodes (n,), one part of the graph, that are connected with the node first, the nearest
// first, and their distance (V,) in edges, -1 for the others. Returns how many are connected.
inline int64_t by_distance(Graph graph, const int32_t* part, const int32_t* nodes, int64_t count, int32_t first,
                           int32_t* distance, int32_t* line) {
  for (int64_t n = 0; n < count; ++n) distance[nodes[n]] = -1;
  line[0] = first;
  distance[first] = 0;
  int64_t found = 1;
  for (int64_t here = 0; here < found; ++here) {
    const int32_t v = line[here];
    for (int32_t n = graph.start[v]; n < graph.start[v + 1]; ++n) {
      const int32_t w = graph.neighbour[n];
      if (part[w] != part[first] || distance[w] >= 0) continue;
      distance[w] = distance[v] + 1;
      line[found++] = w;
    }
  }
  return found;
}

// Writes to near which of the nodes (n,) have a neighbour whose part has the other sign.
inline void at_the_other(Graph graph, const int32_t* part, const int32_t* nodes, int64_t count, uint8_t* near) {
  for (int64_t i = 0; i < count; ++i) {
    const int32_t v = nodes[i];
    near[i] = 0;
    for (int32_t n = graph.start[v]; n < graph.start[v + 1]; ++n) near[i] |= part[graph.neighbour[n]] == -part[v];
  }
}

// The cycles, roughly, that a run of columns takes: for each row of LANES entries of a column, for each column, for
// each row of members, and for the run itself.
struct Costs { double row, column, members, run; };

// Splits the columns of a lower triangle into runs that together take the least time. Writes to begin (V + 1,), for
// each end of a run, where the last run up to that end begins. A run has at most widest columns. Column j has the rows
// neighbour[start[j] : start[j + 1]] below its diagonal.
inline void runs(Graph lower, int64_t count, int64_t widest, Costs costs, int32_t* begin, Scratch& scratch) {
  double* least = scratch.take<double>(count + 1);
  int32_t* met = scratch.take<int32_t>(count);  // the last run below whose columns there was this row
  if (scratch.overflowed) return;
  for (int64_t j = 0; j < count; ++j) least[j + 1] = __builtin_inf(), met[j] = -1;
  least[0] = 0;
  begin[0] = 0;
  for (int32_t first = 0; first < count; ++first) {
    int64_t below = 0;
    for (int64_t j = first; j < first + widest && j < count; ++j) {
      below -= met[j] == first;  // it was below the run's columns, and is one now
      for (int32_t n = lower.start[j]; n < lower.start[j + 1]; ++n) {
        below += met[lower.neighbour[n]] != first;
        met[lower.neighbour[n]] = first;
      }
      const int64_t width = j + 1 - first, rows = (width + below + LANES - 1) / LANES;
      const double cost = least[first] + costs.run + double(width) * costs.column +
                          double(rows) * (costs.members + double(width) * costs.row);
      if (cost < least[j + 1]) least[j + 1] = cost, begin[j + 1] = first;
    }
  }
}

}  // namespace orders
