// The lift: the last thing in a frame, which brings cloth that is still in the skin up to the clearance.
//
// Contact in the energy is a spring, and a few steps leave in the skin what came into it quickly. Each vertex that is
// lower than the clearance h over a plane through p with the normal n goes up along it,
//
//     x += share fade max(0, low) n,   low = h - n . (x - p),
//
// fade 1 up to DEEP_M, which stretched cloth reaches in one frame of a raised arm, and 0 from TOO_DEEP_M on, where the
// plane goes on beside the skin that it stands for. A quarter of the way out of the plane of another part comes first,
// then all of the way out of that of the own part. Two parts of the body that overlap leave room for neither; going all
// of the way out of both would tear the cloth at the border, and it is the own skin that has to be hidden. The planes
// are those of the frame's contact, so that no skin is searched. The next frame begins with the lifted cloth, as in
// position-based dynamics (Mueller et al. 2007, "Position Based Dynamics", J. Vis. Commun. Image Represent. 18(2)).
#pragma once
#include "skin.hpp"

constexpr double OTHER_SHARE = 0.25;                  // of the way out of another part
constexpr double DEEP_M = 0.04, TOO_DEEP_M = 0.06;  // below the clearance

// Returns the points after a share of their way up to the clearance [m] over planes with the points foot and normals.
// Points that are higher or too deep stay. Where there is no plane its normal is zero.
template <class T> INLINE Points<T> above(Points<T> points, Points<T> foot, Points<T> normal, T clearance, T share) {
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Row<T> low = clearance - dot(points - foot, normal);
  Row<T> left = least<T>(most<T>(one - T(1.0 / (TOO_DEEP_M - DEEP_M)) * (low - T(DEEP_M)), zero), one);
  return plus(points, where<T>(low > zero, share * left * low, zero), normal);
}

template <class T> INLINE void put_lifted(T* x, T* way, Points<T> before, Points<T> after) {
  put_points(x, after);
  put(way, root<T>(dot(after - before, after - before)));
}

// Moves x [m] (P, 3) in place up to the clearance [m] over planes, and writes how far each place went to way [m] (P,).
template <class T> DEVICE void lift(T* x, int64_t places, const T* planes, T clearance, T* way) {
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block;
    Points<T> before = points_in(x + 3 * first);
    const T *own = planes + PLANES * block + OWN_PLANE, *other = planes + PLANES * block + OTHER_PLANE;
    Points<T> after = above<T>(before, rows3_at(other), rows3_at(other + 3 * LANES), clearance, T(OTHER_SHARE));
    after = above<T>(after, rows3_at(own), rows3_at(own + 3 * LANES), clearance, T(1));
    put_lifted(x + 3 * first, way + first, before, after);
  }
}
