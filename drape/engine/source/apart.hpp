// Cloth that may not pass through itself: the barrier between pairs of it, and how much of a step goes.
//
// A vertex and a triangle, or two edges, that share no corner and are nearer than r push each other off by the barrier
// of incremental potential contact (Li et al. 2020, "Incremental Potential Contact", ACM TOG 39(4))
//
//     b(d) = -k (d - r)^2 ln(d / r).
//
// A step is shortened so that no pair meets on its way (additive continuous detection: Li, Kaufman and Jiang 2021,
// "Codimensional Incremental Potential Contact", ACM TOG 40(4)); before that it yields (Harmon et al. 2008, "Robust
// treatment of simultaneous collisions", ACM TOG 27(3), with velocities).
#pragma once
#include "numbers.hpp"
#include "pairs.hpp"
#include "physics.hpp"

namespace apart {

using pairs::Pairs;
using pairs::Point;
using pairs::Way;

// The share of a pair's distance that a step leaves at least; below the floor more of it, or many steps one after the
// other would come to the last digits of a number. Near to what it leaves the search ends.
constexpr double KEPT = 0.2, LATE = 0.9, FLOOR_M = 1e-4, NEARLY = 1.01;
constexpr int SWEEPS = 40;           // over the pairs, of a step that yields
constexpr double SLIGHT_M = 1e-7;    // a lack that counts as none
constexpr double TOUCHING_M = 1e-9;  // nearer ones count as so far apart

struct Barrier { double r, k; };  // its reach [m] and stiffness [N/m]
struct Felt { double energy, slope, curvature; };  // [J, N, N/m]

INLINE Felt felt_at(double d, Barrier barrier) {
  const double off = d - barrier.r, log = logarithm_of(d / barrier.r), k = barrier.k;
  if (!(off < 0)) return {0, 0, 0};
  const double energy = -k * off * off * log, slope = -k * (2 * off * log + off * off / d);
  return {energy, slope, -k * (2 * log + 4 * off / d - off * off / (d * d))};
}

// Returns the barrier's energy [J] at x [m] (V, 3), and adds its gradient [N] (V, 3).
inline double push_apart(const double* x, Pairs pairs, Barrier barrier, double* gradient) {
  double total = 0;
  for (int64_t n = 0; n < pairs.count; ++n) {
    const Way found = pairs::way_of(x, pairs, n);
    const double d = more(root(dot(found.way, found.way)), TOUCHING_M);
    if (!(d < barrier.r)) continue;
    const Felt felt = felt_at(d, barrier);
    total += felt.energy;
    for (int c = 0; c < 4; ++c)
      add_point(gradient, pairs.corner[4 * n + c], scaled(felt.slope * found.weight[c] / d, found.way));
  }
  return total;
}

// Adds the positive part of the barrier's Hessian [N/m] to blocks (N, 3, 3). place (pairs, 4, 4) are the blocks of each
// pair's corners.
inline void add_curvature(const double* x, Pairs pairs, Barrier barrier, const int32_t* place, double* blocks) {
  for (int64_t n = 0; n < pairs.count; ++n) {
    const Way found = pairs::way_of(x, pairs, n);
    const double d = more(root(dot(found.way, found.way)), TOUCHING_M), curvature = felt_at(d, barrier).curvature;
    for (int a = 0; a < 4; ++a)
      for (int b = 0; b < 4; ++b)
        physics::add_product(blocks + 9 * int64_t(place[16 * n + 4 * a + b]),
                             scaled(curvature * found.weight[a] * found.weight[b] / (d * d), found.way), found.way);
  }
}

// Writes to share (V,) which part of its step [m] (V, 3) each vertex may go, at most 1. If all vertices go the least
// part, every pair keeps at least KEPT of its distance all the way.
inline void free_shares(const double* x, int64_t count, const double* step, Pairs pairs, double* share) {
  for (int64_t v = 0; v < count; ++v) share[v] = 1;
  for (int64_t n = 0; n < pairs.count; ++n) {
    const int32_t* corner = pairs.corner + 4 * n;
    Point from[4], way[4], mean = {};
    for (int c = 0; c < 4; ++c) from[c] = point(x, corner[c]), way[c] = point(step, corner[c]), mean = mean + way[c];
    mean = scaled(0.25, mean);
    double most[2] = {0, 0};  // of either element, the fastest corner against the mean
    for (int c = 0; c < 4; ++c) {
      const Point against = way[c] - mean;
      double& own = most[c >= (n < pairs.triangles ? 1 : 2)];
      own = more(own, dot(against, against));
    }
    const double pace = root(most[0]) + root(most[1]);
    if (!(pace > 0)) continue;
    double gone = 0, kept = 0;
    while (gone < 1) {
      const Point here[4] = {plus(from[0], gone, way[0]), plus(from[1], gone, way[1]), plus(from[2], gone, way[2]),
                             plus(from[3], gone, way[3])};
      const Way found = pairs::way_between(here, n < pairs.triangles);
      const double d = root(dot(found.way, found.way));
      if (gone == 0) kept = more(KEPT * d, less(LATE * d, FLOOR_M));
      if (d < NEARLY * kept || !(d > 0)) break;
      gone += (d - kept) / pace;
    }
    for (int c = 0; c < 4; ++c) share[corner[c]] = less(gone, share[corner[c]]);
  }
}

// Changes step [m] (V, 3) until, to first order, every pair keeps KEPT of its distance, and pairs nearer than near [m]
// come apart by gain [m]: projections onto one pair after the other.
inline void yield_to(const double* x, double* step, Pairs pairs, double near, double gain, Scratch& scratch) {
  Way* ways = scratch.take<Way>(pairs.count);
  double* least = scratch.take<double>(pairs.count);
  if (scratch.overflowed) return;
  for (int64_t n = 0; n < pairs.count; ++n) {
    ways[n] = pairs::way_of(x, pairs, n);
    const double d = more(root(dot(ways[n].way, ways[n].way)), 1e-12);
    ways[n].way = scaled(1 / d, ways[n].way);
    least[n] = more(KEPT * d, less(near, d + gain)) - d;
  }
  bool enough = false;
  for (int sweep = 0; sweep < SWEEPS && !enough; ++sweep) {
    enough = true;
    for (int64_t n = 0; n < pairs.count; ++n) {
      const int32_t* corner = pairs.corner + 4 * n;
      const double* weight = ways[n].weight;
      double gained = 0, size = 0;
      for (int c = 0; c < 4; ++c) {
        size += weight[c] * weight[c];
        gained += weight[c] * dot(ways[n].way, point(step, corner[c]));
      }
      const double lack = least[n] - gained;
      if (!(lack > SLIGHT_M)) continue;
      enough = false;
      for (int c = 0; c < 4; ++c) add_point(step, corner[c], scaled(lack / size * weight[c], ways[n].way));
    }
  }
}

}  // namespace apart
