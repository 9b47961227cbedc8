// Untangling: cloth that passes through itself is moved a little towards where it does not (Volino and
// Magnenat-Thalmann 2006, "Resolving surface collisions through intersection contour minimization", ACM TOG 25(3)).
//
// Two sheets cross along a contour. Where an edge with the direction E passes through a triangle with the normal N, the
// contour runs on both sides of the edge along R, the unit vectors in which the edge's own triangles cut that triangle.
// Relative to the triangle the edge goes along
//
//     G = sum R - 2 N (E . sum R) / (E . N),
//
// by which the contour grows shorter fastest. The edge's ends go one way and the triangle's corners the other way, each
// by the mean of its ways, no farther than the body moved. Both sheets stay as they are but for that: there is neither
// an inside nor a side to remember. What crosses shallowly comes apart within a few frames; the memory of folds keeps
// it so. Sheets that lie deep in each other have no short way out, and stay.
//
// The pairs of triangles that cross are found once, by boxes around sixteen triangles side by side and by cones around
// their normals, and looked at again in each step.
#pragma once
#include "clusters.hpp"
#include "records.hpp"

constexpr int UNTANGLE_STEPS = 4;
constexpr double LEAST_M = 0.0003, WAY_M = 0.002;
constexpr int BORDER = -1, OTHERS = -2;  // in Tangles.across: nothing is across the edge; it is another triangle's
constexpr int64_t MOST_PAIRS = 8192;     // of a frame: bounds its time
constexpr double OBLIQUE = 0.05;         // the least cosine of edge and normal that counts
// A way of half this size, squared, is halved: contours that all but close leave hardly any way.
constexpr double SOFT = 0.25;
constexpr double TOUCH_M2 = 1e-12;  // boxes that only touch may cross
// Cloth side by side whose normals differ from an axis by less than 0.45 pi does not cross itself; by a right angle
// would do but for cloth whose border crosses itself.
constexpr ConeAngle CONE = {0.15643446504023092, -0.9510565162951535, 0.3090169943749475};

// Rows of a cluster of triangles: three corners, the least and the most corner of the box, the normal, as long as twice
// the area, and the plane's height along it.
constexpr int CORNERS = 0, LOW = 9 * LANES, HIGH = 12 * LANES, NORMAL = 15 * LANES, HEIGHT = 18 * LANES;
constexpr int TRIANGLE_ROWS = 19 * LANES;

template <class T> INLINE Row<T> heights(Vector<T> n, Points<T> p) { return n.x * p.x + n.y * p.y + n.z * p.z; }

template <class T> INLINE void lay_triangles(const T* x, const int32_t* corner, T* to) {
  Points<T> p = points_at(x, corner), q = points_at(x, corner + LANES), r = points_at(x, corner + 2 * LANES);
  put3(to + CORNERS, p);
  put3(to + CORNERS + 3 * LANES, q);
  put3(to + CORNERS + 6 * LANES, r);
  Points<T> n = cross(q - p, r - p);
  put3(to + NORMAL, n);
  put(to + HEIGHT, dot(n, p));
  const Points<T> low = {least<T>(p.x, q.x), least<T>(p.y, q.y), least<T>(p.z, q.z)};
  const Points<T> high = {most<T>(p.x, q.x), most<T>(p.y, q.y), most<T>(p.z, q.z)};
  put3(to + LOW, Points<T>{least<T>(low.x, r.x), least<T>(low.y, r.y), least<T>(low.z, r.z)});
  put3(to + HIGH, Points<T>{most<T>(high.x, r.x), most<T>(high.y, r.y), most<T>(high.z, r.z)});
}

// Returns for each lane a number below zero where the corners of a triangle lie on both sides of a plane at a height
// along the normal n of another triangle, and the boxes of both overlap.
template <class T>
INLINE Row<T> parting(Vector<T> n, T height, Vector<T> low, Vector<T> high, const Points<T> (&corner)[3],
                      Points<T> lower, Points<T> higher) {
  Row<T> a = heights(n, corner[0]), b = heights(n, corner[1]), c = heights(n, corner[2]);
  Row<T> apart = most<T>(least<T>(least<T>(a, b), c) - height, height - most<T>(most<T>(a, b), c));
  Row<T> x = most<T>(lower.x - high.x, low.x - higher.x);
  Row<T> y = most<T>(lower.y - high.y, low.y - higher.y);
  Row<T> z = most<T>(lower.z - high.z, low.z - higher.z);
  return most<T>(apart, most<T>(most<T>(x, y), z));
}

