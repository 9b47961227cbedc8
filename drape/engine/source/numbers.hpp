// Functions of single numbers.
#pragma once
#include "platform.hpp"

// Returns e to the power x, within two units in the last place.
INLINE double exponential_of(double x) {
  // With x = n ln 2 + r and |r| <= ln 2 / 2, it is the series of e^r times 2^n.
  if (!(x > -700)) return x == x ? 0 : x;
  const double n = __builtin_floor(x * 1.4426950408889634 + 0.5);
  const double r = (x - n * 0.6931471803691238) - n * 1.9082149292705877e-10;
  double sum = 1;
  for (int i = 14; i > 0; --i) sum = 1 + r / i * sum;
  union { uint64_t bits; double value; } power = {uint64_t(int64_t(n) + 1023) << 52};
  return sum * power.value;
}

// Returns the natural logarithm of a normal number above zero, within two units in the last place.
INLINE double logarithm_of(double x) {
  // x = 2^n m, m between the roots of 1/2 and 2; ln m = 2 (s + s^3 / 3 + s^5 / 5 + ...), s = (m - 1) / (m + 1)
  union { double value; uint64_t bits; } m = {x};
  const int64_t n = int64_t(m.bits - 0x3FE6A09E667F3BCDu) >> 52;
  m.bits -= uint64_t(n) << 52;
  const double s = (m.value - 1) / (m.value + 1), square = s * s;
  double sum = 0;
  for (int i = 19; i > 0; i -= 2) sum = 1.0 / i + square * sum;
  return double(n) * 0.6931471805599453 + 2 * s * sum;
}

struct SineCosine { double sine, cosine; };

// Returns sine and cosine of an angle [rad] of up to a million turns, within 2e-16 and the rounding of the angle.
INLINE SineCosine sine_cosine_of(double x) {
  // With x = n pi / 2 + r and |r| <= pi / 4, these are the series of both. pi / 2 has two parts, of which n times each
  // is exact.
  const double n = __builtin_floor(x * 0.6366197723675814 + 0.5);
  const double r = ((x - n * 1.5707963267341256) - n * 6.0771005063039987e-11) - n * 2.9127320560933562e-20;
  double sine = 1, cosine = 1;
  for (int i = 17; i > 1; i -= 2) sine = 1 - r * r / (i * (i - 1)) * sine;
  for (int i = 18; i > 0; i -= 2) cosine = 1 - r * r / (i * (i - 1)) * cosine;
  sine *= r;
  switch (int64_t(n) & 3) {
    case 0: return {sine, cosine};
    case 1: return {cosine, -sine};
    case 2: return {-sine, -cosine};
    default: return {-cosine, sine};
  }
}
