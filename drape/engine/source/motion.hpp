// What motion adds to the code of a pose: the recurrent part of the body encoder (training.recurrent).
//
// A gated recurrent unit without biases, in seconds: with a step of REFERENCE_DT_S and no calming it is the common one,
// and shorter and longer steps take their share of the way. Each step first lowers the size of the state, its root mean
// square, as exp(-t / decay) minus a constant, which reaches zero; what follows may turn the state, but makes it larger
// only by the size of the input. So a body that stands still comes to a state of exactly zero.
#pragma once
#include "body.hpp"

constexpr double REFERENCE_DT_S = 1.0 / 30.0, LEAST_SIZE = 1e-12;
constexpr double MOTION_LIMIT = 10.0;  // scaled features beyond it are a glitch or a teleport

template <class T> INLINE T mean_square_root(const T* x, int64_t count) {
  T sum = 0;
  for (int64_t i = 0; i < count; ++i) sum += x[i] * x[i];
  return root(sum / T(count));
}

template <class T> INLINE Row<T> sigmoid(Row<T> a) { return T(1) / (T(1) + exponential<T>(-a)); }

// Writes codes (N, outputs filled up to whole rows) and next states (N, H) of N bodies with motion features (N, 24, m)
// and states (N, H) before, after steps dt_s [s] (N,).
template <class T>
void advance_motion(const MotionEncoder<T>& w, const T* features, const T* state, const T* dt_s, int64_t bodies,
    T* code, T* next, Scratch& scratch) {
  const int64_t mark = scratch.used, per_joint = w.scale.count / JOINTS, size = w.out.weight.count / w.out.bias.count;
  const int64_t said = w.body[0].weight.count / w.body[0].bias.count / JOINTS;  // of a joint
  T *scaled_ = scratch.take<T>(per_joint), *hidden = scratch.take<T>(w.joint[0].bias.count);
  T *joints = scratch.take<T>(said * JOINTS + LANES), *first = scratch.take<T>(w.body[0].bias.count);
  T *x = scratch.take<T>(w.body[1].bias.count), *s = scratch.take<T>(size + LANES);
  T* moved = scratch.take<T>(size + LANES);
  T *by_input = scratch.take<T>(w.input.bias.count + LANES), *by_state = scratch.take<T>(w.state.bias.count + LANES);
  if (scratch.overflowed) return;
  for (int64_t body = 0; body < bodies; ++body) {
    for (int joint = 0; joint < JOINTS; ++joint) {
      for (int64_t i = 0; i < per_joint; ++i) {
        const T own = features[per_joint * joint + i] * w.scale[per_joint * joint + i];
        scaled_[i] = own < T(-MOTION_LIMIT) ? T(-MOTION_LIMIT) : own > T(MOTION_LIMIT) ? T(MOTION_LIMIT) : own;
      }
      run_body_layer(w.joint[0], scaled_, hidden);
      run_body_layer(w.joint[1], hidden, joints + said * joint);  // what fills its row up is written over by the next
    }
    run_body_layer(w.body[0], joints, first);
    run_body_layer(w.body[1], first, x);

    const T before = mean_square_root(state, size), left = T(exponential_of(-double(dt_s[body]) / w.decay_s));
    const T calm = more((before + T(w.offset)) * left - T(w.offset), T(0)), kept = calm / more(before, T(LEAST_SIZE));
    for (int64_t i = 0; i < size; ++i) s[i] = state[i] * kept;
    for (int64_t i = 0; i < LANES; ++i) s[size + i] = 0;
    run_body_layer(w.input, x, by_input);
    run_body_layer(w.state, s, by_state);
    const T step = T(double(dt_s[body]) / REFERENCE_DT_S);
    for (int64_t i = 0; i < size; i += LANES) {
      Row<T> old = row_at(s + i), reset = sigmoid<T>(row_at(by_input + i) + row_at(by_state + i));
      Row<T> fresh = tangent<T>(row_at(by_input + 2 * size + i) + reset * row_at(by_state + 2 * size + i));
      Row<T> share = sigmoid<T>(-(row_at(by_input + size + i) + row_at(by_state + size + i))) * step;
      put(moved + i, old + least<T>(share, row_of(T(1))) * (fresh - old));
    }
    const T largest = calm + mean_square_root(by_input + 2 * size, size);
    const T fits = largest / more(mean_square_root(moved, size), T(LEAST_SIZE));  // no number where the input has none
    for (int64_t i = 0; i < size; ++i) next[i] = moved[i] * (fits > T(1) ? T(1) : fits);
    run_body_layer(w.out, next, code);
    features += JOINTS * per_joint, state += size, next += size, code += w.out.bias.count;
  }
  scratch.used = mark;
}
