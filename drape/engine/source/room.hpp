// Room between sheets: cloth that comes near to itself is kept apart, so that a garment does not cross itself.
//
// Under an arm, in a groin and behind a knee the network lays cloth close together and leaves it too little area. Steps
// that give the cloth its area back crumple it through itself, at the size of its triangles. So it keeps a distance. Of
// each vertex v the vertex nearest to it that is not of its sheet is found, within SPACING mean edges. With p the
// nearest point to v of that one's triangles, n the unit vector from p to v and D = KEPT mean edges, KEPT_M at most, v
// stays half of D before the middle between them where it is nearer,
//
//     n . (x - (v + p) / 2) >= D / 2,
//
// with contact's energy. Both sheets give way, and the middle is another one in every frame. Sheets that lie on each
// other slide freely: p slides along, and n is the normal of the sheet and not the way to one of its vertices. The
// plane takes the place of that of another part of the body where it is the nearer one. Two vertices are of one sheet
// where the way through the air is nearly as long as that along the cloth: such cloth is only pressed together. Nothing
// is remembered. Where cloth already crosses itself these planes have no side to tell.
#pragma once
#include "clusters.hpp"
#include "sweeps.hpp"
#include "triangle.hpp"

constexpr double SPACING = 0.95, ROOM_M = 0.018;  // mean edges within which vertices are looked for; the lists' reach
// Mean edges from vertices to triangles: with less cloth passes through itself, with more it is kept from where physics
// lays it, at 3 to 6 mm. Coarse cloth needs no more than KEPT_M.
constexpr double KEPT = 0.5, KEPT_M = 0.0085;
constexpr int BOUND_STEPS = 254;  // of an upper bound of a pair's square, up to that of ROOM_M
constexpr double BOUND_M2 = ROOM_M * ROOM_M / BOUND_STEPS;

template <class T> INLINE bool is_near(const SheetNeighbours<T>& n, int32_t v, int32_t u, T far) {
  bool hit = false;
  for (int64_t i = n.start[v]; i < n.start[v + 1]; ++i) hit |= n.vertex[i] == u && far >= T(n.square[i]);
  return hit;
}

#ifndef ONE_LANE
// For every lane of the clusters the squared distance [m^2] to the nearest other point, and the lane of that point.
template <class T> struct NearestLanes {
  T* square;
  int32_t* which;
  T most;
};

// Returns for each point of b the least squared distance [m^2] to those of a that may count. The bound in the list of a
// pair is an upper bound of its square, so a point below no bound counts in no pair.
template <class T> INLINE Row<T> least_squares(const T* a, const T* b, const uint8_t* bound, T most_) {
  Points<T> other = rows3_at(b);
  Row<T> found = row_of(most_);
#pragma clang loop unroll_count(4)
  for (int i = 0; i < LANES; ++i) {
    Row<T> x = a[i] - other.x, y = a[LANES + i] - other.y, z = a[2 * LANES + i] - other.z;
    Row<T> far = x * x + y * y + z * z;
    if (bound) {
      typedef uint8_t Bytes __attribute__((ext_vector_type(16)));
      Bytes steps;
      __builtin_memcpy(&steps, bound + LANES * i, sizeof steps);
      Row<T> limit = T(BOUND_M2) * __builtin_convertvector(steps, Row<T>);
      far = where<T>(far < limit, far, row_of(most_));
    }
    found = least<T>(found, far);
  }
  return found;
}

// Lowers found to the distances of all pairs of the clusters a and b that count. listed: whether some of them may
// belong to one sheet.
template <class T>
DEVICE void count_pairs(const T* rows, const SheetNeighbours<T>& n, int64_t a, int64_t b, Row<T> least_, bool listed,
                        NearestLanes<T>& found) {
  const T *own = rows + POINT_ROWS * a, *others = rows + POINT_ROWS * b;
  for (uint32_t lanes = lanes_of<T>(least_ < row_of(found.most)); lanes; lanes &= lanes - 1) {
    const int j = first_lane(lanes);
    const Vector<T> there = lane3(others, j);
    const int64_t q = LANES * b + j;
    for (int i = 0; i < LANES; ++i) {
      const int64_t p = LANES * a + i;
      const Vector<T> way = lane3(own, i) - there;
      const T far = dot(way, way);
      if (!(far < more<T>(found.square[p], found.square[q]))) continue;
      if (listed && is_near(n, n.clusters[p], n.clusters[q], far)) continue;
      if (far < found.square[p]) found.square[p] = far, found.which[p] = int32_t(q);
      if (far < found.square[q]) found.square[q] = far, found.which[q] = int32_t(p);
    }
  }
}

