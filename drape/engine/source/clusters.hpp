// Clusters of sixteen vertices or triangles side by side on the cloth, and boxes around them that tell which may come
// near each other.
//
// Clusters follow from the cloth alone and are the same in every frame. A group is sixteen clusters in a row; the boxes
// around groups rule out most clusters at once. Boxes lie sixteen in six rows, least and most corner. Rounding is
// monotone, so that two points are never nearer to each other than their boxes.
#pragma once
#include "arrays.hpp"
#include "rows.hpp"

constexpr int POINT_ROWS = 3 * LANES, BOX_ROWS = 6 * LANES;  // numbers of a cluster's points, and of sixteen boxes
constexpr double TINY = 1e-30;

template <class T> struct Boxes {
  T *of, *groups;
  int64_t count, group_blocks;  // of clusters, and of blocks of sixteen groups
};

INLINE int64_t whole_blocks(int64_t count) { return (count + LANES - 1) / LANES; }

// Returns the least, and below the largest, of a row's lanes; NaN where the first lane is one.
template <class T> INLINE T least_lane(Row<T> a) {
  T found = number_in(a, 0);
  for (int k = 1; k < WIDTH; ++k) found = less<T>(number_in(a, k), found);
  return found;
}
template <class T> INLINE T most_lane(Row<T> a) {
  T found = number_in(a, 0);
  for (int k = 1; k < WIDTH; ++k) found = more<T>(number_in(a, k), found);
  return found;
}

// The same of sixteen numbers in memory.
#ifdef ONE_LANE
template <class T> INLINE T least_in(const T* row) {
  T found = row[0];
  for (int lane = 1; lane < LANES; ++lane) found = less<T>(row[lane], found);
  return found;
}
template <class T> INLINE T most_in(const T* row) {
  T found = row[0];
  for (int lane = 1; lane < LANES; ++lane) found = more<T>(row[lane], found);
  return found;
}
#else
template <class T> INLINE T least_in(const T* row) { return least_lane<T>(row_at(row)); }
template <class T> INLINE T most_in(const T* row) { return most_lane<T>(row_at(row)); }
#endif

template <class T> INLINE void enclose(const T* low, const T* high, T* boxes, int64_t c) {
  T* to = boxes + BOX_ROWS * (c / LANES) + c % LANES;
#pragma clang loop unroll(full)
  for (int axis = 0; axis < 3; ++axis) {
    to[LANES * axis] = least_in(low + LANES * axis);
    to[LANES * (3 + axis)] = most_in(high + LANES * axis);
  }
}

// Returns boxes that fill up the last rows: they are far from everything.
template <class T> INLINE T* no_boxes(int64_t blocks, Scratch& scratch) {
  T* boxes = scratch.take<T>(BOX_ROWS * blocks);
  if (scratch.overflowed) return boxes;
  for (int64_t block : each_block(blocks))
    for (int row = 0; row < 6; ++row)
      put(boxes + BOX_ROWS * block + LANES * row, T(row < 3 ? __builtin_inf() : -__builtin_inf()));
  return boxes;
}

// Returns the boxes [m] around count clusters, each of size rows, and around groups of clusters. Three rows from low on
// have the least coordinates of a cluster's members, and three from high on the largest.
template <class T>
DEVICE Boxes<T> boxes_around(const T* rows, int64_t count, int size, int low, int high, Scratch& scratch) {
  const int64_t groups = whole_blocks(count), blocks = whole_blocks(groups);
  Boxes<T> boxes = {no_boxes<T>(groups, scratch), no_boxes<T>(blocks, scratch), count, blocks};
  if (scratch.overflowed) return boxes;
  for (int64_t c : each(count)) enclose(rows + size * c + low, rows + size * c + high, boxes.of, c);
  for (int64_t g : each(groups))
    enclose(boxes.of + BOX_ROWS * g, boxes.of + BOX_ROWS * g + POINT_ROWS, boxes.groups, g);
  return boxes;
}

#ifndef ONE_LANE
// Returns the bits of those of sixteen boxes that lie within the root of reach [m^2] of the box from low to high.
template <class T> INLINE uint32_t hits(Vector<T> low, Vector<T> high, const T* boxes, T reach) {
  Points<T> lowest = rows3_at(boxes), highest = rows3_at(boxes + 3 * LANES);
  const Row<T> zero = row_of(T(0));
  Row<T> x = most<T>(most<T>(lowest.x - high.x, low.x - highest.x), zero);
  Row<T> y = most<T>(most<T>(lowest.y - high.y, low.y - highest.y), zero);
  Row<T> z = most<T>(most<T>(lowest.z - high.z, low.z - highest.z), zero);
  return lanes_of<T>(row_of(reach) > x * x + y * y + z * z);
}

