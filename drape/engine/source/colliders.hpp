// Cloth against the colliders of a scene: boxes, spheres and capsules, as boxes with a radius.
//
// Nodes of swing. A collider is convex, and the tangent plane at its point nearest to where a node was in the frame
// before has it on one side. The node stays on the other side, so that it passes through nothing however fast it is. A
// node without a past that is in a box, or behind it, leaves it by the face through which the way from the skin below
// enters it: what hangs from a thigh lies on the seat.
//
// Folds. A vertex near a collider has its tangent plane in the place of the plane of another part of the body, where
// the collider is nearer. At the end of a frame what is still inside goes all of the way out.
//
// Skin that is itself in a collider keeps the cloth on it there, THIN_M deeper than it is: bodies sit into the seats
// that are beneath them, and skin must not show.
//
// Distances are computed in doubles: colliders may be large and far from the body.
#pragma once
#include "sweeps.hpp"

// A collider's sixteen numbers: centre, three axes, half sides along these, radius.
constexpr int CENTRE = 0, AXES = 3, HALF = 12, RADIUS = 15, COLLIDER = 16;
constexpr double NEAR_M = 0.01, NODE_NEAR_M = 0.12;  // a collider within this distance has a plane: sweeps move less
constexpr double WORN_M = 0.04;   // cloth nearer to skin than that is on it
constexpr double THIN_M = 0.003;  // the room that cloth takes between skin and collider
constexpr double INFINITE = __builtin_inf();

struct Out { double distance; Vector<double> normal; };

INLINE Vector<double> axis_of(const double* collider, int n) { return point(collider + AXES, n); }
template <class T> INLINE Vector<double> in_doubles(Vector<T> a) { return {double(a.x), double(a.y), double(a.z)}; }
INLINE double larger(double a, double b) { return a > b ? a : b; }
INLINE double smaller(double a, double b) { return a < b ? a : b; }
INLINE double absolute(double a) { return __builtin_fabs(a); }

// Returns the distance [m] of a point to a collider, negative inside, and the unit normal that leads out.
INLINE Out outside_of(const double* collider, Vector<double> at) {
  const Vector<double> off = at - point(collider, 0);
  const Vector<double> axes[3] = {axis_of(collider, 0), axis_of(collider, 1), axis_of(collider, 2)};
  double along[3], past[3], way[3], square = 0;
  for (int n = 0; n < 3; ++n) {
    along[n] = dot(axes[n], off);
    past[n] = absolute(along[n]) - collider[HALF + n];
    way[n] = larger(past[n], 0);
    square += way[n] * way[n];
  }
  double distance = root(square);
  if (distance > 0) {
    for (int n = 0; n < 3; ++n) way[n] /= distance;
  } else {
    distance = larger(larger(past[0], past[1]), past[2]);
    const int face = past[0] == distance ? 0 : past[1] == distance ? 1 : 2;
    for (int n = 0; n < 3; ++n) way[n] = n == face;
  }
  Vector<double> normal = {};
  for (int n = 0; n < 3; ++n) normal = plus(normal, along[n] >= 0 ? way[n] : -way[n], axes[n]);
  return {distance - collider[RADIUS], normal};
}

// Returns the distance [m], negative, of end to the face of a box by which the way from start enters it, and the face's
// normal. It is infinite for round colliders, and where the way does not enter or leaves by a neighbouring face.
INLINE Out entered(const double* collider, Vector<double> start, Vector<double> end) {
  if (collider[RADIUS] > 0) return {INFINITE, {}};
  double enters = -INFINITE, leaves = INFINITE, sign = 0;
  int face = -1, out = -1;
  const Vector<double> off = start - point(collider, 0), way = end - start;
  for (int n = 0; n < 3; ++n) {
    const Vector<double> axis = axis_of(collider, n);
    const double a = dot(axis, off), d = dot(axis, way), h = collider[HALF + n];
    if (d == 0) {
      if (absolute(a) > h) return {INFINITE, axis};
      continue;
    }
    const double one = (-h - a) / d, other = (h - a) / d, near = smaller(one, other), far = larger(one, other);
    if (near > enters) enters = near, face = n, sign = d > 0 ? -1 : 1;
    if (far < leaves) leaves = far, out = n;
  }
  if (!(0 <= enters && enters <= smaller(leaves, 1)) || (leaves < 1 && out != face)) return {INFINITE, {}};
  const Vector<double> axis = scaled(sign, axis_of(collider, face));
  return {dot(axis, end - point(collider, 0)) - collider[HALF + face], axis};
}