// Writes to room (V,) the distance [m] from each of the points (V, 3) to the nearest one that does not belong to the
// cloth around it, and to nearest (V,) that point; where none is within reach [m], ROOM_M at most, these are the reach
// and -1. Every pair of clusters whose boxes come near each other is tested once, and hardly any has points that count.
template <class T>
DEVICE void rooms(const T* points, const SheetNeighbours<T>& n, T reach, T* room, int32_t* nearest, Scratch& scratch) {
  const int64_t mark = scratch.used, count = n.clusters.count / LANES;
  T* rows = scratch.take<T>(POINT_ROWS * count);
  int32_t *table = scratch.take<int32_t>(count), *found = scratch.take<int32_t>(count);
  NearestLanes<T> lanes = {scratch.take<T>(LANES * count), scratch.take<int32_t>(LANES * count), reach * reach};
  if (scratch.overflowed) return;
  for (int64_t c = 0; c < count; ++c) {
    for (int lane = 0; lane < LANES; ++lane)
      put_lane3(rows + POINT_ROWS * c, lane, point(points, n.clusters[LANES * c + lane]));
    table[c] = -1;
  }
  for (int64_t e = 0; e < LANES * count; ++e) lanes.square[e] = lanes.most, lanes.which[e] = -1;
  const Boxes<T> boxes = boxes_around(rows, count, POINT_ROWS, 0, 0, scratch);
  if (scratch.overflowed) return;
  for (int64_t a = 0; a < count; ++a) {
    for (int64_t i = n.other_start[a]; i < n.other_start[a + 1]; ++i) table[n.other[i]] = int32_t(i);
    const int64_t close = find_close(a, boxes, lanes.most, found);
    for (int64_t number = 0; number < close; ++number) {
      const int64_t b = found[number];
      const uint8_t* bound = table[b] >= 0 ? n.bound + LANES * LANES * table[b] : nullptr;
      Row<T> least_ = bound ? least_squares(rows + POINT_ROWS * a, rows + POINT_ROWS * b, bound, lanes.most)
                            : least_squares<T>(rows + POINT_ROWS * a, rows + POINT_ROWS * b, nullptr, lanes.most);
      if (lanes_of<T>(least_ < row_of(lanes.most))) count_pairs(rows, n, a, b, least_, bound != nullptr, lanes);
    }
    for (int64_t i = n.other_start[a]; i < n.other_start[a + 1]; ++i) table[n.other[i]] = -1;
  }
  for (int64_t e = LANES * count - 1; e >= 0; --e) {  // a lane that repeats a vertex comes before its own
    const bool is_close = lanes.square[e] < lanes.most;
    // The root of the squared reach may be less than the reach.
    room[n.clusters[e]] = is_close ? root(lanes.square[e]) : reach;
    nearest[n.clusters[e]] = is_close ? n.clusters[lanes.which[e]] : -1;
  }
  scratch.used = mark;
}

#else
#include "boxes_one.hpp"

// Returns the list's entry with the bound of a pair of clusters, -1 where the pair is not listed.
template <class T> INLINE int64_t listed(const SheetNeighbours<T>& n, int64_t a, int64_t b) {
  int64_t found = -1;
  for (int64_t i = n.other_start[a]; i < n.other_start[a + 1]; ++i) found = n.other[i] == b ? i : found;
  return found;
}

template <class T>
DEVICE void rooms(const T* points, const SheetNeighbours<T>& n, T reach, T* room, int32_t* nearest, Scratch& scratch) {
  const int64_t mark = scratch.used, count = n.clusters.count / LANES;
  T* rows = scratch.take<T>(POINT_ROWS * count);
  if (scratch.overflowed) return;
  for (int64_t e : each(LANES * count))
    put_lane3(rows + POINT_ROWS * (e / LANES), int(e % LANES), point(points, n.clusters[e]));
  const Boxes<T> boxes = boxes_around(rows, count, POINT_ROWS, 0, 0, scratch);
  if (scratch.overflowed) return;
  for (int64_t e : each(LANES * count)) {
    const int64_t a = e / LANES, i = e % LANES;
    const int32_t v = n.clusters[e];
    const Vector<T> here = lane3(rows + POINT_ROWS * a, int(i));
    T square = reach * reach;
    int32_t which = -1;
    see_near(here, here, boxes, 0, square, [&](int64_t b) {
      const int64_t entry = a <= b ? listed(n, a, b) : listed(n, b, a);
      const uint8_t* bound = entry < 0 ? nullptr : n.bound + LANES * LANES * entry;
      for (int j = 0; j < LANES; ++j) {
        const Vector<T> way = lane3(rows + POINT_ROWS * b, j) - here;
        const T far = dot(way, way);
        if (!(far < square)) continue;
        if (bound && !(far < T(BOUND_M2) * T(bound[a <= b ? LANES * i + j : LANES * j + i]))) continue;
        const int32_t u = n.clusters[LANES * b + j];
        if (bound && (a <= b ? is_near(n, v, u, far) : is_near(n, u, v, far))) continue;
        square = far, which = u;
      }
    });
    room[v] = which < 0 ? reach : root(square);
    nearest[v] = which;
  }
  scratch.used = mark;
}
#endif

