// Offline physics: energy, gradient, Hessian and guarded sweeps of a cloth over planes of the body, vertex by vertex.
//
// The energy is that of elements.hpp with every hinge, of weight, contact and two springs. Sweeps are those of vertex
// block descent (Chen et al. 2024, "Vertex Block Descent", ACM TOG 43(4)): one vertex after the other goes to the
// minimum of its own quadratic model.
#pragma once
#include "arrays.hpp"
#include "elements.hpp"

namespace physics {

constexpr int TRIES = 6;  // halvings of a guarded vertex's step before it stays

template <class T> struct Cloth {
  const Problem<T>& problem;
  const Around<T>& around;
  Fabric<T> k;
  Cloth(const Problem<T>& own, const Around<T>& there) : problem(own), around(there), k(own.constants) {}
};

template <class T> struct Felt {
  double energy;
  Vector<T> gradient;
  Symmetric<T> hessian;
};

template <class T> INLINE Symmetric<T> shifted(Symmetric<T> h, T s) {
  return {h.xx + s, h.xy, h.xz, h.yy + s, h.yz, h.zz + s};
}
template <class T> INLINE T stress_energy(Stress<T> s, Columns<T> f) {
  return T(0.5) * (T(0.5) * (s.pp * (dot(f.p, f.p) - T(1)) + s.tt * (dot(f.t, f.t) - T(1))) + s.pt * dot(f.p, f.t));
}

// Returns the gradient and Hessian of weight, contact and springs for vertex v at the point x [m].
template <class T> Felt<T> outside(Vector<T> x, int64_t v, const Cloth<T>& cloth) {
  const Problem<T>& problem = cloth.problem;
  const Around<T>& around = cloth.around;
  const Fabric<T>& k = cloth.k;
  const Vector<T> normal = point(around.normal.begin, v);
  const T weight = problem.weight_n[v];
  double energy = double(weight * x.y);
  Vector<T> gradient = {T(0), weight, T(0)};
  Symmetric<T> hessian = {};
  const T depth = k.gap - dot(x - point(around.point.begin, v), normal);
  if (depth > 0) {
    const T stiffness = problem.contact_n_per_m[v];
    energy += double(T(0.5) * stiffness * depth * depth);
    gradient = plus(gradient, -stiffness * depth, normal);
    hessian = outer(hessian, stiffness, normal);
  }
  if (const T spring = around.target_n_per_m[v]; spring > 0) {
    const Vector<T> way = x - point(around.target.begin, v);
    energy += double(T(0.5) * spring * dot(way, way));
    gradient = plus(gradient, spring, way);
    hessian = shifted(hessian, spring);
  }
  if (const T spring = around.band_n_per_m[v]; spring > 0) {
    const Vector<T> way = x - point(around.band.begin, v);
    const T length = root(dot(way, way));
    if (length > k.slack) {
      const T past = length - k.slack;
      energy += double(T(0.5) * spring * past * past);
      gradient = plus(gradient, spring * past / length, way);
      hessian = outer(shifted(hessian, spring * past / length), spring * k.slack / (length * length * length), way);
    }
  }
  return {energy, gradient, hessian};
}

// Returns the columns of the deformation gradient F of triangle f.
template <class T> INLINE Columns<T> columns_of(const T* x, const Triangles<T>& t, int64_t f) {
  const int32_t* corner = t.corner + 3 * f;
  const T* d = t.inverse + 4 * f;
  const Vector<T> origin = point(x, corner[0]);
  return columns(point(x, corner[1]) - origin, point(x, corner[2]) - origin, d[0], d[1], d[2], d[3]);
}

// Returns the energy [J] at x [m] (V, 3), and writes its gradient [N] (V, 3).
template <class T> double energy_and_gradient(const T* x, const Cloth<T>& cloth, T* gradient) {
  const Fabric<T>& k = cloth.k;
  double total = 0;
  for (int64_t v = 0; v < cloth.problem.weight_n.count; ++v) {
    const Felt<T> felt = outside(point(x, v), v, cloth);
    put_point(gradient, v, felt.gradient);
    total += felt.energy;
  }
  const Triangles<T>& t = cloth.problem.triangles;
  for (int64_t f = 0; f < t.area.count; ++f) {
    const int32_t* corner = t.corner + 3 * f;
    const T* d = t.inverse + 4 * f;
    const Columns<T> c = columns_of(x, t, f);
    const Stress<T> s = stress(c, t.area[f], k);
    total += double(stress_energy(s, c));
    const Vector<T> by_p = mix(s.pp, c.p, s.pt, c.t), by_t = mix(s.pt, c.p, s.tt, c.t);
    const Vector<T> by_first = mix(d[0], by_p, d[2], by_t), by_second = mix(d[1], by_p, d[3], by_t);
    add_point(gradient, corner[1], by_first);
    add_point(gradient, corner[2], by_second);
    add_point(gradient, corner[0], scaled(T(-1), by_first + by_second));
  }
  const Hinges<T>& hinges = cloth.problem.hinges;
  for (int64_t h = 0; h < hinges.stiffness.count; ++h) {
    const int32_t* vertex = hinges.corner + 4 * h;
    const Hinge<T> hinge_ = hinge_at(x, vertex, hinges.cosine[h], hinges.sine[h], k);
    Vector<T> by[4];
    fold_gradient(hinge_, hinges.cosine[h], hinges.sine[h], k, by);
    total += double(hinges.stiffness[h] * (T(1) - hinge_.scale * hinge_.value));
    for (int c = 0; c < 4; ++c) add_point(gradient, vertex[c], scaled(hinges.stiffness[h], by[c]));
  }
  return total;
}

// A triangle seen from one of its corners, which is at own: the columns of F, that corner's slopes, and the area.
template <class T> struct Corner { Columns<T> f; T mp, mt, area; };
template <class T> INLINE Corner<T> corner_at(const T* x, Vector<T> own, const Triangles<T>& t, int64_t entry) {
  const T* s = t.slope + 5 * entry;
  const Vector<T> first = point(x, t.other[2 * entry]) - own, second = point(x, t.other[2 * entry + 1]) - own;
  return {columns(first, second, s[0], s[2], s[1], s[3]), -s[0] - s[2], -s[1] - s[3], s[4]};
}

// Returns gradient [N] and positive Hessian [N/m] of vertex v: Gauss-Newton for triangles, with the stress that pulls,
// and for the angles of hinges, which count as stiff when folded as when flat, so that it bounds the curvature.
template <class T> Felt<T> vertex_model(const T* x, int64_t v, const Cloth<T>& cloth) {
  const Fabric<T>& k = cloth.k;
  const Vector<T> own = point(x, v);
  Felt<T> felt = outside(own, v, cloth);
  const Triangles<T>& t = cloth.problem.triangles;
  for (int64_t entry = t.start[v]; entry < t.start[v + 1]; ++entry) {
    const Corner<T> c = corner_at(x, own, t, entry);
    const Stress<T> s = stress(c.f, c.area, k);
    const T cp = c.mp * s.pp + c.mt * s.pt, ct = c.mp * s.pt + c.mt * s.tt, pull = cp * c.mp + ct * c.mt;
    felt.gradient = felt.gradient + mix(cp, c.f.p, ct, c.f.t);
    const T pp = c.area * (T(2) * k.warp * c.mp * c.mp + k.shear * c.mt * c.mt);
    const T tt = c.area * (T(2) * k.weft * c.mt * c.mt + k.shear * c.mp * c.mp);
    const T pt = c.area * (T(2) * k.cross + k.shear) * c.mp * c.mt;
    felt.hessian = squares(felt.hessian, pp, pt, tt, c.f.p, c.f.t, pull > 0 ? pull : T(0));
  }
  const Hinges<T>& hinges = cloth.problem.hinges;
  for (int64_t entry = hinges.start[v]; entry < hinges.start[v + 1]; ++entry) {
    const int64_t h = hinges.member[entry] / 4, place = hinges.member[entry] % 4;
    const int32_t* vertex = hinges.corner + 4 * h;
    const Hinge<T> hinge_ = hinge_at(x, vertex, hinges.cosine[h], hinges.sine[h], k);
    Vector<T> by[4];
    fold_gradient(hinge_, hinges.cosine[h], hinges.sine[h], k, by);
    felt.gradient = plus(felt.gradient, hinges.stiffness[h], by[place]);
    angle_gradient(hinge_, k, by);
    felt.hessian = outer(felt.hessian, hinges.stiffness[h], by[place]);
  }
  felt.hessian = shifted(felt.hessian, k.least);
  return felt;
}

// Returns the energy [J] of all elements of vertex v with v at own [m].
template <class T> double local_energy(const T* x, Vector<T> own, int64_t v, const Cloth<T>& cloth) {
  const Fabric<T>& k = cloth.k;
  double total = outside(own, v, cloth).energy;
  const Triangles<T>& t = cloth.problem.triangles;
  for (int64_t entry = t.start[v]; entry < t.start[v + 1]; ++entry) {
    const Corner<T> c = corner_at(x, own, t, entry);
    total += double(stress_energy(stress(c.f, c.area, k), c.f));
  }
  const Hinges<T>& hinges = cloth.problem.hinges;
  for (int64_t entry = hinges.start[v]; entry < hinges.start[v + 1]; ++entry) {
    const int64_t h = hinges.member[entry] / 4, place = hinges.member[entry] % 4;
    const int32_t* vertex = hinges.corner + 4 * h;
    Vector<T> corner[4] = {point(x, vertex[0]), point(x, vertex[1]), point(x, vertex[2]), point(x, vertex[3])};
    corner[place] = own;
    const Hinge<T> hinge_ = hinge(corner, hinges.cosine[h], hinges.sine[h], k);
    total += double(hinges.stiffness[h] * (T(1) - hinge_.scale * hinge_.value));
  }
  return total;
}

// Makes one sweep of vertex block descent over the vertices order (n,) of x [m] (V, 3), in place. With guarded, a step
// that does not lower the energy is halved, and left out after TRIES halvings.
template <class T> void sweep(T* x, const Cloth<T>& cloth, const int32_t* order, int64_t count, bool guarded) {
  const T reach = cloth.k.reach;
  for (int64_t n = 0; n < count; ++n) {
    const int64_t v = order[n];
    const Vector<T> own = point(x, v);
    const Felt<T> felt = vertex_model(x, v, cloth);
    Vector<T> step = scaled(T(-1), solved(felt.hessian, felt.gradient));
    const T length = root(dot(step, step));
    if (length > reach) step = scaled(reach / length, step);
    T share = 1;
    if (guarded) {
      const double before = local_energy(x, own, v, cloth);
      int tries = 0;
      for (; tries < TRIES && !(local_energy(x, plus(own, share, step), v, cloth) <= before); ++tries) share *= T(0.5);
      if (tries == TRIES) share = 0;
    }
    put_point(x, v, plus(own, share, step));
  }
}

template <class T> INLINE void put_block(T* block, Symmetric<T> h) {
  const T of[9] = {h.xx, h.xy, h.xz, h.xy, h.yy, h.yz, h.xz, h.yz, h.zz};
  for (int i = 0; i < 9; ++i) block[i] = of[i];
}

// Writes the positive diagonal blocks [N/m] (V, 3, 3) with which sweeps move the vertices.
template <class T> void diagonal_blocks(const T* x, const Cloth<T>& cloth, T* blocks) {
  const int64_t count = cloth.problem.weight_n.count;
  for (int64_t v = 0; v < count; ++v) put_block(blocks + 9 * v, vertex_model(x, v, cloth).hessian);
}

template <class T> INLINE void add_product(T* block, Vector<T> a, Vector<T> b) {
  block[0] += a.x * b.x, block[1] += a.x * b.y, block[2] += a.x * b.z;
  block[3] += a.y * b.x, block[4] += a.y * b.y, block[5] += a.y * b.z;
  block[6] += a.z * b.x, block[7] += a.z * b.y, block[8] += a.z * b.z;
}

// Returns the stress without its pushing part: principal values below zero are zero.
template <class T> INLINE Stress<T> tension(Stress<T> s) {
  const T mean = T(0.5) * (s.pp + s.tt), off = T(0.5) * (s.pp - s.tt), radius = root(off * off + s.pt * s.pt);
  if (mean >= radius) return s;
  if (mean <= -radius || radius == 0) return {};
  const T share = T(0.5) * (mean + radius) / radius, low = mean - radius;
  return {share * (s.pp - low), share * (s.tt - low), share * s.pt};
}

// Adds the derivative of an angle's gradient, factor d(c_i n / q) = n / q dc_i + c_i (I - 2 n n^T / q) dn / q, to the
// sixteen blocks of a hinge, for one of its two triangles: the one with the corner third.
template <class T>
void add_angle_hessian(T* blocks, const int32_t* place, T factor, int third, const Hinge<T>& h, const Fabric<T>& k) {
  const Vector<T> e = h.e, arm = third == 2 ? h.a : h.b, n = third == 2 ? h.n1 : h.n2, none = {};
  const T sign = third == 2 ? 1 : -1, q = dot(n, n) + k.degenerate, length = root(dot(e, e) + k.degenerate);
  const T per = k.per_edge * k.per_edge / q * factor;
  const Vector<T> u = scaled(T(1) / length, e), minus = scaled(T(-1), u), normal = scaled(per, n);
  const T along = dot(arm, u);
  const Vector<T> height = scaled(T(1) / length, plus(arm, -along, u));
  const int places[3] = {0, 1, third};
  const T coefficient[3] = {length - along, along, -length};
  const Vector<T> slopes[3][3] = {{height, u - height, minus}, {minus - height, height, u}, {u, minus, none}};
  const Vector<T> opposite[3] = {scaled(sign, arm - e), scaled(-sign, arm), scaled(sign, e)};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const Vector<T> o = opposite[j], turned = scaled(T(2) / q, cross(n, o));
      const T c = coefficient[i] * per;
      T* block = blocks + 9 * int64_t(place[4 * places[i] + places[j]]);
      add_product(block, normal, slopes[i][j]);
      add_product(block, scaled(-c, n), turned);
      block[1] -= c * o.z, block[2] += c * o.y, block[3] += c * o.z;
      block[5] -= c * o.x, block[6] -= c * o.y, block[7] += c * o.x;
    }
}

