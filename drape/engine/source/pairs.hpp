// Pairs of a vertex and a triangle, of two edges, or of two triangles: which are near, and how far apart.
#pragma once
#include "grid.hpp"
#include "triangle.hpp"

namespace pairs {

using Point = Vector<double>;

constexpr double PARALLEL = 1e-9;  // of the squared lengths' product: less is between edges side by side
constexpr double TINY_M2 = 1e-30;
constexpr double MOST_CELLS = 128;  // of the grid along the mesh: bounds the memory
constexpr double ROUNDED = 1e-9;    // of the mesh's extent: what a place in the grid may be off by rounding

struct Places { const double* x; int64_t count; };  // [m] (count, 3)
struct Elements { const int32_t* vertex; int64_t count, width; };  // of width vertices each
struct Box { Point low, high; };

INLINE void widen(Box& box, Point p) {
  box.low = {less(box.low.x, p.x), less(box.low.y, p.y), less(box.low.z, p.z)};
  box.high = {more(box.high.x, p.x), more(box.high.y, p.y), more(box.high.z, p.z)};
}
INLINE double widest(Box box) {
  const Point size = box.high - box.low;
  return more(more(size.x, size.y), size.z);
}
INLINE Box box_around(const double* x, const Elements& elements, int64_t n) {
  const int32_t* vertex = elements.vertex + elements.width * n;
  Box box = {point(x, vertex[0]), point(x, vertex[0])};
  for (int64_t c = 1; c < elements.width; ++c) widen(box, point(x, vertex[c]));
  return box;
}
INLINE bool are_far(Box a, Box b, double reach) {  // along an axis
  return b.low.x > a.high.x + reach || b.low.y > a.high.y + reach || b.low.z > a.high.z + reach ||
         b.high.x < a.low.x - reach || b.high.y < a.low.y - reach || b.high.z < a.low.z - reach;
}
INLINE bool are_joined(const Elements& first, int64_t e, const Elements& second, int64_t f) {
  for (int64_t n = 0; n < first.width; ++n)
    for (int64_t m = 0; m < second.width; ++m)
      if (first.vertex[first.width * e + n] == second.vertex[second.width * f + m]) return true;
  return false;
}

// Writes to found (room, 2) the pairs of elements that share no vertex and whose boxes are at most reach [m] apart
// along every axis. With same each pair comes once, the lower number first. Returns the number of pairs, which may be
// more than room.
inline int64_t near_boxes(Places places, Elements first, Elements second, bool same, double reach, int32_t* found,
                          int64_t room, Scratch& scratch) {
  Box* boxes = scratch.take<Box>(second.count);
  double* middles = scratch.take<double>(3 * second.count);
  if (scratch.overflowed) return -1;
  Box all = {point(places.x, 0), point(places.x, 0)};
  for (int64_t v = 1; v < places.count; ++v) widen(all, point(places.x, v));
  // The grid's unit is the extent of the mesh, whatever that is.
  const double unit = widest(all) > 0 ? 1 / widest(all) : 1;
  double size = 0;
  for (int64_t f = 0; f < second.count; ++f) {
    boxes[f] = box_around(places.x, second, f);
    size = more(widest(boxes[f]), size);
    put_point(middles, f, scaled(unit, scaled(0.5, boxes[f].low + boxes[f].high) - all.low));
  }
  const double cell = more((reach + size) * unit, 1 / MOST_CELLS), half = (0.5 * size + reach) * unit + ROUNDED;
  const Grid grid = grid_of(middles, second.count, 3, 1 / cell, scratch);
  if (scratch.overflowed) return -1;
  const Point aside = {half, half, half};
  int64_t filled = 0;
  for (int64_t e = 0; e < first.count; ++e) {
    const Box own = box_around(places.x, first, e);
    const Point low = scaled(unit, own.low - all.low) - aside, high = scaled(unit, own.high - all.low) + aside;
    for_each_point(grid, cells_within(grid, low, high), [&](int64_t f) {
      if ((same && f <= e) || are_far(own, boxes[f], reach) || are_joined(first, e, second, f)) return;
      if (filled < room) found[2 * filled] = int32_t(e), found[2 * filled + 1] = int32_t(f);
      ++filled;
    });
  }
  return filled;
}

// Pairs by their four vertices, corner (count, 4): in the first triangles rows a vertex and those of a triangle, in the
// others those of two edges.
struct Pairs { const int32_t* corner; int64_t count, triangles; };

// The way [m] between the nearest points of a pair, and the weights of the four corners in it.
struct Way {
  double weight[4];
  Point way;
};

INLINE double share_of(double a) { return less(more(a, 0.0), 1.0); }

// Where on the edges pq and rs, 0 to 1, the two points lie that are nearest to each other (Ericson 2005, 5.1.9). For
// parallel edges it is the middle of the first, if the second reaches so far.
struct Shares { double first, second; };
INLINE Shares shares_of_edges(Point p, Point q, Point r, Point s) {
  const Point first = q - p, second = s - r, between = p - r;
  const double a = more(dot(first, first), TINY_M2), e = more(dot(second, second), TINY_M2), f = dot(second, between);
  const double b = dot(first, second), c = dot(first, between), size = a * e - b * b;
  const double t = size > PARALLEL * a * e ? share_of((b * f - c * e) / size) : 0.5, u = (b * t + f) / e;
  return u < 0 ? Shares{share_of(-c / a), 0} : u > 1 ? Shares{share_of((b - c) / a), 1} : Shares{t, u};
}

INLINE Way way_between(const Point (&p)[4], bool by_triangle) {
  Way found;
  double (&w)[4] = found.weight;
  if (by_triangle) {
    const Point nearest = weights_in_triangle(p[0], p[1], p[2], p[3]);
    w[0] = 1, w[1] = -nearest.x, w[2] = -nearest.y, w[3] = -nearest.z;
  } else {
    const Shares along = shares_of_edges(p[0], p[1], p[2], p[3]);
    w[0] = 1 - along.first, w[1] = along.first, w[2] = along.second - 1, w[3] = -along.second;
  }
  found.way = plus(plus(mix(w[0], p[0], w[1], p[1]), w[2], p[2]), w[3], p[3]);
  return found;
}

INLINE Way way_of(const double* x, const Pairs& pairs, int64_t n) {
  const int32_t* corner = pairs.corner + 4 * n;
  const Point place[4] = {point(x, corner[0]), point(x, corner[1]), point(x, corner[2]), point(x, corner[3])};
  return way_between(place, n < pairs.triangles);
}

// Writes the weights (N, 4) and the ways [m] (N, 3) of all pairs.
inline void write_ways(const double* x, Pairs pairs, double* weights, double* ways) {
  for (int64_t n = 0; n < pairs.count; ++n) {
    const Way found = way_of(x, pairs, n);
    for (int c = 0; c < 4; ++c) weights[4 * n + c] = found.weight[c];
    put_point(ways, n, found.way);
  }
}

}  // namespace pairs
