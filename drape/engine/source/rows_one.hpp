// Rows of a card: a row is one number, that of the thread's own lane of a block of sixteen (threads_one.hpp).
#pragma once
#include "threads.hpp"
#include "vectors.hpp"

constexpr int LANES = 16, WIDTH = 1;

template <class T> using Row = T;
template <class T> using Points = Vector<T>;
template <class T> using Mask = int32_t;
template <class T> struct Numbers { typedef int32_t Whole; };
typedef int32_t Indices;

template <class T> INLINE T row_of(T number) { return number; }
template <class T> INLINE T row_at(const T* from) { return from[lane()]; }
template <class T> INLINE void put(T* to, T number) { to[lane()] = number; }
template <class T> INLINE T several_at(const T* from) { return from[0]; }
template <class T> INLINE void put_several(T* to, T number) { to[0] = number; }
INLINE Indices indices_at(const int32_t* from) { return from[lane()]; }
INLINE Indices indices_in(const int32_t* held) { return held[0]; }
INLINE Indices indices_from(int64_t first) { return int32_t(first) + lane(); }
INLINE int lane_of(int) { return lane(); }
INLINE bool holds(int lane_) { return lane_ == lane(); }
template <class N> INLINE N number_in(N row, int) { return row; }
template <class N> INLINE void set_number(N& row, int, N number) { row = number; }
template <class N> INLINE void add_product(N& row, int, N a, N b) { row += a * b; }

template <class T> INLINE T where(Mask<T> mask, T then, T other) { return mask ? then : other; }
template <class T> INLINE Mask<T> differ(Indices a, Indices b) { return a != b; }
template <class T> INLINE T most(T a, T b) { return a > b ? a : b; }
template <class T> INLINE T least(T a, T b) { return b > a ? a : b; }
INLINE float root(float a) { return __builtin_sqrtf(a); }
INLINE double root(double a) { return __builtin_sqrt(a); }
template <class T> INLINE T root(T a) { return root(a); }
template <class T> INLINE uint32_t lanes_of(Mask<T> mask) { return mask ? 1u : 0u; }
INLINE int first_lane(uint32_t) { return 0; }
INLINE uint32_t lanes_before(int64_t lane) { return lane > 0 ? 1u : 0u; }

template <class T> INLINE Points<T> points_in(const T* from) { return point(from, lane()); }
template <class T> INLINE void put_points(T* to, Points<T> a) { put_point(to, lane(), a); }
template <class T> INLINE Points<T> points_at(const T* x, const int32_t* index) { return point(x, index[lane()]); }
template <class T> INLINE Points<T> points_of(const T* x, const int32_t* held) { return point(x, held[0]); }

template <class T> struct FourRows { T a, b, c, d; };
template <class T> INLINE FourRows<T> fours_in(const T* from, int64_t row) {
  from += row;
  return {from[0], from[1], from[2], from[3]};
}
template <class T> INLINE FourRows<T> fours_at(const T* table, const int32_t* index, int stride) {
  return fours_in(table, stride * int64_t(index[lane()]));
}
template <class T> INLINE FourRows<T> fours_of(const T* table, const int32_t* held, int stride) {
  return fours_in(table, stride * int64_t(held[0]));
}
template <class T> INLINE FourRows<T> own_fours(const T* table) { return fours_in(table, 4 * lane()); }
template <class T> INLINE void put_fours(T* to, FourRows<T> t) {
  to += 4 * lane();
  to[0] = t.a, to[1] = t.b, to[2] = t.c, to[3] = t.d;
}

// Returns the sum of a row in memory, in the order of a processor.
template <class T> INLINE T sum_in(const T* row) {
  T four[4];
  for (int n = 0; n < 4; ++n) four[n] = (row[n] + row[n + 8]) + (row[n + 4] + row[n + 12]);
  return (four[0] + four[2]) + (four[1] + four[3]);
}
template <class T> INLINE Vector<T> sums_in(const T* rows) {
  return {sum_in(rows), sum_in(rows + LANES), sum_in(rows + 2 * LANES)};
}

template <class T> INLINE T whole(T a) { return T(int64_t(a)); }
INLINE float times_two_to(float a, float power) {
  union { int32_t bits; float value; } factor = {(int32_t(power) + 127) << 23};
  return a * factor.value;
}

template <class T> struct Moves { Vector<T> a, b, c, d; };  // the fourth numbers of columns are not read
template <class T> INLINE Moves<T> moves_at(const T* from) {
  return {point(from, 0), point(from + 4, 0), point(from + 8, 0), point(from + 12, 0)};
}
template <class T> INLINE Moves<T> operator*(T s, Moves<T> a) {
  return {scaled(s, a.a), scaled(s, a.b), scaled(s, a.c), scaled(s, a.d)};
}
template <class T> INLINE Moves<T> operator+(Moves<T> a, Moves<T> b) {
  return {a.a + b.a, a.b + b.b, a.c + b.c, a.d + b.d};
}
template <class T> INLINE Moves<T> joined(Moves<T> a, T s, Moves<T> b) {
  return {plus(a.a, s, b.a), plus(a.b, s, b.b), plus(a.c, s, b.c), plus(a.d, s, b.d)};
}
template <class T> INLINE Vector<T> moved(Moves<T> m, Vector<T> p) {
  return mix(p.x, m.a, p.y, m.b) + plus(m.d, p.z, m.c);
}
