// Rows of sixteen numbers as values: a formula written for one vertex then computes a block of sixteen.
//
// A row lives in registers until `put` writes it. Sums keep their order, and `sums` halves the lanes in a fixed one, so
// a row gives the same bits on every processor with fused products. Comparisons are false where a number is NaN.
// Points (P, 3) lie in memory as x, y, z, x, y, z; `points_at` and `put_points` turn sixteen of them into three rows and
// back within registers, which takes less time than a processor's own gathers.
// A card has the same rows in another way, one number a thread (rows_one.hpp).
#pragma once
#ifdef ONE_LANE
#include "rows_one.hpp"
#else
#include "threads.hpp"
#include "vectors.hpp"

constexpr int LANES = 16, WIDTH = LANES;  // of a block, and those of it that a thread holds

template <class T> using Row = T __attribute__((ext_vector_type(16)));
template <class T> using Points = Vector<Row<T>>;  // the coordinates of sixteen points

template <class T> struct Numbers;  // the whole numbers of a float's size
template <> struct Numbers<float> { typedef int32_t Whole; };
template <> struct Numbers<double> { typedef int64_t Whole; };
template <class T> using Mask = typename Numbers<T>::Whole __attribute__((ext_vector_type(16)));
typedef int32_t Indices __attribute__((ext_vector_type(16)));

template <class T> using Four = T __attribute__((ext_vector_type(4)));
template <class T> using Block = T __attribute__((ext_vector_type(48)));

// Memory is aligned as a single number is, and no more.
template <class V, class T> INLINE V loaded(const T* from) {
  V v;
  __builtin_memcpy(&v, from, sizeof v);
  return v;
}
template <class V, class T> INLINE void store(T* to, V v) { __builtin_memcpy(to, &v, sizeof v); }

template <class T> INLINE Row<T> row_of(T number) { return (Row<T>)(number); }
template <class T> INLINE Row<T> row_at(const T* from) { return loaded<Row<T>>(from); }
template <class T> INLINE void put(T* to, Row<T> row) { store(to, row); }
template <class T> INLINE void put(T* to, T number) { put(to, row_of(number)); }

template <class T> INLINE Row<T> where(Mask<T> mask, Row<T> then, Row<T> other) { return mask ? then : other; }
template <class T> INLINE Row<T> most(Row<T> a, Row<T> b) { return a > b ? a : b; }  // b where one is NaN
template <class T> INLINE Row<T> least(Row<T> a, Row<T> b) { return b > a ? a : b; }
template <class T> INLINE Row<T> root(Row<T> a) { return __builtin_elementwise_sqrt(a); }
INLINE float root(float a) { return __builtin_sqrtf(a); }
INLINE double root(double a) { return __builtin_sqrt(a); }

// The lane of number k of a row: a thread holds WIDTH numbers, number k is that of lane_of(k).
INLINE int lane_of(int k) { return k; }
INLINE bool holds(int) { return true; }
template <class R> INLINE auto number_in(R row, int k) { return row[k]; }
template <class R, class N> INLINE void set_number(R& row, int k, N number) { row[k] = number; }
template <class R, class N> INLINE void add_product(R& row, int k, N a, N b) { row[k] += a * b; }

// Returns as many numbers, one after the other in memory, as a thread holds.
template <class T> INLINE Row<T> several_at(const T* from) { return row_at(from); }
template <class T> INLINE void put_several(T* to, Row<T> row) { put(to, row); }

// Rows of indices: as they lie in memory, as a thread holds them (WIDTH of them), and one after the other from first
// on.
INLINE Indices indices_at(const int32_t* from) { return loaded<Indices>(from); }
INLINE Indices indices_in(const int32_t* held) { return loaded<Indices>(held); }
INLINE Indices indices_from(int64_t first) {
  Indices found;
  for (int lane = 0; lane < LANES; ++lane) found[lane] = int32_t(first) + lane;
  return found;
}
template <class T> INLINE Mask<T> differ(Indices a, Indices b) { return __builtin_convertvector(a != b, Mask<T>); }

// Returns the lanes for which a mask holds as bits:  while (bits) { int lane = first_lane(bits); bits &= bits - 1; ...
// }
template <class T> INLINE uint32_t lanes_of(Mask<T> mask) {
  typedef bool Bits __attribute__((ext_vector_type(16)));
  uint16_t bits;
  Bits held = __builtin_convertvector(mask != 0, Bits);
  __builtin_memcpy(&bits, &held, sizeof bits);
  return bits;
}
INLINE int first_lane(uint32_t bits) { return __builtin_ctz(bits); }
INLINE uint32_t lanes_from(uint32_t bits, int lane) { return lane <= 0 ? bits : lane >= 32 ? 0 : (bits >> lane) << lane; }
INLINE uint32_t lanes_before(int64_t lane) { return lane >= LANES ? 0xFFFFu : (1u << lane) - 1u; }