// Writes to planes (N, 2, 4) those that hold each node c [m] (N, 3) out of the two colliders in which it is deepest: a
// normal n, zero where there is none, and n . x of its points x. came [m] (N, 3) is where the nodes were before; with
// first they were nowhere. touched (N,) are the nodes' samples of the skin (S, 8). Returns how many nodes are behind a
// plane.
template <class T>
DEVICE int64_t write_node_planes(const T* c, const T* came, int64_t nodes, bool first, const Array<double>& colliders,
                                 const T* skin, const int32_t* touched, T* planes) {
  int64_t inside = 0;
  for (int64_t i : each(nodes)) {
    T* own = planes + 8 * i;
    for (int k = 0; k < 8; ++k) own[k] = 0;
    const T* sample = skin + 8 * int64_t(touched[i]);
    const Vector<double> here = in_doubles(point(c, i)), there = in_doubles(point(came, i));
    const Vector<double> below = in_doubles(point(sample, 0));
    const bool worn = dot(here - below, here - below) < WORN_M * WORN_M;
    double least_ = NODE_NEAR_M, second = NODE_NEAR_M;
    for (int64_t m = 0; m < colliders.count / COLLIDER; ++m) {
      const double* collider = colliders + COLLIDER * m;
      Out found = outside_of(collider, there);
      const bool enters = first || found.distance < 0;
      found.distance -= dot(found.normal, there - here);
      if (enters) {
        found = entered(collider, below, here);
        const Out near = outside_of(collider, here);
        if (near.distance < found.distance) found = near;
      }
      if (worn) found.distance += larger(THIN_M - outside_of(collider, below).distance, 0);
      if (found.distance >= second) continue;
      T* to = own + 4;
      second = found.distance;
      if (found.distance < least_) {
        for (int k = 0; k < 4; ++k) own[4 + k] = own[k];
        to = own;
        second = least_;
        least_ = found.distance;
      }
      put_point(to, 0, Vector<T>{T(found.normal.x), T(found.normal.y), T(found.normal.z)});
      to[3] = T(dot(found.normal, here) - found.distance);
    }
    inside += least_ < 0;
  }
  return sum_of_all(inside);
}

// Returns whether the box around x [m] (P, 3) comes near a collider.
template <class T> DEVICE bool is_near_collider(const T* x, int64_t places, const double* collider) {
  for (int axis = 0; axis < 3; ++axis) {
    double low = INFINITE, high = -INFINITE, half = collider[RADIUS] + NEAR_M;
    for (int64_t v : each(places)) {
      const double own = double(x[3 * v + axis]);
      low = smaller(own, low), high = larger(own, high);
    }
    low = -most_of_all(-low), high = most_of_all(high);
    for (int n = 0; n < 3; ++n) half += absolute(collider[AXES + 3 * n + axis]) * collider[HALF + n];
    if (low > collider[axis] + half || high < collider[axis] - half) return false;
  }
  return true;
}

// Returns how deep [m] in a collider a place may lie because the skin sample that it lies on does.
template <class T> INLINE double sunk(Vector<double> at, const T* own, const double* collider) {
  const Vector<double> foot = in_doubles(lane3(own + OWN_PLANE, 0));
  return dot(at - foot, at - foot) < WORN_M * WORN_M ? larger(THIN_M - outside_of(collider, foot).distance, 0) : 0;
}

// Writes the tangent planes of colliders near x [m] (P, 3) into the planes of other body parts.
template <class T>
DEVICE void put_collider_planes(const T* x, int64_t places, const Array<double>& colliders, T* planes) {
  for (const double* collider = colliders.begin; collider < colliders.begin + colliders.count; collider += COLLIDER) {
    if (!is_near_collider(x, places, collider)) continue;
    for (int64_t v : each(places)) {
      T* own = planes + PLANES * (v / LANES) + v % LANES;
      const Vector<double> at = in_doubles(point(x, v));
      Out found = outside_of(collider, at);
      if (found.distance >= NEAR_M) continue;
      found.distance += sunk(at, own, collider);
      const Vector<T> n = lane3(own + OTHER_PLANE + 3 * LANES, 0), p = lane3(own + OTHER_PLANE, 0);
      if (dot(n, n) > 0 && double(dot(n, point(x, v) - p)) < found.distance) continue;
      const Vector<double> foot = plus(at, -found.distance, found.normal);
      put_lane3(own + OTHER_PLANE, 0, Vector<T>{T(foot.x), T(foot.y), T(foot.z)});
      put_lane3(own + OTHER_PLANE + 3 * LANES, 0, Vector<T>{T(found.normal.x), T(found.normal.y), T(found.normal.z)});
    }
  }
}

// Moves x [m] (P, 3) in place out of colliders, up to the clearance [m]. Without planes the skin does not matter.
template <class T>
DEVICE void leave_colliders(T* x, int64_t places, const Array<double>& colliders, const T* planes, T clearance) {
  for (const double* collider = colliders.begin; collider < colliders.begin + colliders.count; collider += COLLIDER) {
    if (!is_near_collider(x, places, collider)) continue;
    for (int64_t v : each(places)) {
      const Vector<double> at = in_doubles(point(x, v));
      const Out found = outside_of(collider, at);
      if (!(found.distance < double(clearance))) continue;
      const double depth = planes ? sunk(at, planes + PLANES * (v / LANES) + v % LANES, collider) : 0;
      const Vector<double> moved = plus(at, larger(double(clearance) - found.distance - depth, 0), found.normal);
      put_point(x, v, Vector<T>{T(moved.x), T(moved.y), T(moved.z)});
    }
  }
}
