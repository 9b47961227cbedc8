// Garments over and below each other, and steps of positions.
#include "layers.hpp"
#include "parts.hpp"
#include "quantise.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_heights_##suffix(const T* vertices, const LaidCloth<T>* cloth, const int32_t* own,              \
                                        const T* skin, int64_t samples, T* height, Scratch* scratch) {                 \
    const Flushed flushed;                                                                                             \
    layers::heights_over(vertices, *cloth, own, skin_of(skin, samples, cloth->graph), height, *scratch);               \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_ceiling_##suffix(const T* vertices, const LaidCloth<T>* cloth, const T* skin, int64_t samples,  \
                                        T* ceiling, Scratch* scratch) {                                                \
    const Flushed flushed;                                                                                             \
    layers::ceiling_over(vertices, *cloth, skin_of(skin, samples, cloth->graph), ceiling, *scratch);                   \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_press_##suffix(const T* vertices, const LaidCloth<T>* cloth, const int32_t* own,                \
                                      const T* ground, int64_t samples, const T* ceiling, T* pressed,                  \
                                      Scratch* scratch) {                                                              \
    const Flushed flushed;                                                                                             \
    const Skin<T> skin = skin_of(ground, samples, cloth->graph);                                                       \
    const bool found = layers::press(vertices, *cloth, own, skin, ceiling, pressed, *scratch);                         \
    return scratch->overflowed ? -1 : found;                                                                           \
  }

INSTANCES

#ifndef FOR_TESTS
EXPORT void drape_quantise_f32(const float* positions, int64_t vertices, double count, uint16_t* steps, float* box) {
  quantise(positions, vertices, float(count), steps, box);
}
#endif
