// Swing.
#include "exports.hpp"
#include "swing.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int drape_swing_##suffix(const T* vertices, int64_t count, const SwingMemory<T>* past,                        \
                                  const Surroundings<T>* around, const SwingConstants<T>* cloth, T share,              \
                                  SwingMemory<T>* after, T* out, Scratch* scratch) {                                   \
    bool moved = swing::frame(vertices, count, *past, *around, *cloth, share, *after, out, *scratch);                  \
    return scratch->overflowed ? -1 : moved;                                                                           \
  }

INSTANCES
