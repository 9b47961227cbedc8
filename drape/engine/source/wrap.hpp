// A coarse mesh around the finer cloth that was simulated in its place: drape/garment/wrapping.py has the formulas.
#pragma once
#include "bound.hpp"

namespace wrapping {

// Writes the delivered vertices corners [m] (V, 3) that lie around the fine vertices [m] (N, 3) with faces (F, 3). The
// first V fine vertices are those of the corners; each of the others lies at the weights (N - V, 3) of three corners (N
// - V, 3). In the first steps a corner moves by the sum of what is missing at its fine vertices over counted (V,); in
// the deep steps by its mean, in which each counts by how much it is.
template <class T>
void wrap(const T* fine, int64_t fine_count, const int32_t* faces, int64_t face_count, const int32_t* corner,
          const T* weight, const T* counted, int64_t count, int64_t steps, int64_t deep, T* corners, Scratch& scratch) {
  T *normal = scratch.take<T>(3 * fine_count), *missing = scratch.take<T>(3 * count), *depths = scratch.take<T>(count);
  if (scratch.overflowed) return;
  __builtin_memset(normal, 0, sizeof(T) * size_t(3 * fine_count));
  bound::add_area_normals(fine, faces, face_count, normal);
  for (int64_t n = 0; n < fine_count; ++n) put_point(normal, n, bound::unit(point(normal, n)));
  __builtin_memcpy(corners, fine, sizeof(T) * size_t(3 * count));
  for (int64_t step = 0; step < steps + deep; ++step) {
    const bool by_depth = step >= steps;
    for (int64_t v = 0; v < count; ++v) {
      const Vector<T> up = point(normal, v);
      const T below = more(dot(up, point(fine, v) - point(corners, v)), T(0));
      put_point(missing, v, scaled(by_depth ? below * below : below, up));
      depths[v] = by_depth ? below : counted[v];
    }
    for (int64_t n = 0; n < fine_count - count; ++n) {
      const int32_t* own = corner + 3 * n;
      const T* share = weight + 3 * n;
      const Vector<T> two = mix(share[0], point(corners, own[0]), share[1], point(corners, own[1]));
      const Vector<T> place = plus(two, share[2], point(corners, own[2])), up = point(normal, count + n);
      const T below = dot(up, point(fine, count + n) - place), depth = by_depth ? below : T(1);
      if (!(below > 0)) continue;
      for (int k = 0; k < 3; ++k) {
        add_point(missing, own[k], scaled(depth * below * share[k], up));
        if (by_depth) depths[own[k]] += below * share[k];
      }
    }
    for (int64_t v = 0; v < count; ++v)
      if (depths[v] > T(1e-9)) put_point(corners, v, plus(point(corners, v), T(1) / depths[v], point(missing, v)));
  }
}

}  // namespace wrapping