// Writes to found the clusters from a on whose box lies within the root of reach [m^2] of the box of a, and returns
// their number.
template <class T> INLINE int64_t find_close(int64_t a, const Boxes<T>& boxes, T reach, int32_t* found) {
  const T* own = boxes.of + BOX_ROWS * (a / LANES) + a % LANES;
  const Vector<T> low = {own[0], own[LANES], own[2 * LANES]}, high = {own[3 * LANES], own[4 * LANES], own[5 * LANES]};
  const int64_t groups = whole_blocks(boxes.count);
  int64_t filled = 0;
  for (int64_t block = a / (LANES * LANES); block < boxes.group_blocks; ++block) {
    uint32_t near = hits(low, high, boxes.groups + BOX_ROWS * block, reach);
    near = lanes_from(near, int(a / LANES - LANES * block)) & lanes_before(groups - LANES * block);
    for (; near; near &= near - 1) {
      const int64_t group = LANES * block + first_lane(near);
      uint32_t hit = lanes_from(hits(low, high, boxes.of + BOX_ROWS * group, reach), int(a - LANES * group));
      for (hit &= lanes_before(boxes.count - LANES * group); hit; hit &= hit - 1)
        found[filled++] = int32_t(LANES * group + first_lane(hit));
    }
  }
  return filled;
}
#endif

template <class T> INLINE Points<T> unit_normal(Points<T> n) {
  return scaled(row_of(T(1)) / root<T>(most<T>(dot(n, n), row_of(T(TINY)))), n);
}

// The unit normals of a cluster.
#ifdef ONE_LANE
template <class T> struct NormalsOf {
  T rows[3 * LANES];
  INLINE_MEMBER explicit NormalsOf(const T* from) {
    for (int lane = 0; lane < LANES; ++lane) put_lane3(rows, lane, unit_normal<T>(lane3(from, lane)));
  }
  INLINE_MEMBER Vector<T> sum() const { return sums_in(rows); }
  INLINE_MEMBER T least_along(Vector<T> axis) const {
    T found = dot(axis, lane3(rows, 0));
    for (int lane = 1; lane < LANES; ++lane) found = less<T>(dot(axis, lane3(rows, lane)), found);
    return found;
  }
};
#else
template <class T> struct NormalsOf {
  Points<T> n;
  INLINE_MEMBER explicit NormalsOf(const T* from) : n(unit_normal<T>(rows3_at(from))) {}
  INLINE_MEMBER Vector<T> sum() const { return sums<T>(n); }
  INLINE_MEMBER T least_along(Vector<T> axis) const {
    return least_lane<T>(axis.x * n.x + axis.y * n.y + axis.z * n.z);
  }
};
#endif

// Writes for each cluster the axis of its normals to cones (C, 4), and the cosine of the angle up to which the axes of
// two such clusters count as one; above 1 where none does. Clusters have size rows each; the normals, of any length,
// are the three rows from first on. angle is the cone's, less than a right one: its cosine, and cosine and sine of
// twice it.
struct ConeAngle { double cosine, cosine_twice, sine_twice; };
template <class T>
DEVICE void write_cones(const T* rows, int64_t count, int size, int first, ConeAngle angle, T* cones) {
  for (int64_t c : each(count)) {
    const NormalsOf<T> normals(rows + size * c + first);
    Vector<T> axis = normals.sum();
    axis = scaled(T(1) / more<T>(root(dot(axis, axis)), T(TINY)), axis);
    const T cosine = less<T>(normals.least_along(axis), T(1));
    // This is cos 2 (angle - a); a is the largest angle between a normal and the axis.
    const T sine = root(more<T>(T(1) - cosine * cosine, T(0)));
    const T limit =
        T(angle.cosine_twice) * (T(2) * cosine * cosine - T(1)) + T(angle.sine_twice) * T(2) * cosine * sine;
    cones[4 * c] = axis.x, cones[4 * c + 1] = axis.y, cones[4 * c + 2] = axis.z;
    cones[4 * c + 3] = cosine > T(angle.cosine) ? limit : T(2);
  }
}

// Returns whether all normals of two clusters lie within the cones' angle of the axis between the clusters' axes: b / 2
// + a is less than it, b the angle between the axes and a the larger angle of a normal to its own axis (Volino and
// Magnenat-Thalmann 1994, "Efficient self-collision detection on smoothly discretized surface animations using
// geometrical shape regularity", CGF 13(3)).
template <class T> INLINE bool in_one_cone(const T* cones, int64_t a, int64_t b) {
  const T *p = cones + 4 * a, *q = cones + 4 * b;
  return p[0] * q[0] + p[1] * q[1] + p[2] * q[2] > more<T>(p[3], q[3]);
}