// Writes the Hessian [N/m] to blocks (N, 3, 3), those of the pattern. It is the exact one for exact 1. For 0 it is
// positive: only tensile stress counts, hinges are as stiff as unfolded ones, and the curvature of their angle is left
// out. Values between mix the two.
template <class T> void assemble(const T* x, const Cloth<T>& cloth, const Pattern<T>& pattern, T exact, T* blocks) {
  const Fabric<T>& k = cloth.k;
  for (int64_t i = 0; i < 9 * pattern.column.count; ++i) blocks[i] = 0;
  const Triangles<T>& t = cloth.problem.triangles;
  for (int64_t f = 0; f < t.area.count; ++f) {
    const T *d = t.inverse + 4 * f, area = t.area[f];
    const Columns<T> c = columns_of(x, t, f);
    const Stress<T> all = stress(c, area, k), pulls = tension(all);
    const T pp = exact * all.pp + (T(1) - exact) * pulls.pp, tt = exact * all.tt + (T(1) - exact) * pulls.tt;
    const T pt = exact * all.pt + (T(1) - exact) * pulls.pt;
    const T slope[3][2] = {{-d[0] - d[1], -d[2] - d[3]}, {d[0], d[2]}, {d[1], d[3]}};
    for (int m = 0; m < 3; ++m)
      for (int n = 0; n < 3; ++n) {
        const T mp = slope[m][0], mt = slope[m][1], np = slope[n][0], nt = slope[n][1];
        T* block = blocks + 9 * int64_t(pattern.face[9 * f + 3 * m + n]);
        const T by_p = area * (T(2) * k.warp * mp * np + k.shear * mt * nt);
        const T by_t = area * (T(2) * k.weft * mt * nt + k.shear * mp * np);
        const T mixed = area * (T(2) * k.cross * mp * nt + k.shear * mt * np);
        const T back = area * (T(2) * k.cross * mt * np + k.shear * mp * nt);
        add_product(block, c.p, mix(by_p, c.p, mixed, c.t));
        add_product(block, c.t, mix(back, c.p, by_t, c.t));
        const T pull = pp * mp * np + tt * mt * nt + pt * (mp * nt + mt * np);
        block[0] += pull, block[4] += pull, block[8] += pull;
      }
  }
  const Hinges<T>& hinges = cloth.problem.hinges;
  for (int64_t h = 0; h < hinges.stiffness.count; ++h) {
    // k (cos d g g^T + sin d G), d the turn from rest, g and G the derivatives of the angle
    const int32_t *vertex = hinges.corner + 4 * h, *place = pattern.hinge + 16 * h;
    const T cosine = hinges.cosine[h], sine = hinges.sine[h], stiffness = hinges.stiffness[h];
    const Hinge<T> v = hinge_at(x, vertex, cosine, sine, k);
    Vector<T> g[4];
    angle_gradient(v, k, g);
    const T curve = stiffness * (T(1) - exact * (T(1) - v.scale * v.value));
    const T force = -exact * stiffness * v.scale * (v.length * v.rise * cosine + dot(v.n1, v.n2) * sine);
    for (int m = 0; m < 4; ++m)
      for (int n = 0; n < 4; ++n) add_product(blocks + 9 * int64_t(place[4 * m + n]), g[m], scaled(curve, g[n]));
    if (force == 0) continue;
    add_angle_hessian(blocks, place, force, 2, v, k);
    add_angle_hessian(blocks, place, force, 3, v, k);
  }
  for (int64_t v = 0; v < cloth.problem.weight_n.count; ++v) {
    T own[9];
    put_block(own, outside(point(x, v), v, cloth).hessian);
    for (int i = 0; i < 9; ++i) blocks[9 * int64_t(pattern.diagonal[v]) + i] += own[i];
  }
}

}  // namespace physics
