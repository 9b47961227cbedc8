// Functions of single numbers.
#pragma once
#include "platform.hpp"

// e to a number, within two units in the last place.
INLINE double exponential_of(double x) {
  // x = n ln 2 + r, |r| <= ln 2 / 2; the series of e^r, times 2^n
  if (!(x > -700)) return x == x ? 0 : x;
  const double n = __builtin_floor(x * 1.4426950408889634 + 0.5);
  const double r = (x - n * 0.6931471803691238) - n * 1.9082149292705877e-10;
  double sum = 1;
  for (int i = 14; i > 0; --i) sum = 1 + r / i * sum;
  union { uint64_t bits; double value; } power = {uint64_t(int64_t(n) + 1023) << 52};
  return sum * power.value;
}