// Returns sixteen points that lie one after the other in memory.
template <class T> INLINE Points<T> points_in(const T* from) {
  Block<T> w = loaded<Block<T>>(from);
#define EVERY_THIRD(o)                                                                                               \
  __builtin_shufflevector(w, w, o, o + 3, o + 6, o + 9, o + 12, o + 15, o + 18, o + 21, o + 24, o + 27, o + 30,      \
                          o + 33, o + 36, o + 39, o + 42, o + 45)
  return {EVERY_THIRD(0), EVERY_THIRD(1), EVERY_THIRD(2)};
#undef EVERY_THIRD
}
template <class T> INLINE void put_points(T* to, Points<T> a) {
  auto two = __builtin_shufflevector(a.x, a.y, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19,
                                     20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31);
  auto third = __builtin_shufflevector(a.z, a.z, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 0, 1, 2, 3, 4,
                                       5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
#define POINT(lane) lane, lane + 16, lane + 32
  Block<T> w = __builtin_shufflevector(two, third, POINT(0), POINT(1), POINT(2), POINT(3), POINT(4),
                                                POINT(5), POINT(6), POINT(7), POINT(8), POINT(9), POINT(10),
                                                POINT(11), POINT(12), POINT(13), POINT(14), POINT(15));
#undef POINT
  store(to, w);
}

// The first to fourth numbers of sixteen quadruples, as rows. Shuffles stay within quarters, where they are cheap.
template <class T> struct FourRows { Row<T> a, b, c, d; };
template <class T> INLINE FourRows<T> turned(const Four<T> (&r)[LANES]) {
  Row<T> w[4];
#pragma clang loop unroll(full)
  for (int k = 0; k < 4; ++k) {  // lanes k, k + 4, k + 8 and k + 12 side by side
    auto low = __builtin_shufflevector(r[k], r[k + 4], 0, 1, 2, 3, 4, 5, 6, 7);
    auto high = __builtin_shufflevector(r[k + 8], r[k + 12], 0, 1, 2, 3, 4, 5, 6, 7);
    w[k] = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  }
#define QUARTERS(a, b, c, d)                                                                                          \
  a, b, c, d, a + 4, b + 4, c + 4, d + 4, a + 8, b + 8, c + 8, d + 8, a + 12, b + 12, c + 12, d + 12
  Row<T> ab = __builtin_shufflevector(w[0], w[1], QUARTERS(0, 16, 1, 17));
  Row<T> cd = __builtin_shufflevector(w[2], w[3], QUARTERS(0, 16, 1, 17));
  Row<T> later_ab = __builtin_shufflevector(w[0], w[1], QUARTERS(2, 18, 3, 19));
  Row<T> later_cd = __builtin_shufflevector(w[2], w[3], QUARTERS(2, 18, 3, 19));
  return {__builtin_shufflevector(ab, cd, QUARTERS(0, 1, 16, 17)),
          __builtin_shufflevector(ab, cd, QUARTERS(2, 3, 18, 19)),
          __builtin_shufflevector(later_ab, later_cd, QUARTERS(0, 1, 16, 17)),
          __builtin_shufflevector(later_ab, later_cd, QUARTERS(2, 3, 18, 19))};
#undef QUARTERS
}

// Returns sixteen points of x (P, 3) by index. Behind the last point there is room for one number, which is read and
// left out.
template <class T> INLINE Points<T> points_at(const T* x, const int32_t* index) {
  Four<T> r[LANES];
#pragma clang loop unroll(full)
  for (int lane = 0; lane < LANES; ++lane) r[lane] = loaded<Four<T>>(x + 3 * (int64_t)index[lane]);
  FourRows<T> t = turned<T>(r);
  return {t.a, t.b, t.c};
}

// Returns four numbers of sixteen rows of a table by index; stride numbers lie from one row to the next.
template <class T> INLINE FourRows<T> fours_at(const T* table, const int32_t* index, int stride) {
  Four<T> r[LANES];
#pragma clang loop unroll(full)
  for (int lane = 0; lane < LANES; ++lane) r[lane] = loaded<Four<T>>(table + stride * (int64_t)index[lane]);
  return turned<T>(r);
}
template <class T> INLINE void put_fours(T* to, FourRows<T> t) {
#pragma clang loop unroll(full)
  for (int lane = 0; lane < LANES; ++lane) store(to + 4 * lane, Four<T>{t.a[lane], t.b[lane], t.c[lane], t.d[lane]});
}

// The same by indices that a thread holds, and of sixteen rows of four that lie one after the other.
template <class T> INLINE Points<T> points_of(const T* x, const int32_t* held) { return points_at(x, held); }
template <class T> INLINE FourRows<T> fours_of(const T* table, const int32_t* held, int stride) {
  return fours_at(table, held, stride);
}
template <class T> INLINE FourRows<T> own_fours(const T* table) {
  int32_t index[LANES];
  for (int lane = 0; lane < LANES; ++lane) index[lane] = lane;
  return fours_at(table, index, 4);
}

// Four columns of four numbers, all of which a thread holds; their weighted sum, and where they move a point.
template <class T> using Moves = Row<T>;
template <class T> INLINE Moves<T> moves_at(const T* from) { return row_at(from); }
template <class T> INLINE Moves<T> joined(Moves<T> a, T s, Moves<T> b) { return a + s * b; }
template <class T> INLINE Vector<T> moved(Moves<T> m, Vector<T> p) {
  const Four<T> a = __builtin_shufflevector(m, m, 0, 1, 2, 3), b = __builtin_shufflevector(m, m, 4, 5, 6, 7);
  const Four<T> c = __builtin_shufflevector(m, m, 8, 9, 10, 11), d = __builtin_shufflevector(m, m, 12, 13, 14, 15);
  const Four<T> found = a * p.x + b * p.y + (c * p.z + d);
  return {found.x, found.y, found.z};
}

// Returns the sum of a row's lanes: they are halved until four are left, then (0 + 2) + (1 + 3).
template <class T> INLINE T sum(Row<T> a) {
  auto eight = __builtin_shufflevector(a, a, 0, 1, 2, 3, 4, 5, 6, 7) +
               __builtin_shufflevector(a, a, 8, 9, 10, 11, 12, 13, 14, 15);
  Four<T> four = __builtin_shufflevector(eight, eight, 0, 1, 2, 3) + __builtin_shufflevector(eight, eight, 4, 5, 6, 7);
  return (four.x + four.z) + (four.y + four.w);
}
template <class T> INLINE Vector<T> sums(Points<T> a) { return {sum<T>(a.x), sum<T>(a.y), sum<T>(a.z)}; }

// Returns each number without its fraction, within the range of 32 or 64 bits.
template <class T> INLINE Row<T> whole(Row<T> a) {
  return __builtin_convertvector(__builtin_convertvector(a, Mask<T>), Row<T>);
}

// Returns a times two to the power: whole numbers for which two to them is a normal number.
INLINE Row<float> times_two_to(Row<float> a, Row<float> power) {
  Mask<float> bits = (__builtin_convertvector(power, Mask<float>) + 127) << 23;
  Row<float> factor;
  __builtin_memcpy(&factor, &bits, sizeof factor);
  return a * factor;
}
INLINE Row<double> times_two_to(Row<double> a, Row<double> power) {
  Mask<double> bits = (__builtin_convertvector(power, Mask<double>) + 1023) << 52;
  Row<double> factor;
  __builtin_memcpy(&factor, &bits, sizeof factor);
  return a * factor;
}
#endif

// Returns three rows that lie one after the other in memory.
template <class T> INLINE Points<T> rows3_at(const T* from) {
  return {row_at(from), row_at(from + LANES), row_at(from + 2 * LANES)};
}
template <class T> INLINE void put3(T* to, Points<T> a) {
  put(to, a.x);
  put(to + LANES, a.y);
  put(to + 2 * LANES, a.z);
}
template <class T> INLINE Vector<T> lane3(const T* from, int lane) {
  return {from[lane], from[LANES + lane], from[2 * LANES + lane]};
}
template <class T> INLINE void put_lane3(T* to, int lane, Vector<T> a) {
  to[lane] = a.x;
  to[LANES + lane] = a.y;
  to[2 * LANES + lane] = a.z;
}

// Returns four numbers of sixteen samples (S, 8) by index: point and its square from 0 on, normal and normal times
// point from 4 on.
template <class T> INLINE FourRows<T> samples_at(const T* table, const int32_t* index, int begin) {
  return fours_at(table + begin, index, 8);
}
template <class T> INLINE FourRows<T> samples_of(const T* table, const int32_t* held, int begin) {
  return fours_of(table + begin, held, 8);
}

// Returns e to each number, to 3e-8 of it or the type's rounding; below -80 that of -80, above 80 that of 80.
template <class T> INLINE Row<T> exponential(Row<T> a) {
  a = least<T>(most<T>(a, row_of(T(-80))), row_of(T(80)));
  Row<T> n = a * T(1.4426950408889634);
  n = whole<T>(n + where<T>(a > row_of(T(0)), row_of(T(0.5)), row_of(T(-0.5))));
  Row<T> x = (a - n * T(0.693359375)) - n * T(-2.1219444005469057e-4);  // within half of ln 2
  Row<T> series = x * T(1.0 / 5040.0) + T(1.0 / 720.0);
  series = series * x + T(1.0 / 120.0);
  series = series * x + T(1.0 / 24.0);
  series = series * x + T(1.0 / 6.0);
  series = series * x + T(0.5);
  series = series * x + T(1);
  return times_two_to(series * x + T(1), n);
}

// Returns the hyperbolic tangent of each number.
template <class T> INLINE Row<T> tangent(Row<T> a) {
  Row<T> size = root<T>(a * a), small = exponential<T>(size * T(-2)), bent = (T(1) - small) / (T(1) + small);
  return where<T>(a > row_of(T(0)), bent, -bent);
}
