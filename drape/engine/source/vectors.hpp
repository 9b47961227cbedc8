// Vectors and symmetric matrices of numbers, or of rows (rows.hpp): one formula serves a vertex and a block of sixteen.
#pragma once
#include "platform.hpp"

template <class T> INLINE T less(T a, T b) { return a < b ? a : b; }  // b where one is NaN
template <class T> INLINE T more(T a, T b) { return a > b ? a : b; }

template <class N> struct Vector { N x, y, z; };

template <class N> INLINE Vector<N> operator+(Vector<N> a, Vector<N> b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
template <class N> INLINE Vector<N> operator-(Vector<N> a, Vector<N> b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
template <class N> INLINE Vector<N> scaled(N s, Vector<N> a) { return {s * a.x, s * a.y, s * a.z}; }
// Returns a + s b, and below s a + t b; products and sums are one expression, so that they are fused.
template <class N> INLINE Vector<N> plus(Vector<N> a, N s, Vector<N> b) {
  return {a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
template <class N> INLINE Vector<N> mix(N s, Vector<N> a, N t, Vector<N> b) {
  return {s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z};
}
template <class N> INLINE N dot(Vector<N> a, Vector<N> b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class N> INLINE Vector<N> cross(Vector<N> a, Vector<N> b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class T> INLINE Vector<T> point(const T* x, int64_t v) { return {x[3 * v], x[3 * v + 1], x[3 * v + 2]}; }
template <class T> INLINE void put_point(T* x, int64_t v, Vector<T> a) {
  x[3 * v] = a.x;
  x[3 * v + 1] = a.y;
  x[3 * v + 2] = a.z;
}
template <class T> INLINE void add_point(T* x, int64_t v, Vector<T> a) { put_point(x, v, point(x, v) + a); }

// A symmetric matrix by its entries 00, 01, 02, 11, 12, 22.
template <class N> struct Symmetric { N xx, xy, xz, yy, yz, zz; };

// Returns h + s a a^T.
template <class N> INLINE Symmetric<N> outer(Symmetric<N> h, N s, Vector<N> a) {
  Vector<N> b = scaled(s, a);
  return {h.xx + b.x * a.x, h.xy + b.x * a.y, h.xz + b.x * a.z, h.yy + b.y * a.y, h.yz + b.y * a.z, h.zz + b.z * a.z};
}
// Returns h + pp p p^T + pt (p t^T + t p^T) + tt t t^T + s 1.
template <class N>
INLINE Symmetric<N> squares(Symmetric<N> h, N pp, N pt, N tt, Vector<N> p, Vector<N> t, N s) {
  Vector<N> a = mix(pp, p, pt, t), b = mix(pt, p, tt, t);
  return {h.xx + a.x * p.x + b.x * t.x + s, h.xy + a.x * p.y + b.x * t.y,     h.xz + a.x * p.z + b.x * t.z,
          h.yy + a.y * p.y + b.y * t.y + s, h.yz + a.y * p.z + b.y * t.z, h.zz + a.z * p.z + b.z * t.z + s};
}
// Returns h^-1 g.
template <class N> INLINE Vector<N> solved(Symmetric<N> h, Vector<N> g) {
  N a = h.yy * h.zz - h.yz * h.yz, b = h.xz * h.yz - h.xy * h.zz, c = h.xy * h.yz - h.xz * h.yy;
  N d = h.xx * h.zz - h.xz * h.xz, e = h.xy * h.xz - h.xx * h.yz, f = h.xx * h.yy - h.xy * h.xy;
  N per = N(1) / (h.xx * a + h.xy * b + h.xz * c);
  return {(a * g.x + b * g.y + c * g.z) * per, (b * g.x + d * g.y + e * g.z) * per, (c * g.x + e * g.y + f * g.z) * per};
}
