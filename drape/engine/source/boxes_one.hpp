// Boxes near a thread's own point or triangle, for searches of a card (room.hpp, untangle.hpp): they find what those of
// a processor find (clusters.hpp).
#pragma once
#include "clusters.hpp"

template <class T> INLINE T box_square(Vector<T> low, Vector<T> high, const T* boxes, int64_t b) {
  const T* box = boxes + BOX_ROWS * (b / LANES);
  const Vector<T> lowest = lane3(box, int(b % LANES)), highest = lane3(box + 3 * LANES, int(b % LANES));
  const T x = most<T>(most<T>(lowest.x - high.x, low.x - highest.x), T(0));
  const T y = most<T>(most<T>(lowest.y - high.y, low.y - highest.y), T(0));
  const T z = most<T>(most<T>(lowest.z - high.z, low.z - highest.z), T(0));
  return x * x + y * y + z * z;
}
// Calls see(b), in rising order, for each cluster from first on whose box is nearer than the root of reach [m^2] to the
// box from low to high.
template <class T, class See>
INLINE void see_near(Vector<T> low, Vector<T> high, const Boxes<T>& boxes, int64_t first, const T& reach, See see) {
  const int64_t groups = whole_blocks(boxes.count);
  for (int64_t group = first / LANES; group < groups; ++group) {
    if (!(box_square(low, high, boxes.groups, group) < reach)) continue;
    const int64_t last = less<int64_t>(boxes.count, LANES * (group + 1));
    for (int64_t b = more<int64_t>(first, LANES * group); b < last; ++b)
      if (box_square(low, high, boxes.of, b) < reach) see(b);
  }
}
