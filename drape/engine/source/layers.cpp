// Garments over and below each other, and steps of positions.
#include "exports.hpp"
#include "layers.hpp"
#include "quantise.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_heights_##suffix(const T* x, const Sheet<T>* sheet, const int32_t* own, const Array<T>* skin,   \
                                    const SkinGraph<T>* graph, T* height, Scratch* scratch) {                          \
    const Flushed flushed;                                                                                             \
    layers::heights_over(x, *sheet, own, skin_of(*skin, *graph), height, *scratch);                                    \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_ceiling_##suffix(const T* x, const Sheet<T>* sheet, const int32_t* index, const Array<T>* skin, \
                                    const SkinGraph<T>* graph, T* ceiling, Scratch* scratch) {                         \
    const Flushed flushed;                                                                                             \
    layers::ceiling_over(x, *sheet, index, skin_of(*skin, *graph), ceiling, *scratch);                                 \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_press_##suffix(T* x, const Sheet<T>* sheet, const int32_t* own, const Array<T>* ground,         \
                                  const SkinGraph<T>* graph, const T* ceiling, Scratch* scratch) {                     \
    const Flushed flushed;                                                                                             \
    bool found = layers::press(x, *sheet, own, skin_of(*ground, *graph), ceiling, *scratch);                           \
    return scratch->overflowed ? -1 : found;                                                                           \
  }

INSTANCES

#ifndef FOR_TESTS
EXPORT void drape_quantise_f32(const float* positions, int64_t vertices, double count, uint16_t* steps, float* box) {
  quantise(positions, vertices, float(count), steps, box);
}
#endif