#ifndef ONE_LANE
// Returns the bits of the triangles of a cluster whose box reaches box b.
template <class T> INLINE uint32_t reach_box(const T* own, const T* boxes, int64_t b) {
  const T* box = boxes + BOX_ROWS * (b / LANES) + b % LANES;
  Points<T> low = rows3_at(own + LOW), high = rows3_at(own + HIGH);
  Row<T> x = most<T>(low.x - box[3 * LANES], box[0] - high.x);
  Row<T> y = most<T>(low.y - box[4 * LANES], box[LANES] - high.y);
  Row<T> z = most<T>(low.z - box[5 * LANES], box[2 * LANES] - high.z);
  return ~lanes_of<T>(most<T>(most<T>(x, y), z) > row_of(T(0))) & 0xFFFFu;
}

// Returns the bits of the triangles of the other cluster that have corners on both sides of the plane of the own
// triangle i and whose box overlaps that one's.
template <class T> INLINE uint32_t have_sides(const T* own, int i, const T* other) {
  const Points<T> corner[3] = {rows3_at(other), rows3_at(other + 3 * LANES), rows3_at(other + 6 * LANES)};
  const Row<T> found = parting<T>(lane3(own + NORMAL, i), own[HEIGHT + i], lane3(own + LOW, i), lane3(own + HIGH, i),
                                  corner, rows3_at(other + LOW), rows3_at(other + HIGH));
  return lanes_of<T>(row_of(T(0)) > found);
}
#endif

// Returns whether triangle i of the own cluster has corners on both sides of the plane of triangle j of the other.
template <class T> INLINE bool is_parted(const T* own, int i, const T* other, int j) {
  const Vector<T> p = lane3(other, j), n = lane3(other + NORMAL, j);
  const T a = dot(n, lane3(own, i) - p), b = dot(n, lane3(own + 3 * LANES, i) - p);
  const T c = dot(n, lane3(own + 6 * LANES, i) - p);
  return less<T>(less<T>(a, b), c) < 0 && more<T>(more<T>(a, b), c) > 0;
}

// Returns how far [m] a step of untangling goes at most where the network has moved by moved_m [m]: no farther than
// that, or cloth on a body that stands still would not come to rest, but LEAST_M at least, or cloth would crumple
// through itself there.
INLINE double farthest_way(double moved_m) { return less<double>(WAY_M, more<double>(moved_m, LEAST_M)); }

struct Threes { int32_t of[3]; };
INLINE Threes threes(const int32_t* table, int64_t triangle) {
  const int32_t* own = table + 3 * LANES * (triangle / LANES) + triangle % LANES;
  return {{own[0], own[LANES], own[2 * LANES]}};
}

INLINE bool share_a_corner(Threes a, Threes b) {
  bool same = false;
  for (int n = 0; n < 3; ++n)
    for (int m = 0; m < 3; ++m) same |= a.of[n] == b.of[m];
  return same;
}

struct Pair { int32_t first, second; };  // triangles: cluster times LANES plus lane

