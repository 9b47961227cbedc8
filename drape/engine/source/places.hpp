// Vertices in the order of their mesh and at the places where a sheet has them, and how far they are from others.
#pragma once
#include "clusters.hpp"

// Writes to places [m] (P, 3) the vertices [m] (V, 3) at them; vertex (P,) is that of each.
template <class T> DEVICE void placed(const T* vertices, const Array<int32_t>& vertex, T* places) {
  for (int64_t p : each(vertex.count)) put_point(places, p, point(vertices, vertex[p]));
}

// Returns the largest distance [m] between a place of x (P, 3) and the same one of y, NaN where one is NaN.
template <class T> DEVICE T farthest_m(const T* x, const T* y, int64_t places) {
  Row<T> worst = row_of(T(0)), total = worst;
  for (int64_t block : each_block((places + LANES - 1) / LANES)) {
    const int64_t first = 3 * LANES * block;
    Points<T> way = points_in(x + first) - points_in(y + first);
    Row<T> square = dot(way, way);
    worst = most<T>(square, worst);
    total = total + square;
  }
  const bool none = most_of_all(int(lanes_of<T>(total != total)));
  return none ? T(__builtin_nan("")) : root(most_of_all(most_lane<T>(worst)));
}

// Returns the RMS way [m] of the vertices from before to network [m] (P, 3); place (V,) is where each vertex is in
// these.
template <class T> DEVICE double moved_m(const T* before, const T* network, const Array<int32_t>& place) {
  double total = 0;
  for (int64_t v : each(place.count)) {
    const Vector<T> way = point(network, place[v]) - point(before, place[v]);
    total += double(dot(way, way));
  }
  return root(sum_of_all(total) / double(place.count));
}
