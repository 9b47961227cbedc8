// Conjugate gradients for systems of 3 x 3 blocks: symmetric Gauss-Seidel and patch charts as preconditioner.
#pragma once
#include "arrays.hpp"
#include "records.hpp"
#include "vectors.hpp"

namespace linear {

template <class T> INLINE Vector<T> product(const T* block, Vector<T> a) {
  return {block[0] * a.x + block[1] * a.y + block[2] * a.z, block[3] * a.x + block[4] * a.y + block[5] * a.z,
          block[6] * a.x + block[7] * a.y + block[8] * a.z};
}

template <class T> INLINE Vector<T> product_at(const System<T>& system, int64_t z, const T* x) {
  return product(system.blocks + 9 * z, point(x, system.pattern.column[z]));
}

template <class T> double inner(const T* a, const T* b, int64_t count) {
  double total = 0;
  for (int64_t v = 0; v < count; ++v) total += double(dot(point(a, v), point(b, v)));
  return total;
}

// Writes y = H x (V, 3), and returns x . y.
template <class T> double multiply(const System<T>& system, const T* x, T* y) {
  const Pattern<T>& p = system.pattern;
  double total = 0;
  for (int64_t v = 0; v < p.diagonal.count; ++v) {
    Vector<T> sum = {};
    for (int64_t z = p.start[v]; z < p.start[v + 1]; ++z) sum = sum + product_at(system, z, x);
    put_point(y, v, sum);
    total += double(dot(point(x, v), sum));
  }
  return total;
}

// Writes y = (D + U)^-1 D (D + L)^-1 r, with the inverse (V, 3, 3) of D; this operator is positive whatever L is.
template <class T> void gauss_seidel(const System<T>& system, const T* r, T* y) {
  const Pattern<T>& p = system.pattern;
  const int64_t count = p.diagonal.count;
  for (int64_t v = 0; v < count; ++v) {
    Vector<T> left = point(r, v);
    for (int64_t z = p.start[v]; z < p.diagonal[v]; ++z) left = left - product_at(system, z, y);
    put_point(y, v, product(system.inverse + 9 * v, left));
  }
  for (int64_t v = count - 1; v >= 0; --v) {
    Vector<T> sum = {};
    for (int64_t z = p.diagonal[v] + 1; z < p.start[v + 1]; ++z) sum = sum + product_at(system, z, y);
    put_point(y, v, point(y, v) - product(system.inverse + 9 * v, sum));
  }
}

// Room for the forces on the charts, and for their displacements (3 K,) under these; size is 0 where there are no
// charts.
template <class T> struct Coarse {
  T *force, *moved;
  int64_t size;
};

// Writes y = M^-1 r, Gauss-Seidel plus the solution on the charts, each of which has one displacement. Returns r . y.
template <class T> double precondition(const System<T>& system, const T* r, T* y, Coarse<T> coarse) {
  const int64_t count = system.pattern.diagonal.count, charts = system.charts.patch.count / count, size = coarse.size;
  const int32_t* patch = system.charts.patch;
  const T* weight = system.charts.weight;
  gauss_seidel(system, r, y);
  for (int64_t i = 0; i < size; ++i) coarse.force[i] = coarse.moved[i] = 0;
  for (int64_t v = 0; size && v < count; ++v)
    for (int64_t c = charts * v; c < charts * (v + 1); ++c)
      add_point(coarse.force, patch[c], scaled(weight[c], point(r, v)));
  // The matrix is symmetric, so it is read column by column, whose sums stand side by side.
  for (int64_t j = 0; j < size; ++j)
    for (int64_t i = 0; i < size; ++i) coarse.moved[i] += system.coarse[size * j + i] * coarse.force[j];
  for (int64_t v = 0; size && v < count; ++v)
    for (int64_t c = charts * v; c < charts * (v + 1); ++c)
      add_point(y, v, scaled(weight[c], point(coarse.moved, patch[c])));
  return inner(r, y, count);
}

// Writes out (size, size) = P^T H P of the blocks of H; P is the basis of size / 3 charts.
template <class T>
void galerkin(const Charts<T>& charts, const Pattern<T>& p, const T* blocks, T* out, int64_t size) {
  const int64_t count = p.diagonal.count, each = charts.patch.count / count;
  for (int64_t i = 0; i < size * size; ++i) out[i] = 0;
  for (int64_t v = 0; v < count; ++v)
    for (int64_t z = p.start[v]; z < p.start[v + 1]; ++z)
      for (int64_t a = each * v; a < each * (v + 1); ++a)
        for (int64_t b = each * p.column[z]; b < each * (p.column[z] + 1); ++b) {
          const T w = charts.weight[a] * charts.weight[b];
          if (w == 0) continue;
          T* to = out + size * 3 * charts.patch[a] + 3 * charts.patch[b];
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) to[size * i + j] += w * blocks[9 * z + 3 * i + j];
        }
}

// Writes moved (V, 3) such that H moved is near force, and returns the number of iterations, negative where H curved
// down. It ends when the norm of the residual is a share of that of force, after limit iterations, or on a direction of
// negative curvature, which is left out unless it is the first (Steihaug 1983, "The conjugate gradient method and trust
// regions in large scale optimization", SIAM J. Numer. Anal. 20(3)).
template <class T>
int64_t conjugate_gradients(const System<T>& system, const T* force, double share, int64_t limit, T* moved,
                            Scratch& scratch) {
  const int64_t mark = scratch.used, count = system.pattern.diagonal.count, n = 3 * count;
  int64_t size = 0;
  while (size * size < system.coarse.count) ++size;
  T *r = scratch.take<T>(n), *y = scratch.take<T>(n), *w = scratch.take<T>(n), *p = scratch.take<T>(n);
  const Coarse<T> coarse = {scratch.take<T>(size), scratch.take<T>(size), size};
  if (scratch.overflowed) return 0;
  for (int64_t i = 0; i < n; ++i) moved[i] = 0, r[i] = force[i], y[i] = 0;
  double before = precondition(system, r, y, coarse);
  const double bound = share * share * inner(force, force, count);
  for (int64_t i = 0; i < n; ++i) p[i] = y[i];
  int64_t done = limit;
  for (int64_t round = 0; round < limit; ++round) {
    const double curved = multiply(system, p, w);
    if (!(curved > 0)) {
      for (int64_t i = 0; round == 0 && i < n; ++i) moved[i] = p[i];
      done = -round - 1;
      break;
    }
    const T step = T(before / curved);
    for (int64_t i = 0; i < n; ++i) moved[i] += step * p[i], r[i] -= step * w[i];
    if (inner(r, r, count) <= bound) {
      done = round + 1;
      break;
    }
    const double now = precondition(system, r, y, coarse);
    const T ratio = T(now / before);
    before = now;
    for (int64_t i = 0; i < n; ++i) p[i] = y[i] + ratio * p[i];
  }
  scratch.used = mark;
  return done;
}

}  // namespace linear