#ifndef ONE_LANE
// Writes the pairs of triangles of the clusters chosen (n,), which rise, that share no corner and may cross: each has
// corners on both sides of the other one, and their boxes overlap. Returns their number, MOST_PAIRS at most.
template <class T>
DEVICE int64_t crossing(const T* x, const Tangles<T>& tangles, const int32_t* chosen, int64_t count, Pair* pairs,
                        Scratch& scratch) {
  if (count == 0) return 0;
  const int64_t mark = scratch.used, all = tangles.start.count - 1;
  T *rows = scratch.take<T>(TRIANGLE_ROWS * count), *cones = scratch.take<T>(4 * count);
  int32_t *number = scratch.take<int32_t>(all), *joined = scratch.take<int32_t>(count);
  int32_t* close = scratch.take<int32_t>(count);
  if (scratch.overflowed) return 0;
  for (int64_t c = 0; c < all; ++c) number[c] = -1;
  for (int64_t n = 0; n < count; ++n) {
    lay_triangles(x, tangles.corner + 3 * LANES * chosen[n], rows + TRIANGLE_ROWS * n);
    number[chosen[n]] = int32_t(n);
    joined[n] = -1;
  }
  const Boxes<T> boxes = boxes_around(rows, count, TRIANGLE_ROWS, LOW, HIGH, scratch);
  if (scratch.overflowed) return 0;
  write_cones(rows, count, TRIANGLE_ROWS, NORMAL, CONE, cones);
  int64_t filled = 0;
  for (int64_t a = 0; a < count; ++a) {
    const T* own = rows + TRIANGLE_ROWS * a;
    for (int64_t entry = tangles.start[chosen[a]]; entry < tangles.start[chosen[a] + 1]; ++entry)
      if (number[tangles.beside[entry]] >= 0) joined[number[tangles.beside[entry]]] = int32_t(a);
    const int64_t found = find_close(a, boxes, T(TOUCH_M2), close);
    for (int64_t entry = 0; entry < found; ++entry) {
      const int64_t b = close[entry];
      if (joined[b] == a && in_one_cone(cones, a, b)) continue;
      const T* other = rows + TRIANGLE_ROWS * b;
      for (uint32_t reach = reach_box(own, boxes.of, b); reach; reach &= reach - 1) {
        const int i = first_lane(reach);
        uint32_t sides = lanes_from(have_sides(own, i, other), a == b ? i + 1 : 0);
        for (; sides && filled < MOST_PAIRS; sides &= sides - 1) {
          const int j = first_lane(sides);
          const int32_t p = int32_t(LANES * chosen[a] + i), q = int32_t(LANES * chosen[b] + j);
          if (!share_a_corner(threes(tangles.corner, p), threes(tangles.corner, q)) && is_parted(own, i, other, j))
            pairs[filled++] = {p, q};
        }
      }
    }
  }
  scratch.used = mark;
  return filled;
}
#else
#include "boxes_one.hpp"

// Returns whether two clusters share a corner.
template <class T> INLINE bool are_beside(const Tangles<T>& tangles, int32_t a, int32_t b) {
  bool found = false;
  for (int64_t entry = tangles.start[a]; entry < tangles.start[a + 1]; ++entry) found |= tangles.beside[entry] == b;
  return found;
}

// Returns whether triangle i of the cluster own and triangle j of the other may cross.
template <class T>
INLINE bool may_cross(const T* own, int i, int32_t p, const T* other, int j, int32_t q, const Tangles<T>& tangles) {
  const Points<T> corner[3] = {lane3(other, j), lane3(other + 3 * LANES, j), lane3(other + 6 * LANES, j)};
  const T found = parting<T>(lane3(own + NORMAL, i), own[HEIGHT + i], lane3(own + LOW, i), lane3(own + HIGH, i), corner,
                             lane3(other + LOW, j), lane3(other + HIGH, j));
  return T(0) > found && !share_a_corner(threes(tangles.corner, p), threes(tangles.corner, q)) &&
         is_parted(own, i, other, j);
}

// Returns whether a pair comes before another one in the order in which a processor finds them: by both clusters, then
// by both lanes.
INLINE bool comes_before(Pair a, Pair b) {
  const int32_t own[4] = {a.first / LANES, a.second / LANES, a.first, a.second};
  const int32_t other[4] = {b.first / LANES, b.second / LANES, b.first, b.second};
  for (int n = 0; n < 3; ++n)
    if (own[n] != other[n]) return own[n] < other[n];
  return own[3] < other[3];
}

