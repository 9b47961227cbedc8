// The point of a triangle that is nearest to another point.
#pragma once
#include "vectors.hpp"

// Returns the barycentric coordinates of the point of the triangle a, b, c that is nearest to p (Ericson 2005,
// "Real-Time Collision Detection", 5.1.5).
template <class T>
INLINE Vector<T> weights_in_triangle(Vector<T> p, Vector<T> a, Vector<T> b, Vector<T> c) {
  const Vector<T> ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
  const T d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp);
  const T d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const T vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0) return {1 - d1 / (d1 - d3), d1 / (d1 - d3), 0};
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const T vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0) return {1 - d2 / (d2 - d6), 0, d2 / (d2 - d6)};
  const T va = d3 * d6 - d5 * d4, from = d4 - d3, to = d5 - d6;
  if (va <= 0 && from >= 0 && to >= 0) return {0, 1 - from / (from + to), from / (from + to)};
  const T total = va + vb + vc;
  return {va / total, vb / total, vc / total};
}
