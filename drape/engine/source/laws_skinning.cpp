// Linear blend skinning, the floor of a frame: whoever delivers vertices moves them by bones at least.
#include <stdint.h>

#include "exports.hpp"

// Writes sum_k w_k (A_k x + t_k) of every place x [m] (count, 3) to moved, of four bones each: weight and bone are
// (count, 4), and bones (B, 3, 4) their matrices [A t].
EXPORT int64_t drape_law_skin_f32(const float* x, const float* weight, const int32_t* bone, const float* bones,
                                  int64_t count, float* moved) {
  for (int64_t i = 0; i < count; ++i) {
    float blend[12] = {};
    for (int64_t k = 0; k < 4; ++k) {
      const float share = weight[4 * i + k], *one = bones + 12 * bone[4 * i + k];
      for (int64_t j = 0; j < 12; ++j) blend[j] += share * one[j];
    }
    const float* p = x + 3 * i;
    for (int64_t row = 0; row < 3; ++row) {
      const float* m = blend + 4 * row;
      moved[3 * i + row] = m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3];
    }
  }
  return 0;
}
