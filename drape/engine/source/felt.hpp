// What corrections feel: the strain of posed charts and the force on their jets, and how near the body is.
//
// Strain (training.chart_consensus.strain_and_force, softened). At each of seven points the tangents t_u, t_v are those at
// rest plus what the jets add. With the products of unit vectors of PatchRows.unit, strain is linear in the products g
// of the tangents:
//
//     E11 = (aa g_uu - 1) / 2,   E22 = (bb g_uu + 2 bc g_uv + cc g_vv - 1) / 2,   2 E12 = ab g_uu + ac g_uv.
//
// Proximity (drape.contact.proximity, in the patches' own frames). Tangent planes of the body are looked up once, in
// the world; each pass moves points along the axes of their patch, and none deep below a plane.
#pragma once
#include "patches.hpp"

namespace network {

constexpr int POINTS = 7;                  // of strain and proximity
constexpr double SOFTENING = 4.0;          // 4 x / (1 + |4 x|)
constexpr double TRACE_SHARE = 0.3;        // of the strain's trace in the force that it makes: Poisson's effect
constexpr int STRAIN = 3 * POINTS;         // rows of the strain; behind them the force
constexpr int OWN_SAMPLES = 40, OTHER_SAMPLES = 2 * REGION_SIZE;  // of the own part, and of two regions of others
// rows of a block's planes: normal, offset, share and pull of points before two parts
constexpr int PLANES_FELT = 6 * 2 * POINTS;
constexpr double BANDWIDTH_M = 0.014, PER_BANDWIDTH = 1.0 / (BANDWIDTH_M * BANDWIDTH_M), LEAST_NORMAL = 1e-12;
// so far beside samples is beyond their end
constexpr double BESIDE_LOW_M2 = 0.026 * 0.026, BESIDE_HIGH_M2 = 0.016 * 0.016;
constexpr double AGREE_LOW = 0.35, AGREE_HIGH = 0.65;  // where mixed normals agree less, two surfaces are mixed
constexpr double HELD_M = 0.004, SOFT_M = 0.001;  // below a plane, where corrections are held, and how gently
constexpr double FELT_GAP_M = 0.006, UNIT_M = 0.01, DEEP_LOW_M = -0.060, DEEP_HIGH_M = -0.045;
constexpr double REGION_BIAS_M2 = 0.002;  // squared distance [m^2] that one logit of a region outweighs

template <class T> INLINE Row<T> soft(Row<T> a) { return a / (root<T>(a * a) + T(1)); }
template <class T> INLINE Row<T> ramp(Row<T> value, T low, T high) {
  return least<T>(most<T>((value - low) * (T(1) / (high - low)), row_of(T(0))), row_of(T(1)));
}

// The tangent of a point: at rest, and what the jets add to it by the derivatives (15,) of the basis there.
template <class T> INLINE Points<T> tangent_of(const T* jet, const T* rest, const T* terms) {
  Points<T> t = {row_at(rest), row_at(rest + LANES * POINTS), row_at(rest + 2 * LANES * POINTS)};
  for (int i = 1; i < PLANE; ++i) {  // the derivative of the constant is zero
    t.x = t.x + row_at(jet + LANES * i) * terms[i];
    t.y = t.y + row_at(jet + LANES * (PLANE + i)) * terms[i];
  }
  for (int i = 1; i < HEIGHT; ++i) t.z = t.z + row_at(jet + LANES * (2 * PLANE + i)) * terms[i];
  return t;
}

// Adds a force at a point, by the numbers (15,) of the basis there, to that on the jets.
template <class T> INLINE void add_force(T* force, Points<T> a, const T* terms) {
  for (int i = 0; i < PLANE; ++i) {
    put(force + LANES * i, row_at(force + LANES * i) + a.x * terms[i]);
    put(force + LANES * (PLANE + i), row_at(force + LANES * (PLANE + i)) + a.y * terms[i]);
  }
  for (int i = 2 * PLANE; i < 2 * PLANE + HEIGHT; ++i)
    put(force + LANES * i, row_at(force + LANES * i) + a.z * terms[i - 2 * PLANE]);
}

// Writes softened strain (21 rows) and force (27 rows) of the jets.
template <class T>
void feel_strain(const Weights<T>& weights, const Rows<T>& jets, const PatchRows<T>& rows, int64_t blocks,
    const Rows<T>& felt) {
  T force[LANES * JETS];
  for (int64_t block = 0; block < blocks; ++block) {
    const T *jet = jets.at(block), *still = rows.tangent + LANES * 6 * POINTS * block;
    const T* unit = rows.unit + LANES * 6 * POINTS * block;
    T* to = felt.at(block);
    for (int i = 0; i < JETS; ++i) put(force + LANES * i, T(0));
    for (int p = 0; p < POINTS; ++p) {
      const T *by_u = weights.basis_u + HEIGHT * p, *by_v = weights.basis_v + HEIGHT * p, *m = unit + LANES * p;
      Points<T> u = tangent_of<T>(jet, still + LANES * p, by_u);
      Points<T> v = tangent_of<T>(jet, still + LANES * (3 * POINTS + p), by_v);
      Row<T> uu = dot(u, u), uv = dot(u, v), vv = dot(v, v);
      Row<T> aa = row_at(m), ab = row_at(m + LANES * POINTS), ac = row_at(m + 2 * LANES * POINTS);
      Row<T> bb = row_at(m + 3 * LANES * POINTS), bc = row_at(m + 4 * LANES * POINTS),
          cc = row_at(m + 5 * LANES * POINTS);
      const T half = T(0.5 * SOFTENING), trace = T(TRACE_SHARE);
      Row<T> e = half * (aa * uu) - half, f = half * (bb * uu + T(2) * (bc * uv) + cc * vv) - half;
      Row<T> g = T(SOFTENING) * (ab * uu + ac * uv);
      put(to + LANES * p, soft<T>(e)), put(to + LANES * (POINTS + p), soft<T>(f)),
          put(to + LANES * (2 * POINTS + p), soft<T>(g));
      Row<T> by_e = (T(1) + trace) * e + trace * f, by_f = trace * e + (T(1) + trace) * f, by_g = T(0.5) * g;
      Row<T> by_uu = aa * by_e + bb * by_f + T(2) * (ab * by_g);  // twice the derivative by g_uu
      Row<T> by_uv = bc * by_f + ac * by_g, by_vv = cc * by_f;
      add_force<T>(force, mix(by_uu, u, by_uv, v), by_u);
      add_force<T>(force, mix(by_vv, v, by_uv, u), by_v);
    }
    for (int i = 0; i < JETS; ++i) put(to + LANES * (STRAIN + i), soft<T>(row_at(force + LANES * i)));
  }
}

// A point of the patches of a block [patch scales].
template <class T> INLINE Points<T> felt_point(const Weights<T>& weights, const T* jet, const T* place, int p) {
  const T* basis = weights.basis + HEIGHT * p;
  Points<T> at = {row_at(place + LANES * p), row_at(place + LANES * (POINTS + p)),
      row_at(place + LANES * (2 * POINTS + p))};
  for (int i = 0; i < PLANE; ++i) {
    at.x = at.x + row_at(jet + LANES * i) * basis[i];
    at.y = at.y + row_at(jet + LANES * (PLANE + i)) * basis[i];
  }
  for (int i = 0; i < HEIGHT; ++i) at.z = at.z + row_at(jet + LANES * (2 * PLANE + i)) * basis[i];
  return at;
}

// A surface of samples as points see it (drape.contact.field): with the means b, n and across of the samples' points,
// normals and products of both,
//
//     distance = 1/2 (n . x - across) + 1/2 n . (x - b) / |n|,
//
// and a unit normal. there fades out beyond the end of the surface, and where mixed normals do not agree.
template <class T> struct SurfaceOf {
  Points<T> normal;
  Row<T> distance, there;
};
template <class T> INLINE SurfaceOf<T> surface(Points<T> at, Points<T> mean, Points<T> normal, Row<T> across) {
  const Row<T> length = root<T>(most<T>(dot(normal, normal), row_of(T(LEAST_NORMAL))));
  const Points<T> unit = {normal.x / length, normal.y / length, normal.z / length}, off = at - mean;
  const Row<T> along = dot(unit, off), beside = dot(off, off) - along * along;
  return {unit, T(0.5) * (dot(normal, at) - across + along),
          ramp<T>(beside, T(BESIDE_LOW_M2), T(BESIDE_HIGH_M2)) * ramp<T>(length, T(AGREE_LOW), T(AGREE_HIGH))};
}

// The samples near a block's points: their eight numbers one after the other, and their biases, a row each.
template <class T> struct NearSamplesOf {
  T table[8 * LANES * OWN_SAMPLES], bias[LANES * OWN_SAMPLES];
  INLINE_MEMBER void take(const T* skin, const int32_t* index, int s) {
    FourRows<T> p = samples_at(skin, index, 0), n = samples_at(skin, index, 4);
    T* to = table + 8 * LANES * s;
    put(to, p.a), put(to + LANES, p.b), put(to + 2 * LANES, p.c), put(to + 3 * LANES, p.d);
    put(to + 4 * LANES, n.a), put(to + 5 * LANES, n.b), put(to + 6 * LANES, n.c), put(to + 7 * LANES, n.d);
  }
};

// Writes the planes of a block of the means of count samples about each point: local in the frames, places in the
// world.
template <class T>
void write_felt_planes(const NearSamplesOf<T>& near, int count, Row<T> there, const Points<T> (&local)[POINTS],
    const Points<T> (&places)[POINTS], const T* frame, T* planes) {
  T logits[LANES * OWN_SAMPLES];
  const Row<T> zero = row_of(T(0));
  Row<T> unit_per = row_at(frame + SCALE) * T(-1.0 / UNIT_M);
  for (int point_ = 0; point_ < POINTS; ++point_) {
    const Points<T> at = places[point_];
    Row<T> highest = row_of(T(-1e30)), total = zero, across = zero;
    Points<T> mean = {zero, zero, zero}, normal = mean;
    for (int s = 0; s < count; ++s) {
      const T* own = near.table + 8 * LANES * s;
      Row<T> along = dot(at, rows3_at(own));
      Row<T> logit = T(PER_BANDWIDTH) * (T(2) * along - row_at(own + 3 * LANES)) + row_at(near.bias + LANES * s);
      put(logits + LANES * s, logit);
      highest = most<T>(logit, highest);
    }
    for (int s = 0; s < count; ++s) {
      const T* own = near.table + 8 * LANES * s;
      Row<T> share = exponential<T>(row_at(logits + LANES * s) - highest);
      total = total + share;
      mean = plus(mean, share, rows3_at(own));
      normal = plus(normal, share, rows3_at(own + 4 * LANES));
      across = across + share * row_at(own + 7 * LANES);
    }
    Row<T> per = T(1) / total, fading = there * per;
    SurfaceOf<T> found = surface<T>(at, scaled(per, mean), scaled(fading, normal), fading * across);
    Row<T> share = found.there * ramp<T>(found.distance, T(DEEP_LOW_M), T(DEEP_HIGH_M));
    Points<T> n = into_frame(frame, scaled(unit_per, found.normal));
    T* to = planes + 6 * LANES * point_;
    put3(to, n);
    put(to + 3 * LANES, (T(FELT_GAP_M) - found.distance) * T(1.0 / UNIT_M) - dot(n, local[point_]));
    put(to + 4 * LANES, share);
    put(to + 5 * LANES, share / unit_per);
  }
}

// Writes the tangent planes of the body near the patches of jets.
template <class T>
void find_planes(const Weights<T>& weights, const Rows<T>& jets, const PosedBody<T>& body, const T* frames,
    const PatchRows<T>& rows, int64_t blocks, T* planes) {
  const int64_t regions = body.region.count / 4;
  NearSamplesOf<T> near;
  for (int64_t block = 0; block < blocks; ++block) {
    const T *frame = frames + FRAME * block, *place = rows.place + LANES * 3 * POINTS * block;
    Points<T> local[POINTS], places[POINTS], middle = {};
    for (int p = 0; p < POINTS; ++p) {
      local[p] = felt_point<T>(weights, jets.at(block), place, p);
      places[p] = out_of_frame(frame, scaled(row_at(frame + SCALE), local[p])) + centre_of(frame);
      middle = middle + places[p];
    }
    for (int s = 0; s < OWN_SAMPLES; ++s) {
      near.take(body.skin, rows.sample + LANES * (OWN_SAMPLES * block + s), s);
      put(near.bias + LANES * s, row_at(rows.bias + LANES * (OWN_SAMPLES * block + s)));
    }
    write_felt_planes<T>(near, OWN_SAMPLES, row_of(T(1)), local, places, frame, planes + LANES * PLANES_FELT * block);
    // The two regions of other parts that are nearest to the middle, by their bias.
    middle = scaled(row_of(T(1.0 / POINTS)), middle);
    Row<T> first = row_of(T(-1e30)), second = first;
    Mask<T> one = {}, two = {};
    for (int64_t r = 0; r < regions; ++r) {
      const T* own = body.region + 4 * r;
      Row<T> near_ = middle.x * own[0] + middle.y * own[1] + middle.z * own[2] - own[3];
      Row<T> score = row_at(rows.region + LANES * (regions * block + r)) * T(REGION_BIAS_M2) + T(2) * near_;
      Mask<T> number = (Mask<T>)(typename Numbers<T>::Whole(r));
      two = score > first ? one : (score > second ? number : two);
      second = where<T>(score > first, first, most<T>(score, second));
      one = score > first ? number : one;
      first = most<T>(score, first);
    }
    Row<T> there = row_of(T(0));
    for (int s = 0; s < OTHER_SAMPLES; ++s) {
      int32_t index[LANES];
      const uint8_t* other = rows.other + LANES * REGION_SIZE * regions * block;
      for (int lane = 0; lane < LANES; ++lane) {
        index[lane] = int32_t(REGION_SIZE * (s < REGION_SIZE ? one[lane] : two[lane]) + s % REGION_SIZE);
        const uint8_t steps = other[LANES * index[lane] + lane];
        near.bias[LANES * s + lane] = weights.logs[steps];
        if (steps) there[lane] = 1;
      }
      near.take(body.skin, index, s);
    }
    write_felt_planes<T>(near, OTHER_SAMPLES, there, local, places, frame,
        planes + LANES * (PLANES_FELT * block + 6 * POINTS));
  }
}

// Writes closeness (14 rows) to the planes and their softened force (27 rows) on the jets.
template <class T>
void feel_body(const Weights<T>& weights, const Rows<T>& jets, const PatchRows<T>& rows, const T* planes,
    int64_t blocks, const Rows<T>& felt) {
  T force[LANES * JETS];
  for (int64_t block = 0; block < blocks; ++block) {
    const T *jet = jets.at(block), *place = rows.place + LANES * 3 * POINTS * block;
    T* to = felt.at(block);
    for (int i = 0; i < JETS; ++i) put(force + LANES * i, T(0));
    for (int p = 0; p < POINTS; ++p) {
      Points<T> at = felt_point<T>(weights, jet, place, p), push = {};
      for (int side = 0; side < 2; ++side) {
        const T* near = planes + LANES * (PLANES_FELT * block + 6 * (POINTS * side + p));
        Points<T> n = rows3_at(near);
        Row<T> missing = row_at(near + 3 * LANES) + dot(n, at);
        put(to + LANES * (POINTS * side + p), row_at(near + 4 * LANES) * tangent<T>(missing));
        push = plus(push, row_at(near + 5 * LANES) * most<T>(missing, row_of(T(0))), n);
      }
      add_force<T>(force, push, weights.basis + HEIGHT * p);
    }
    for (int i = 0; i < JETS; ++i) put(to + LANES * (2 * POINTS + i), soft<T>(row_at(force + LANES * i)));
  }
}

// Takes back from jets what a correction, from jets before, takes deeper below the planes than it may.
template <class T>
void hold_corrections(const Weights<T>& weights, const Rows<T>& before, const PatchRows<T>& rows, const T* planes,
    int64_t blocks, const Rows<T>& jets) {
  const T soft_ = T(SOFT_M / UNIT_M), held = T((FELT_GAP_M + HELD_M) / UNIT_M);
  for (int64_t block = 0; block < blocks; ++block) {
    const T *was = before.at(block), *place = rows.place + LANES * 3 * POINTS * block;
    T* jet = jets.at(block);
    Row<T> share = row_of(T(1));
    for (int p = 0; p < POINTS; ++p) {
      const Points<T> at = felt_point<T>(weights, was, place, p), way = felt_point<T>(weights, jet, place, p) - at;
      for (int side = 0; side < 2; ++side) {
        const T* near = planes + LANES * (PLANES_FELT * block + 6 * (POINTS * side + p));
        const Points<T> n = rows3_at(near);
        const Row<T> missing = row_at(near + 3 * LANES) + dot(n, at), deeper = row_at(near + 4 * LANES) * dot(n, way);
        const Row<T> room = most<T>(held - missing, row_of(T(0))) + soft_;
        share = least<T>(share, room / most<T>(deeper + soft_, room));
      }
    }
    for (int i = 0; i < JETS; ++i)
      put(jet + LANES * i, row_at(was + LANES * i) + share * (row_at(jet + LANES * i) - row_at(was + LANES * i)));
  }
}

}  // namespace network
