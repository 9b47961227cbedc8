// Walks over the samples of a skin, on which a vertex keeps to its own part of the body.
//
// A walk leads from the sample that the network's vertex had to the one that it has now, always on to the nearest
// neighbour, and the folded vertex goes a few steps from there, and more of them over skin that faces the same way: a
// waistband slides along a belly by 8 cm. A fold that once crossed an arm would otherwise stay on the far side. About a
// heel or an armpit a walk ends where no neighbour is nearer though others are.
#pragma once
#include "records.hpp"
#include "sweeps.hpp"

constexpr int NEIGHBOURS = 8;
constexpr int WALK_STEPS = 3;  // from the network's sample to the fold's: too few to reach the far side of an arm
constexpr int ALONG_STEPS = 16;  // and from there on over skin that faces as the network's sample does:
constexpr double ALONG = 0.5;    // the least cosine

// A posed skin and its graph.
template <class T> struct Skin {
  const T* samples;
  int64_t count;
  const int32_t* neighbour;  // (S, 8)
  const T *reach_m2, *rest;  // (S,), (S, 3)
  INLINE_MEMBER Vector<T> point_of(int64_t s) const { return point(samples + 8 * s, 0); }
  INLINE_MEMBER Vector<T> normal_of(int64_t s) const { return point(samples + 8 * s + 4, 0); }
};

template <class T> INLINE Skin<T> skin_of(const T* samples, int64_t count, const SkinGraph<T>& graph) {
  return {samples, count, graph.neighbour.begin, graph.reach_m2.begin, graph.rest.begin};
}
template <class T> INLINE Skin<T> skin_of(const Array<T>& samples, const SkinGraph<T>& graph) {
  return skin_of(samples.begin, samples.count / 8, graph);
}

// The walks of a row's lanes: in each a place and the sample that it is at, whose neighbours are near, a row each.
struct Walks { int32_t vertex[WIDTH], sample[WIDTH], near[NEIGHBOURS * WIDTH]; };

INLINE void look_around(Walks& walks, const int32_t* neighbour) {
  for (int k = 0; k < WIDTH; ++k)
    for (int n = 0; n < NEIGHBOURS; ++n) walks.near[WIDTH * n + k] = neighbour[NEIGHBOURS * walks.sample[k] + n];
}

template <class T> INLINE Row<T> squares_to(Points<T> points, const T* samples, const int32_t* held) {
  FourRows<T> s = samples_of(samples, held, 0);
  Points<T> way = Points<T>{s.a, s.b, s.c} - points;
  return dot(way, way);
}
template <class T> INLINE T square_to(Vector<T> point, const Skin<T>& skin, int64_t sample) {
  Vector<T> way = point - skin.point_of(sample);
  return dot(way, way);
}

// Moves the samples of all lanes on to those nearest to points, by at most so many steps. Returns the bits of the lanes
// whose sample moved in the last step.
template <class T> INLINE uint32_t walk(Points<T> points, Walks& walks, const Skin<T>& skin, int64_t steps) {
  Row<T> square = squares_to<T>(points, skin.samples, walks.sample);
  uint32_t last = 0;
  for (int64_t step = 0; step < steps; ++step) {
    look_around(walks, skin.neighbour);
    Mask<T> which = (Mask<T>)(-1);
#pragma clang loop unroll(disable)
    for (int n = 0; n < NEIGHBOURS; ++n) {
      Row<T> other = squares_to<T>(points, skin.samples, walks.near + WIDTH * n);
      which = square > other ? (Mask<T>)(n) : which;
      square = least<T>(square, other);
    }
    uint32_t moved = last = lanes_of<T>(which >= 0);
    if (!moved) break;
    for (; moved; moved &= moved - 1) {
      int k = first_lane(moved);
      walks.sample[k] = walks.near[WIDTH * number_in(which, k) + k];
    }
  }
  return last;
}

// Where a walk of one point ends, over samples that are allowed.
template <class T, class Allowed>
INLINE int32_t walked(Vector<T> point, const Skin<T>& skin, int32_t own, int steps, Allowed allowed) {
  T nearest = square_to(point, skin, own);
  for (int step = 0; step < steps; ++step) {
    const int32_t here = own;
    for (int n = 0; n < NEIGHBOURS; ++n) {
      const int32_t other = skin.neighbour[NEIGHBOURS * here + n];
      const T square = square_to(point, skin, other);
      if (square < nearest && allowed(other)) nearest = square, own = other;
    }
    if (own == here) break;
  }
  return own;
}
template <class T> INLINE int32_t walked(Vector<T> point, const Skin<T>& skin, int32_t own, int steps) {
  return walked(point, skin, own, steps, [](int32_t) { return true; });
}

// Where a walk of one point goes on from a sample, over samples that face as the one with this normal does.
template <class T> INLINE int32_t walked_along(Vector<T> point, const Skin<T>& skin, int32_t own, Vector<T> normal) {
  return walked(point, skin, own, ALONG_STEPS,
                [&](int32_t other) { return dot(skin.normal_of(other), normal) > T(ALONG); });
}

// Moves the samples own (P,) on to those nearest to the points x [m] (P, 3); P is a multiple of LANES.
template <class T> DEVICE void follow(const T* x, int64_t places, const Skin<T>& skin, int32_t* own) {
  Walks walks;
  for (int64_t block : each_block((places + LANES - 1) / LANES)) {
    const int64_t first = LANES * block, lanes = places - first < LANES ? places - first : LANES;
    Points<T> points;
    if (lanes == LANES) {
      points = points_in(x + 3 * first);
    } else {  // nodes of swing do not fill their last row: it repeats the last one
      for (int k = 0; k < WIDTH; ++k) {
        Vector<T> p = point(x, first + less<int64_t>(lane_of(k), lanes - 1));
        set_number(points.x, k, p.x), set_number(points.y, k, p.y), set_number(points.z, k, p.z);
      }
    }
    for (int k = 0; k < WIDTH; ++k) walks.sample[k] = own[first + less<int64_t>(lane_of(k), lanes - 1)];
    walk(points, walks, skin, skin.count);
    for (int k = 0; k < WIDTH; ++k)
      if (lane_of(k) < lanes) own[first + lane_of(k)] = walks.sample[k];
  }
}
