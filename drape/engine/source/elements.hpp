// Triangles and hinges: strain, stress, bending, and their derivatives by a corner.
//
// Membrane. With D the rest shape of a triangle, F = dx D^-1 has the columns p along the warp and t along the weft, and
//
//     E = A/8 (warp pp^2 + 2 cross pp tt + weft tt^2 + shear pt^2),   pp = p.p - 1, tt = t.t - 1, pt = p.t.
//
// The constants hold half of the fabric's warp, cross and weft and a quarter of its shear. A corner whose slopes along
// warp and weft are mp and mt moves p by mp and t by mt: its gradient is (mp spp + mt spt) p + (mp spt + mt stt) t with
// the stress times area spp, stt, spt.
//
// Hinge. E = stiffness (1 - cos(theta - theta0)), theta the signed angle between two triangles that share the edge e.
#pragma once
#include "records.hpp"
#include "rows.hpp"

// The cloth's constants as numbers of the kernel's own type.
template <class T> struct Fabric {
  T warp, cross, weft, shear, gap, slack, per_edge, degenerate, least, reach;
  INLINE_MEMBER explicit Fabric(const Constants<T>& k)
      : warp(T(k.warp)), cross(T(k.cross)), weft(T(k.weft)), shear(T(k.shear)), gap(T(k.gap)), slack(T(k.slack)),
        per_edge(T(k.per_edge)), degenerate(T(k.degenerate)), least(T(k.least)), reach(T(k.reach)) {}
};

template <class N> struct Columns { Vector<N> p, t; };
template <class N> struct Stress { N pp, tt, pt; };

// Returns the columns of the deformation gradient F, from the edges to the second and third corner and the slopes
// there.
template <class N> INLINE Columns<N> columns(Vector<N> first, Vector<N> second, N p1, N p2, N t1, N t2) {
  return {mix(p1, first, p2, second), mix(t1, first, t2, second)};
}

// Returns the stress times the area [N m].
template <class N, class T> INLINE Stress<N> stress(Columns<N> f, N area, const Fabric<T>& k) {
  N pp = dot(f.p, f.p) - T(1), tt = dot(f.t, f.t) - T(1), pt = dot(f.p, f.t);
  return {area * (k.warp * pp + k.cross * tt), area * (k.cross * pp + k.weft * tt), area * k.shear * pt};
}

// A hinge at four points: the vectors and numbers of its derivatives, and its fold 1 - cos(theta - theta0).
template <class T> struct Hinge {
  Vector<T> e, a, b, n1, n2;
  T q1, q2, scale, length, rise, value;
};

template <class T> INLINE Hinge<T> hinge(const Vector<T> (&corner)[4], T cosine, T sine, const Fabric<T>& k) {
  Hinge<T> h;
  h.e = scaled(k.per_edge, corner[1] - corner[0]);
  h.a = scaled(k.per_edge, corner[2] - corner[0]);
  h.b = scaled(k.per_edge, corner[3] - corner[0]);
  h.n1 = cross(h.e, h.a);
  h.n2 = cross(h.b, h.e);
  h.q1 = dot(h.n1, h.n1);
  h.q2 = dot(h.n2, h.n2);
  h.scale = T(1) / root(h.q1 * h.q2 + k.degenerate);
  h.length = root(dot(h.e, h.e) + k.degenerate);
  h.rise = dot(h.n1, h.b);
  h.value = cosine * dot(h.n1, h.n2) - sine * h.length * h.rise;
  return h;
}

// Returns the hinge at four vertices of x [m] (V, 3).
template <class T> INLINE Hinge<T> hinge_at(const T* x, const int32_t* vertex, T cosine, T sine, const Fabric<T>& k) {
  const Vector<T> corner[4] = {point(x, vertex[0]), point(x, vertex[1]), point(x, vertex[2]), point(x, vertex[3])};
  return hinge(corner, cosine, sine, k);
}

// Writes the derivatives [1/m] of the fold by each of the four corners.
template <class T> INLINE void fold_gradient(const Hinge<T>& h, T cosine, T sine, const Fabric<T>& k, Vector<T> (&out)[4]) {
  T cube = h.value * h.scale * h.scale * h.scale;
  Vector<T> by_n1 = plus(mix(-h.scale * cosine, h.n2, h.scale * sine * h.length, h.b), cube * h.q2, h.n1);
  Vector<T> by_n2 = mix(-h.scale * cosine, h.n1, cube * h.q1, h.n2);
  Vector<T> by_e = plus(cross(h.a, by_n1) + cross(by_n2, h.b), h.scale * sine * h.rise / h.length, h.e);
  Vector<T> by_b = plus(cross(h.e, by_n2), h.scale * sine * h.length, h.n1);
  out[1] = scaled(k.per_edge, by_e);
  out[2] = scaled(k.per_edge, cross(by_n1, h.e));
  out[3] = scaled(k.per_edge, by_b);
  out[0] = scaled(T(-1), out[1] + (out[2] + out[3]));
}

// Writes the derivatives [1/m] of the angle theta by each of the four corners; they stay finite where a triangle has no
// area.
template <class T> INLINE void angle_gradient(const Hinge<T>& h, const Fabric<T>& k, Vector<T> (&out)[4]) {
  T length = root(dot(h.e, h.e) + k.degenerate);
  T over1 = k.per_edge / (h.q1 + k.degenerate), over2 = k.per_edge / (h.q2 + k.degenerate);
  T along1 = dot(h.a, h.e) / length, along2 = dot(h.b, h.e) / length;
  out[0] = mix((length - along1) * over1, h.n1, (length - along2) * over2, h.n2);
  out[1] = mix(along1 * over1, h.n1, along2 * over2, h.n2);
  out[2] = scaled(-length * over1, h.n1);
  out[3] = scaled(-length * over2, h.n2);
}
