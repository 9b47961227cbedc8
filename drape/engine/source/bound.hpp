// Drawn vertices that hang on cloth: drape/garment/bound.py has the formulas.
#pragma once
#include "arrays.hpp"
#include "rows.hpp"
#include "vectors.hpp"

namespace bound {

// On the cloth, off it along its normal, or in the frame of a triangle.
enum Kind : uint8_t { ON, OFF, STIFF };

template <class T> INLINE Vector<T> unit(Vector<T> a) {
  return scaled(T(1) / more(root(dot(a, a)), T(1e-12)), a);
}

// Adds to normal (V, 3), at the corners of faces (F, 3), the faces' normals, as long as twice their areas [m^2].
template <class T>
INLINE void add_area_normals(const T* cloth, const int32_t* faces, int64_t face_count, T* normal) {
  for (int64_t f = 0; f < face_count; ++f) {
    const int32_t *own = faces + 3 * f;
    const Vector<T> a = point(cloth, own[0]);
    const Vector<T> area = cross(point(cloth, own[1]) - a, point(cloth, own[2]) - a);
    for (int k = 0; k < 3; ++k) add_point(normal, own[k], area);
  }
}

// Writes the vertices drawn [m] (D, 3) of a mesh that hangs on cloth [m] (V, 3). asked (n,) are the corners of OFF
// vertices; faces (F, 3) are all triangles that touch them.
template <class T>
void draw(const T* cloth, int64_t vertices, const int32_t* faces, int64_t face_count, const int32_t* asked,
          int64_t asked_count, const int32_t* corner, const T* weight, const T* offset, const uint8_t* kind, int64_t count,
          T* drawn, Scratch& scratch) {
  T* normal = scratch.take<T>(face_count ? 3 * vertices : 0);
  if (scratch.overflowed) return;
  if (face_count) __builtin_memset(normal, 0, sizeof(T) * size_t(3 * vertices));
  add_area_normals(cloth, faces, face_count, normal);
  for (int64_t n = 0; n < asked_count; ++n) put_point(normal, asked[n], unit(point(normal, asked[n])));
  for (int64_t d = 0; d < count; ++d) {
    const int32_t* own = corner + 3 * d;
    const T *share = weight + 3 * d, *off = offset + 3 * d;
    const Vector<T> a = point(cloth, own[0]);
    if (kind[d] == ON && share[0] == T(1)) {
      put_point(drawn, d, a);
      continue;
    }
    const Vector<T> b = point(cloth, own[1]), c = point(cloth, own[2]);
    Vector<T> place = plus(mix(share[0], a, share[1], b), share[2], c);
    if (kind[d] == OFF) {
      const Vector<T> out = mix(share[0], point(normal, own[0]), share[1], point(normal, own[1]));
      place = plus(place, off[2], plus(out, share[2], point(normal, own[2])));
    } else if (kind[d] == STIFF) {
      const Vector<T> along = unit(b - a), up = unit(cross(b - a, c - a)), across = cross(up, along);
      place = plus(plus(plus(place, off[0], along), off[1], across), off[2], up);
    }
    put_point(drawn, d, place);
  }
}

}  // namespace bound