template <class T> INLINE Vector<T> shorter(Vector<T> way, Vector<T> other) {
  return dot(way, way) < dot(other, other) ? way : other;
}

// Returns the shortest way [m] from the triangles of the place u to a point [m].
template <class T> INLINE Vector<T> from_triangles(const T* x, const Sheet<T>& sheet, int64_t u, Vector<T> at) {
  const Vector<T> corner = point(x, u), off = at - corner;
  const int64_t lane = u % LANES;
  Vector<T> found = off;
  for (int64_t row = sheet.fan_start[u / LANES]; row < sheet.fan_start[u / LANES + 1]; ++row) {
    const int32_t* other = sheet.fan_other + 2 * LANES * row + lane;
    const Vector<T> second = point(x, other[0]), third = point(x, other[LANES]);
    const Vector<T> weight = weights_in_triangle(at, corner, second, third);
    found = shorter(off - mix(weight.y, second - corner, weight.z, third - corner), found);
  }
  return found;
}

// How near [m] other cloth is looked for, and how near it may come.
template <class T> struct Spacing {
  T reach, kept;
  INLINE_MEMBER explicit Spacing(const Sheet<T>& sheet)
      : reach(less<T>(T(SPACING) / T(sheet.constants.per_edge), T(ROOM_M))),
        kept(less<T>(T(KEPT) / T(sheet.constants.per_edge), T(KEPT_M))) {}
};

// Writes the plane that keeps the place p of x [m] (P, 3) from the triangles of the place beside, if they are nearer
// than kept [m] and no other part of the body holds it first.
template <class T>
INLINE void put_apart(const T* x, const Sheet<T>& sheet, int64_t p, int64_t beside, T kept, T* planes) {
  const Vector<T> here = point(x, p), way = from_triangles(x, sheet, beside, here);
  const T far = root(dot(way, way));
  if (!(far > 0 && far < kept)) return;
  T* own = planes + PLANES * (p / LANES) + OTHER_PLANE + p % LANES;
  const Vector<T> normal = scaled(T(1) / far, way);
  const T height = T(0.5) * (far - kept) + T(sheet.constants.gap);  // contact begins a gap over the plane
  const Vector<T> foot = lane3(own, 0), other = lane3(own + 3 * LANES, 0);
  if (dot(other, other) > 0 && dot(here - foot, other) < height) return;
  put_lane3(own, 0, plus(here, -height, normal));
  put_lane3(own + 3 * LANES, 0, normal);
}

// Writes the planes that keep x [m] (P, 3) apart from itself into those of other body parts, and a 1 to NEAR_ROW where
// other cloth is within reach.
template <class T>
DEVICE void keep_apart(const T* x, const Sheet<T>& sheet, const SheetNeighbours<T>& neighbours, T* planes,
                       Scratch& scratch) {
  const int64_t mark = scratch.used, count = sheet.place.count;
  const Spacing<T> spacing(sheet);
  T *points = scratch.take<T>(3 * count), *room = scratch.take<T>(count);
  int32_t* nearest = scratch.take<int32_t>(count);
  if (scratch.overflowed) return;
  for (int64_t v : each(count)) put_point(points, v, point(x, sheet.place[v]));
  rooms(points, neighbours, spacing.reach, room, nearest, scratch);
  if (scratch.overflowed) return;
  for (int64_t v : each(count)) {
    if (nearest[v] < 0) continue;
    const int64_t p = sheet.place[v];
    planes[PLANES * (p / LANES) + NEAR_ROW + p % LANES] = T(1);
    put_apart<T>(x, sheet, p, sheet.place[nearest[v]], spacing.kept, planes);
  }
  scratch.used = mark;
}
