// A distance to a posed body that has no steps: tangent planes of its skin, blended.
//
//     d(x) = sum w_i n_i . (x - b_i) / sum w_i,   w_i = exp(-|x - b_i|^2 / h^2)
//
// over points b_i of the skin with normals n_i: implicit moving least squares (Kolluri 2008, "Provably good moving
// least squares", ACM Trans. Algorithms 4(2)). As h falls it comes near to the plane of the nearest point.
#pragma once
#include "grid.hpp"
#include "numbers.hpp"
#include "physics.hpp"

namespace blended_planes {

using Point = Vector<double>;

constexpr double WIDTH_M = 0.006;  // h
constexpr double FADED = 14;       // exponent at which a weight counts as none: 1e-6 of the nearest one's
constexpr double CLEAR_M = 0.005;  // the most that a point which does not touch moves before it is looked at again

struct Skin { const double *point, *normal; int64_t count; };
// Of each point: where it was when its plane was blended last (V, 3), how far [m] from there the plane holds (V,), and
// whether no skin was within reach (V,).
struct Last { double *blended, *clear; uint8_t* beyond; };
struct Planes { double *point, *normal, *bend; };  // (V, 3), (V, 3), (V, 3, 3)
struct Weighted { int64_t point; double weight; };  // of the skin

// Writes new planes for those points x [m] (V, 3) that have left the distance within which their plane holds. The
// distance at a plane's point is that of the blended skin, the normal is its gradient, and bend has its second
// derivatives. A point with no skin within reach [m] keeps its plane and is marked. Contact begins at gap [m].
inline void blend(const double* x, int64_t count, Skin skin, double reach_m, double gap, Last last, Planes planes,
                  Scratch& scratch) {
  const Grid grid = grid_of(skin.point, skin.count, 3, 1 / reach_m, scratch);
  Weighted* blended = scratch.take<Weighted>(skin.count);
  if (scratch.overflowed) return;
  const double reach = reach_m * reach_m, sharp = 1 / (WIDTH_M * WIDTH_M), faded = FADED / sharp;
  const Point around = {reach_m, reach_m, reach_m};
  for (int64_t v = 0; v < count; ++v) {
    const Point own = point(x, v), moved = own - point(last.blended, v);
    last.beyond[v] = false;
    if (dot(moved, moved) < last.clear[v] * last.clear[v]) continue;
    put_point(last.blended, v, own);
    last.clear[v] = 0;
    physics::put_block(planes.bend + 9 * v, Symmetric<double>{});
    const Cells cells = cells_within(grid, own - around, own + around);
    double least = reach;
    for_each_point(grid, cells, [&](int64_t k) {
      const Point way = own - point(skin.point, k);
      least = less(dot(way, way), least);
    });
    if (!(least < reach)) {
      last.beyond[v] = true;
      continue;
    }
    // After a move by c the blended samples are nearer than wide, and so within reach, and no plane of theirs may be
    // met.
    const double most = less(least + faded, reach), near = root(least);
    const double c = less(CLEAR_M, more((reach - faded - least) / (2 * (near + reach_m)), 0.0));
    const double outer = root((near + c) * (near + c) + faded) + c, wide = outer * outer;
    double lowest = __builtin_inf(), total = 0, distance = 0;
    Point mean = {}, slope = {};
    int64_t filled = 0;
    for_each_point(grid, cells, [&](int64_t k) {
      const Point way = own - point(skin.point, k);
      const double square = dot(way, way), height = dot(way, point(skin.normal, k));
      if (square < most || square < wide) lowest = less(height, lowest);
      if (!(square < most)) return;
      const double weight = exponential_of((least - square) * sharp);
      blended[filled++] = {k, weight};
      total += weight;
      distance += weight * height;
      mean = plus(mean, weight, way);
    });
    distance /= total;
    mean = {mean.x / total, mean.y / total, mean.z / total};
    Symmetric<double> bend = {};
    for (int64_t i = 0; i < filled; ++i) {
      const Point way = own - point(skin.point, blended[i].point), normal = point(skin.normal, blended[i].point);
      // The derivative of log w_i less that of log sum w points to b_i from the mean of all b.
      const Point turn = scaled(2 * sharp, mean - way);
      const double over = dot(way, normal) - distance, weight = blended[i].weight / total;
      slope = plus(slope, weight, plus(normal, over, turn));
      bend = squares(bend, weight * over, weight, 0.0, turn, normal, 0.0);
    }
    // Where planes of several sides are blended, the distance falls faster than the way is long; each plane's own does
    // not.
    last.clear[v] = less(c, more(lowest - gap, 0.0));
    put_point(planes.point, v, plus(own, -distance / dot(slope, slope), slope));
    put_point(planes.normal, v, slope);
    physics::put_block(planes.bend + 9 * v, bend);
  }
}

}  // namespace blended_planes