template <class T>
DEVICE int64_t crossing(const T* x, const Tangles<T>& tangles, const int32_t* chosen, int64_t count, Pair* pairs,
                        Scratch& scratch) {
  if (count == 0) return 0;
  const int64_t mark = scratch.used;
  T *rows = scratch.take<T>(TRIANGLE_ROWS * count), *cones = scratch.take<T>(4 * count);
  Pair* unsorted = scratch.take<Pair>(MOST_PAIRS);
  if (scratch.overflowed) return 0;
  for (int64_t n : each_block(count))
    lay_triangles(x, tangles.corner + 3 * LANES * chosen[n], rows + TRIANGLE_ROWS * n);
  const Boxes<T> boxes = boxes_around(rows, count, TRIANGLE_ROWS, LOW, HIGH, scratch);
  if (scratch.overflowed) return 0;
  write_cones(rows, count, TRIANGLE_ROWS, NORMAL, CONE, cones);
  const int64_t filled = collect(LANES * count, unsorted, MOST_PAIRS, [&](int64_t e, Pair* to, int64_t room) {
    const int64_t a = e / LANES;
    const int i = int(e % LANES);
    const T* own = rows + TRIANGLE_ROWS * a;
    int64_t found = 0;
    see_near(lane3(own + LOW, i), lane3(own + HIGH, i), boxes, a, T(TOUCH_M2), [&](int64_t b) {
      if (are_beside(tangles, chosen[a], chosen[b]) && in_one_cone(cones, a, b)) return;
      const T* other = rows + TRIANGLE_ROWS * b;
      for (int j = a == b ? i + 1 : 0; j < LANES; ++j) {
        const int32_t p = int32_t(LANES * chosen[a] + i), q = int32_t(LANES * chosen[b] + j);
        if (!may_cross(own, i, p, other, j, q, tangles)) continue;
        if (found < room) to[found] = {p, q};
        ++found;
      }
    });
    return found;
  });
  for (int64_t n : each(filled)) {
    int64_t before = 0;
    for (int64_t m = 0; m < filled; ++m) before += comes_before(unsorted[m], unsorted[n]);
    pairs[before] = unsorted[n];
  }
  scratch.used = mark;
  return filled;
}
#endif

template <class T> INLINE T turn_of(Vector<T> a, Vector<T> b, Vector<T> y, Vector<T> normal) {
  return dot(cross(b - a, y - a), normal);
}

// Returns the unit vector, in the triangle that lies inward of an edge, along the plane with the normal; zero where
// both are parallel.
template <class T> INLINE Vector<T> run_along(Vector<T> along, Vector<T> inward, Vector<T> normal) {
  Vector<T> found = cross(normal, cross(along, inward));
  T length = root(dot(found, found));
  if (!(length > 0)) return found;
  const Vector<T> into = plus(inward, -dot(inward, along), along);
  length = dot(found, into) > 0 ? length : -length;
  return {found.x / length, found.y / length, found.z / length};
}

// Calls go(v, sign, way) for each end of those edges of the triangle edged that pass through the triangle through.
template <class T, class Go>
DEVICE void shorten(const T* x, const Tangles<T>& tangles, int64_t edged, int64_t through, Go go) {
  const Threes corner = threes(tangles.corner, edged), across = threes(tangles.across, edged);
  const Threes other = threes(tangles.corner, through);
  const Vector<T> a = point(x, other.of[0]), b = point(x, other.of[1]), c = point(x, other.of[2]);
  Vector<T> normal = cross(b - a, c - a);
  const T length = root(dot(normal, normal));
  if (!(length > 0)) return;
  normal = scaled(T(1) / length, normal);
  for (int n = 0; n < 3; ++n) {
    if (across.of[n] == OTHERS) continue;
    const int32_t from = corner.of[n], to = corner.of[(n + 1) % 3];
    const Vector<T> p = point(x, from), edge = point(x, to) - p;
    const T below = dot(normal, p - a), above = dot(normal, point(x, to) - a);
    if (!(below * above < 0)) continue;
    const Vector<T> y = plus(p, below / (below - above), edge);
    if (less<T>(less<T>(turn_of(a, b, y, normal), turn_of(b, c, y, normal)), turn_of(c, a, y, normal)) < 0) continue;
    const Vector<T> along = scaled(T(1) / root(dot(edge, edge)), edge);
    Vector<T> run = run_along(along, point(x, corner.of[(n + 2) % 3]) - p, normal);
    if (across.of[n] != BORDER) run = run + run_along(along, point(x, across.of[n]) - p, normal);
    T steep = dot(along, normal);
    steep = steep > 0 ? more<T>(steep, T(OBLIQUE)) : less<T>(steep, T(-OBLIQUE));
    Vector<T> shortest = plus(run, T(-2) * dot(along, run) / steep, normal);
    shortest = scaled(T(1) / root(dot(shortest, shortest) + T(SOFT)), shortest);
    go(from, T(1), shortest);
    go(to, T(1), shortest);
    for (int m = 0; m < 3; ++m) go(other.of[m], T(-1), shortest);
  }
}

