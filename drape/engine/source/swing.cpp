// Swing.
#include "parts.hpp"
#include "swing.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_swing_##suffix(const T* vertices, int64_t count, const SwingMemory<T>* past,                    \
                                      const Surroundings<T>* around, const SwingConstants<T>* cloth, double share,     \
                                      SwingMemory<T>* after, T* out, Scratch* scratch) {                               \
    const Flushed flushed;                                                                                             \
    bool moved = swing::frame(vertices, count, *past, *around, *cloth, T(share), *after, out, *scratch);               \
    return scratch->overflowed ? -1 : moved;                                                                           \
  }

INSTANCES
