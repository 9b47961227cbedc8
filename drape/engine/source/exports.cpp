// The C ABI. Every function takes flat arrays and records (records.hpp) that the caller keeps.
#include "layers.hpp"
#include "levels.hpp"
#include "network.hpp"
#include "quantise.hpp"
#include "swing.hpp"

EXPORT uint64_t drape_records_hash() { return RECORDS_HASH; }

double exponential_of(double x) {
  // x = n ln 2 + r, |r| <= ln 2 / 2; the series of e^r, times 2^n. Within two units in the last place.
  if (!(x > -700)) return x == x ? 0 : x;
  const double n = __builtin_floor(x * 1.4426950408889634 + 0.5);
  const double r = (x - n * 0.6931471803691238) - n * 1.9082149292705877e-10;
  double sum = 1;
  for (int i = 14; i > 0; --i) sum = 1 + r / i * sum;
  union { uint64_t bits; double value; } power = {uint64_t(int64_t(n) + 1023) << 52};
  return sum * power.value;
}

#define FOR_TYPE(T, suffix)                                                                                           \
  EXPORT void drape_descend_##suffix(T* x, const Sheet<T>* sheet, const T* planes, const T* network) {                \
    descend(x, *sheet, planes, network);                                                                              \
  }                                                                                                                   \
  EXPORT void drape_gradient_##suffix(const T* x, const Sheet<T>* sheet, const T* planes, const T* network, T hold,   \
                                      T* gradient) {                                                                  \
    gradient_at(x, *sheet, planes, network, hold, gradient);                                                          \
  }                                                                                                                   \
  EXPORT void drape_whole_step_##suffix(T* x, const StiffnessFactor<T>* factor, const T* gradient, T share, T* q,     \
                                        T* s) {                                                                       \
    whole_step(x, *factor, gradient, share, q, s);                                                                    \
  }                                                                                                                   \
  EXPORT int drape_fold_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around,         \
                                 const FoldConstants<T>* cloth, const FoldEffort<T>* effort, FoldMemory<T>* after,    \
                                 T* folded, FoldOutcome* outcome, Scratch* scratch) {                                 \
    *outcome = fold_one_level(vertices, *past, *around, *cloth, *effort, *after, folded, *scratch);                   \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_fold_two_levels_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around, \
                                            const Levels<T>* levels, const FoldEffort<T>* effort, FoldMemory<T>* after, \
                                            T* folded, FoldOutcome* outcome, Scratch* scratch) {                      \
    *outcome = fold_two_levels(vertices, *past, *around, *levels, *effort, *after, folded, *scratch);                 \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_lift_alone_##suffix(const T* vertices, const FoldMemory<T>* past, const Surroundings<T>* around,   \
                                       const Levels<T>* levels, const FoldEffort<T>* effort, FoldMemory<T>* after,    \
                                       T* folded, FoldOutcome* outcome, Scratch* scratch) {                           \
    *outcome = lift_alone(vertices, *past, *around, *levels, *effort, *after, folded, *scratch);                      \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_swing_##suffix(const T* vertices, int64_t count, const SwingMemory<T>* past,                       \
                                  const Surroundings<T>* around, const SwingConstants<T>* cloth, T share,             \
                                  SwingMemory<T>* after, T* out, Scratch* scratch) {                                  \
    bool moved = swing::frame(vertices, count, *past, *around, *cloth, share, *after, out, *scratch);                 \
    return scratch->overflowed ? -1 : moved;                                                                          \
  }                                                                                                                   \
  EXPORT int drape_pose_body_##suffix(const Weights<T>* weights, const BodyFeed<T>* feed, PosedBody<T>* body,         \
                                      Scratch* scratch) {                                                             \
    pose_body(*weights, *feed, *body, *scratch);                                                                      \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_jets_##suffix(const Weights<T>* weights, const PatchRows<T>* rows, const PosedBody<T>* body,       \
                                 int64_t passes, PosedJets<T>* jets, Scratch* scratch) {                              \
    bool finite = network::pose_jets(*weights, *rows, *body, passes, *jets, *scratch);                                \
    return scratch->overflowed ? -1 : finite;                                                                         \
  }                                                                                                                   \
  EXPORT int drape_vertices_##suffix(const PosedJets<T>* jets, const Tiles<T>* tiles, T* vertices, int64_t count,     \
                                     Scratch* scratch) {                                                              \
    network::blend_vertices(*jets, *tiles, vertices, count, *scratch);                                                \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_heights_##suffix(const T* x, const Sheet<T>* sheet, const int32_t* own, const Array<T>* skin,      \
                                    const SkinGraph<T>* graph, T* height, Scratch* scratch) {                         \
    layers::heights_over(x, *sheet, own, skin_of(*skin, *graph), height, *scratch);                                   \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_ceiling_##suffix(const T* x, const Sheet<T>* sheet, const int32_t* index, const Array<T>* skin,    \
                                    const SkinGraph<T>* graph, T* ceiling, Scratch* scratch) {                        \
    layers::ceiling_over(x, *sheet, index, skin_of(*skin, *graph), ceiling, *scratch);                                \
    return scratch->overflowed;                                                                                       \
  }                                                                                                                   \
  EXPORT int drape_press_##suffix(T* x, const Sheet<T>* sheet, const int32_t* own, const Array<T>* ground,            \
                                  const SkinGraph<T>* graph, const T* ceiling, Scratch* scratch) {                    \
    bool found = layers::press(x, *sheet, own, skin_of(*ground, *graph), ceiling, *scratch);                          \
    return scratch->overflowed ? -1 : found;                                                                          \
  }

FOR_TYPE(float, f32)
#ifdef WITH_DOUBLES
FOR_TYPE(double, f64)
#endif

EXPORT void drape_quantise(const float* positions, int64_t vertices, float count, uint16_t* steps, float* box) {
  quantise(positions, vertices, count, steps, box);
}