// Adds to way (P, 3) and count (P,) the ways that all pairs give their corners, and how many these are.
#ifdef ONE_LANE
constexpr int MOST_WAYS = 15;  // of a triangle through another one: five for each edge
template <class T> struct Given { int32_t place; Vector<T> way; };
template <class T>
DEVICE void add_ways(const T* x, const Tangles<T>& tangles, const Pair* pairs, int64_t found, T* way, T* count,
                     Scratch& scratch) {
  const int64_t mark = scratch.used;
  Given<T>* given = scratch.take<Given<T>>(2 * MOST_WAYS * found);
  int32_t* filled = scratch.take<int32_t>(2 * found);
  if (scratch.overflowed) return;
  for (int64_t n : each(2 * found)) {
    const Pair pair = pairs[n / 2];
    int32_t own = 0;
    shorten(x, tangles, n % 2 ? pair.second : pair.first, n % 2 ? pair.first : pair.second,
            [&](int32_t v, T sign, Vector<T> a) { given[MOST_WAYS * n + own++] = {v, scaled(sign, a)}; });
    filled[n] = own;
  }
  // Every thread reads all pairs in one order, and adds those of its own places.
  const int threads = thread_count();
  for (int64_t t : each(threads))
    for (int64_t n = 0; n < 2 * found; ++n)
      for (int64_t i = MOST_WAYS * n; i < MOST_WAYS * n + filled[n]; ++i) {
        const int64_t v = given[i].place;
        if (v % threads != t) continue;
        add_point(way, v, given[i].way);
        count[v] += T(1);
      }
  scratch.used = mark;
}
#else
template <class T>
INLINE void add_ways(const T* x, const Tangles<T>& tangles, const Pair* pairs, int64_t found, T* way, T* count,
                     Scratch&) {
  const auto go = [&](int64_t v, T sign, Vector<T> a) {
    put_point(way, v, plus(point(way, v), sign, a));
    count[v] += T(1);
  };
  for (int64_t n = 0; n < found; ++n) {
    shorten(x, tangles, pairs[n].first, pairs[n].second, go);
    shorten(x, tangles, pairs[n].second, pairs[n].first, go);
  }
}
#endif

// Moves x [m] (P, 3) apart in place where triangles of the clusters chosen (n,) cross, by farthest [m] at most in each
// of so many steps. Writes to count (P,) how many ways each place had in the last step: above zero where cloth crossed.
// Returns the number of pairs.
template <class T>
DEVICE int64_t untangle(T* x, int64_t places, const Tangles<T>& tangles, const int32_t* chosen, int64_t number,
                        T farthest, int steps, T* count, Scratch& scratch) {
  const int64_t mark = scratch.used;
  Pair* pairs = scratch.take<Pair>(MOST_PAIRS);
  T* way = scratch.take<T>(3 * places);
  if (scratch.overflowed) return 0;
  const int64_t found = crossing(x, tangles, chosen, number, pairs, scratch);
  for (int64_t v : each(places)) count[v] = 0;
  for (int step = 0; step < steps && found > 0; ++step) {
    for (int64_t v : each(places)) put_point(way, v, Vector<T>{}), count[v] = 0;
    add_ways(x, tangles, pairs, found, way, count, scratch);
    for (int64_t v : each(places))
      if (count[v] > 0) put_point(x, v, plus(point(x, v), farthest / count[v], point(way, v)));
  }
  scratch.used = mark;
  return found;
}
