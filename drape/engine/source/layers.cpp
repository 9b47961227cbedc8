// Garments over and below each other, and steps of positions.
#include "exports.hpp"
#include "layers.hpp"
#include "quantise.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int drape_heights_##suffix(const T* x, const Sheet<T>* sheet, const int32_t* own, const Array<T>* skin,       \
                                    const SkinGraph<T>* graph, T* height, Scratch* scratch) {                          \
    layers::heights_over(x, *sheet, own, skin_of(*skin, *graph), height, *scratch);                                    \
    return scratch->overflowed;                                                                                        \
  }                                                                                                                    \
  EXPORT int drape_ceiling_##suffix(const T* x, const Sheet<T>* sheet, const int32_t* index, const Array<T>* skin,     \
                                    const SkinGraph<T>* graph, T* ceiling, Scratch* scratch) {                         \
    layers::ceiling_over(x, *sheet, index, skin_of(*skin, *graph), ceiling, *scratch);                                 \
    return scratch->overflowed;                                                                                        \
  }                                                                                                                    \
  EXPORT int drape_press_##suffix(T* x, const Sheet<T>* sheet, const int32_t* own, const Array<T>* ground,             \
                                  const SkinGraph<T>* graph, const T* ceiling, Scratch* scratch) {                     \
    bool found = layers::press(x, *sheet, own, skin_of(*ground, *graph), ceiling, *scratch);                           \
    return scratch->overflowed ? -1 : found;                                                                           \
  }

INSTANCES

EXPORT void drape_quantise(const float* positions, int64_t vertices, float count, uint16_t* steps, float* box) {
  quantise(positions, vertices, count, steps, box);
}
