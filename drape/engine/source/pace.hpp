// The pace of folds: what a frame keeps, by how fast the network moves the cloth and how stiff that is.
#pragma once
#include "platform.hpp"

// The share of the last step's way that comes before a step: in slow motion, and in fast motion of soft and stiff
// cloth.
constexpr double MOMENTUM = 0.9, FAST_MOMENTUM = 0.7, STIFF_MOMENTUM = 0.5;
// That of a frame without a past with at least so many rounds: sixty rounds then come as far as five hundred with 0.9.
// Eight rounds would come less far.
constexpr double SETTLING_MOMENTUM = 0.98;
constexpr int64_t LONG_ROUNDS = 16;
constexpr double SLOW_M = 0.01, FAST_M = 0.02;  // RMS way of the network's vertices a frame: slow, fast
// Mean membrane stiffness along warp and weft from which cloth counts as stiff: denim, satin, poplin, but no knit.
constexpr double STIFF_N_PER_M = 1000.0;
// Shaken cloth creeps: the share of friction that is left where the network moves by so much a second or more.
constexpr double SHAKEN = 0.5, SHAKEN_M_S = 0.1;

// The steps by which folds of the frame before are carried into a frame, and the sweeps after its steps.
struct Pace { int64_t carries, sweeps; };

// Returns 1 where the network moves its vertices by little, of a way_m [m] in the frame, down to 0 where it moves them
// far.
INLINE double calmness(double way_m) {
  double calm = (FAST_M - way_m) / (FAST_M - SLOW_M);
  return calm > 0 ? (calm < 1 ? calm : 1) : 0;
}

// Returns the share of friction with the skin that holds where the network moves its vertices by way_m [m] in step_s
// [s].
INLINE double grip_left(double way_m, double step_s) {
  double shaken = way_m / (SHAKEN_M_S * step_s);
  return 1 - (1 - SHAKEN) * (shaken < 1 ? shaken : 1);
}

// Returns the share of its last way that cloth keeps. Steps answer to where cloth was, and stiff cloth crumples by what
// fast motion brings along, so it keeps less.
INLINE double momentum_of(double calm, bool stiff) {
  const double least = stiff ? STIFF_MOMENTUM : FAST_MOMENTUM;
  return least + calm * (MOMENTUM - least);
}
