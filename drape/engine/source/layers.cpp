// Garments over and below each other, what hangs on them, and steps of positions.
#include "bound.hpp"
#include "layers.hpp"
#include "parts.hpp"
#include "quantise.hpp"
#include "wrap.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_heights_##suffix(const T* vertices, const LaidCloth<T>* cloth, const int32_t* own,              \
                                        const T* skin, int64_t samples, T* height, Scratch* scratch) {                 \
    const Flushed flushed;                                                                                             \
    layers::heights_over(vertices, *cloth, own, skin_of(skin, samples, cloth->graph), height, *scratch);               \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT void drape_raise_##suffix(const T* ground, int64_t samples, const T* height, T* raised) {                     \
    layers::raise(ground, samples, height, raised);                                                                    \
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
  }                                                                                                                    \
  EXPORT int64_t drape_draw_bound_##suffix(const T* cloth, int64_t vertices, const int32_t* faces, int64_t face_count, \
                                           const int32_t* asked, int64_t asked_count, const int32_t* corner,           \
                                           const T* weight, const T* offset, const uint8_t* kind, int64_t count,       \
                                           T* drawn, Scratch* scratch) {                                               \
    const Flushed flushed;                                                                                             \
    bound::draw(cloth, vertices, faces, face_count, asked, asked_count, corner, weight, offset, kind, count, drawn,    \
                *scratch);                                                                                             \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_wrap_##suffix(const T* fine, int64_t fine_count, const int32_t* faces, int64_t face_count,      \
                                     const int32_t* corner, const T* weight, const T* counted, int64_t count,          \
                                     int64_t steps, int64_t deep, T* corners, Scratch* scratch) {                      \
    const Flushed flushed;                                                                                             \
    wrapping::wrap(fine, fine_count, faces, face_count, corner, weight, counted, count, steps, deep, corners, *scratch);\
    return -scratch->overflowed;                                                                                       \
  }

INSTANCES

#ifndef FOR_TESTS
EXPORT void drape_quantise_f32(const float* positions, int64_t vertices, double count, uint16_t* steps, float* box) {
  quantise(positions, vertices, float(count), steps, box);
}
#endif
