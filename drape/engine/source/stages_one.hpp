// The solve of a card (whole.hpp): a few products with sparse matrices, each of which all threads compute at once.
//
// Parts of the cloth that do not touch are eliminated together, stage by stage, and what is left is a dense inverse
// (drape/live/card.py). A block of sixteen numbers of the result is the sum of columns, each times a number of y or, on
// the way up, of s.
#pragma once
#include "records.hpp"
#include "rows.hpp"

template <class T> INLINE int64_t solve_room(const StiffnessFactor<T>& factor) { return 3 * factor.place.count; }

template <class T> DEVICE const T* solve(const StiffnessFactor<T>& factor, T* y, T* s) {
  const SolveStages<T>& stages = factor.stages;
  const int32_t count = int32_t(factor.place.count);
  for (int64_t stage = 0; stage < stages.block.count - 1; ++stage)
    for (int64_t block : each_block(stages.block[stage], stages.block[stage + 1])) {
      const int32_t to = stages.to[LANES * block + lane()];
      auto product = [&](Vector<T> sum, int64_t entry) {
        const int32_t from = stages.taken[entry];
        return plus(sum, stages.value[LANES * entry + lane()], from < count ? point(y, from) : point(s, from - count));
      };
      Vector<T> sum[4] = {};  // none waits for the one before, and each rounds less
      int64_t entry = stages.entry[block], last = stages.entry[block + 1];
      for (; entry + 3 < last; entry += 4)
        for (int n = 0; n < 4; ++n) sum[n] = product(sum[n], entry + n);
      for (; entry < last; ++entry) sum[0] = product(sum[0], entry);
      const Vector<T> total = (sum[0] + sum[1]) + (sum[2] + sum[3]);
      if (to < 0) continue;
      if (to < count)
        put_point(y, to, point(y, to) + total);
      else
        put_point(s, to - count, total);
    }
  return s;
}
