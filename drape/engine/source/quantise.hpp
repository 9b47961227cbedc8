// Points in whole steps of their box, to the bit of drape.wire.messages.quantise.
#pragma once
#include "arrays.hpp"
#include "rows.hpp"

constexpr double FLAT_M = 1e-9;  // the least step: a box without a side has one

#ifdef ONE_LANE
INLINE void quantise(const float* positions, int64_t vertices, float count, uint16_t* steps, float* box) {
  float corner[3], size[3];
  for (int axis = 0; axis < 3; ++axis) {
    float low = vertices ? positions[axis] : 0, high = low;
    for (int64_t v : each(vertices)) {
      const float own = positions[3 * v + axis];
      low = own < low ? own : low, high = own > high ? own : high;
    }
    corner[axis] = -most_of_all(-low);
    const float step = (most_of_all(high) - corner[axis]) / count;
    size[axis] = step > float(FLAT_M) ? step : float(FLAT_M);
    if (is_first_thread()) box[axis] = corner[axis], box[3 + axis] = size[axis];
  }
  const float round = 1.5f * 8388608.f;
  for (int64_t i : each(3 * vertices)) {
    const float turned = (positions[i] - corner[i % 3]) / size[i % 3] + round;
    steps[i] = uint16_t(int32_t(turned - round));
  }
}
#else
// Writes finite positions [m] (V, 3) as steps (V, 3) from 0 to count in their box, and to box its low corner (3,) and
// the size of a step (3,).
INLINE void quantise(const float* positions, int64_t vertices, float count, uint16_t* steps, float* box) {
  const int64_t numbers = 3 * vertices, whole_runs = numbers / (3 * LANES) * (3 * LANES);
  Row<float> low[3], high[3];
  for (int i = 0; i < 3 * LANES; ++i) low[i / LANES][i % LANES] = high[i / LANES][i % LANES] = vertices
      ? positions[i % 3] : 0;
  for (int64_t begin = 0; begin < whole_runs; begin += 3 * LANES)
    for (int row = 0; row < 3; ++row) {
      Row<float> own = row_at(positions + begin + LANES * row);
      low[row] = least<float>(low[row], own), high[row] = most<float>(high[row], own);
    }
  for (int64_t i = whole_runs; i < numbers; ++i) {
    const int place = int(i % 3);
    low[0][place] = positions[i] < low[0][place] ? positions[i] : low[0][place];
    high[0][place] = positions[i] > high[0][place] ? positions[i] : high[0][place];
  }
  for (int axis = 0; axis < 3; ++axis) {
    float least_ = low[0][axis], most_ = high[0][axis];
    for (int i = axis; i < 3 * LANES; i += 3) {
      const float a = low[i / LANES][i % LANES], b = high[i / LANES][i % LANES];
      least_ = a < least_ ? a : least_, most_ = b > most_ ? b : most_;
    }
    const float size = (most_ - least_) / count;
    box[axis] = least_, box[3 + axis] = size > float(FLAT_M) ? size : float(FLAT_M);
  }
  Row<float> corner[3], size[3];
  for (int i = 0; i < 3 * LANES; ++i) corner[i / LANES][i % LANES] = box[i % 3],
      size[i / LANES][i % LANES] = box[3 + i % 3];
  const float round = 1.5f * 8388608.f;  // added and taken away, it rounds a smaller number to a whole one
  typedef uint16_t Steps __attribute__((ext_vector_type(16)));
  for (int64_t begin = 0; begin < whole_runs; begin += 3 * LANES)
    for (int row = 0; row < 3; ++row) {
      Row<float> turned = (row_at(positions + begin + LANES * row) - corner[row]) / size[row];
      turned = turned + round;
      turned = turned - round;
      store(steps + begin + LANES * row, __builtin_convertvector(__builtin_convertvector(turned, Indices), Steps));
    }
  for (int64_t i = whole_runs; i < numbers; ++i) {
    float turned = (positions[i] - box[i % 3]) / box[3 + i % 3] + round;
    steps[i] = uint16_t(int32_t(turned - round));
  }
}
#endif
