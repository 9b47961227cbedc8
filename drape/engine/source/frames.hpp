// Frames of the network's surface. A fold is stored in them, so that it turns with the surface.
#pragma once
#include "elements.hpp"

constexpr int COVER = 9 * LANES;  // behind normal, edge and their product, three rows each: the share of the rest area
constexpr int FRAMES = COVER + LANES;  // numbers of a block

template <class T> struct AxesOf { Points<T> n, e, b; };  // normal, edge, and their product

template <class T> INLINE Points<T> to_frame(const AxesOf<T>& f, Points<T> a) {
  return {dot(f.n, a), dot(f.e, a), dot(f.b, a)};
}
template <class T> INLINE Points<T> to_world(const AxesOf<T>& f, Points<T> a) {
  return plus(plus(scaled(a.x, f.n), a.y, f.e), a.z, f.b);
}
template <class T> INLINE AxesOf<T> axes_in(const T* block) {
  return {rows3_at(block), rows3_at(block + 3 * LANES), rows3_at(block + 6 * LANES)};
}

// Returns for each lane 1 where this row has a neighbour, and 0 where it is empty and has the place itself.
template <class T> INLINE Row<T> real_row(const Sheet<T>& sheet, int64_t block, int64_t row) {
  const Indices places = indices_from(LANES * block), index = indices_at(sheet.fan_other + LANES * row);
  return where<T>(differ<T>(index, places), row_of(T(1)), row_of(T(0)));
}

template <class T> INLINE Points<T> unit_or_none(Points<T> a) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Row<T> square = dot(a, a);
  return scaled(where<T>(square > zero, one / root<T>(where<T>(square > zero, square, one)), zero), a);
}

// Writes the frames of surface [m] (P, 3): normal, edge and their product, nine rows a block. A tenth row has the area
// of the triangles around each vertex over their area at rest. The edge is the first one of the vertex's first
// triangle, laid into the tangent plane; a sheet puts that triangle first whose edge is longest at rest. A vertex
// without an area or an edge gets a frame of zeros.
template <class T> DEVICE void surface_frames(const T* surface, const Sheet<T>& sheet, T* frames) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  for (int64_t block : each_block(sheet.fan_start.count - 1)) {
    Points<T> own = points_in(surface + 3 * LANES * block), normal = {zero, zero, zero}, edge = normal;
    Row<T> twice = zero, rest = zero;
    for (int64_t row = sheet.fan_start[block]; row < sheet.fan_start[block + 1]; ++row) {
      Points<T> first = points_at(surface, sheet.fan_other + 2 * LANES * row) - own;
      Points<T> second = points_at(surface, sheet.fan_other + 2 * LANES * row + LANES) - own;
      Points<T> across = cross(first, second);
      normal = normal + across;
      twice = twice + root<T>(dot(across, across));
      rest = rest + row_at(sheet.fan_slope + 5 * LANES * row + 4 * LANES);
      if (row == sheet.fan_start[block]) edge = first;
    }
    T* to = frames + FRAMES * block;
    normal = unit_or_none<T>(normal);
    edge = unit_or_none<T>(plus(edge, -dot(edge, normal), normal));
    put3(to, normal);
    put3(to + 3 * LANES, edge);
    put3(to + 6 * LANES, cross(normal, edge));
    put(to + COVER, T(0.5) * twice / where<T>(rest > zero, rest, one));
  }
}
