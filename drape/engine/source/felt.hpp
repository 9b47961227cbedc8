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

// Returns the tangent of a point: that at rest, and what the jets add to it by the derivatives (15,) of the basis
// there.
template <class T> INLINE Points<T> tangent_of(const T* jet, const T* rest, const T* terms) {
  Points<T> t = {row_at(rest), row_at(rest + LANES * POINTS), row_at(rest + 2 * LANES * POINTS)};
  for (int i = 1; i < PLANE; ++i) {  // the derivative of the constant is zero
    t.x = t.x + row_at(jet + LANES * i) * terms[i];
    t.y = t.y + row_at(jet + LANES * (PLANE + i)) * terms[i];
  }
  for (int i = 1; i < HEIGHT; ++i) t.z = t.z + row_at(jet + LANES * (2 * PLANE + i)) * terms[i];
  return t;
}

// The place of a number among the jets: its axis, and which number it is on that axis.
struct JetNumber { int64_t axis, number; };
INLINE JetNumber jet_number(int64_t i) {
  const int64_t axis = i < PLANE ? 0 : i < 2 * PLANE ? 1 : 2;
  return {axis, i - PLANE * axis};
}

// Writes the softened strain (21 rows) of the patches, and the force (27 rows) by which it acts on their jets.
template <class T>
DEVICE void feel_strain(const Weights<T>& weights, const Rows<T>& jets, const PatchRows<T>& rows, int64_t blocks,
    const Rows<T>& felt, Scratch& scratch) {
  const int64_t mark = scratch.used, all = 6 * LANES * POINTS;
  T* pieces = scratch.take<T>(all * pieces_of(blocks));  // forces at the points, by u and by v
  if (scratch.overflowed) return;
  auto strain_at = [&](int64_t block, int64_t p) {
    const T *jet = jets.at(block), *still = rows.tangent + LANES * 6 * POINTS * block;
    const T* unit = rows.unit + LANES * 6 * POINTS * block;
    T* to = felt.at(block);
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
    T* force = pieces + all * piece_of(block) + 6 * LANES * p;
    put3(force, mix(by_uu, u, by_uv, v));
    put3(force + 3 * LANES, mix(by_vv, v, by_uv, u));
  };
  visit_twice(blocks, POINTS, strain_at, JETS, [&](int64_t block, int64_t i) {
    const JetNumber own = jet_number(i);
    const T* force = pieces + all * piece_of(block) + LANES * own.axis;
    Row<T> sum = row_of(T(0));
    for (int p = 0; p < POINTS; ++p, force += 6 * LANES) {
      sum = sum + row_at(force) * weights.basis_u[HEIGHT * p + own.number];
      sum = sum + row_at(force + 3 * LANES) * weights.basis_v[HEIGHT * p + own.number];
    }
    put(felt.at(block) + LANES * (STRAIN + i), soft<T>(sum));
  });
  scratch.used = mark;
}

// Returns one point of each patch of a block [patch scales].
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
  static constexpr int64_t SIZE = 9 * LANES * OWN_SAMPLES;
  T *table, *bias;
  INLINE_MEMBER explicit NearSamplesOf(T* piece) : table(piece), bias(piece + 8 * LANES * OWN_SAMPLES) {}
  INLINE_MEMBER void take(const T* skin, const int32_t* held, int64_t s, Row<T> own_bias) {
    FourRows<T> p = samples_of(skin, held, 0), n = samples_of(skin, held, 4);
    T* to = table + 8 * LANES * s;
    put(to, p.a), put(to + LANES, p.b), put(to + 2 * LANES, p.c), put(to + 3 * LANES, p.d);
    put(to + 4 * LANES, n.a), put(to + 5 * LANES, n.b), put(to + 6 * LANES, n.c), put(to + 7 * LANES, n.d);
    put(bias + LANES * s, own_bias);
  }
};

// Writes the plane of the surface of count samples about each point of a block; local are the points in the frames, at
// in the world.
template <class T>
INLINE void write_felt_plane(const NearSamplesOf<T>& near, int count, Row<T> there, Points<T> local, Points<T> at,
    const T* frame, T* to) {
  T logits[WIDTH * OWN_SAMPLES];
  const Row<T> zero = row_of(T(0));
  Row<T> unit_per = row_at(frame + SCALE) * T(-1.0 / UNIT_M);
  Row<T> highest = row_of(T(-1e30)), total = zero, across = zero;
  Points<T> mean = {zero, zero, zero}, normal = mean;
  for (int s = 0; s < count; ++s) {
    const T* own = near.table + 8 * LANES * s;
    Row<T> along = dot(at, rows3_at(own));
    Row<T> logit = T(PER_BANDWIDTH) * (T(2) * along - row_at(own + 3 * LANES)) + row_at(near.bias + LANES * s);
    put_several<T>(logits + WIDTH * s, logit);
    highest = most<T>(logit, highest);
  }
  for (int s = 0; s < count; ++s) {
    const T* own = near.table + 8 * LANES * s;
    Row<T> share = exponential<T>(several_at(logits + WIDTH * s) - highest);
    total = total + share;
    mean = plus(mean, share, rows3_at(own));
    normal = plus(normal, share, rows3_at(own + 4 * LANES));
    across = across + share * row_at(own + 7 * LANES);
  }
  Row<T> per = T(1) / total, fading = there * per;
  SurfaceOf<T> found = surface<T>(at, scaled(per, mean), scaled(fading, normal), fading * across);
  Row<T> share = found.there * ramp<T>(found.distance, T(DEEP_LOW_M), T(DEEP_HIGH_M));
  Points<T> n = into_frame(frame, scaled(unit_per, found.normal));
  put3(to, n);
  put(to + 3 * LANES, (T(FELT_GAP_M) - found.distance) * T(1.0 / UNIT_M) - dot(n, local));
  put(to + 4 * LANES, share);
  put(to + 5 * LANES, share / unit_per);
}

// The two regions of other parts that are nearest to the middle of a block's points, by their bias.
template <class T> struct TwoRegions { Mask<T> one, two; };
template <class T> INLINE TwoRegions<T> nearest_regions(const PosedBody<T>& body, const T* bias, Points<T> middle) {
  Row<T> first = row_of(T(-1e30)), second = first;
  Mask<T> one = {}, two = {};
  for (int64_t r = 0; r < body.region.count / 4; ++r) {
    const T* own = body.region + 4 * r;
    Row<T> near_ = middle.x * own[0] + middle.y * own[1] + middle.z * own[2] - own[3];
    Row<T> score = row_at(bias + LANES * r) * T(REGION_BIAS_M2) + T(2) * near_;
    Mask<T> number = (Mask<T>)(typename Numbers<T>::Whole(r));
    two = score > first ? one : (score > second ? number : two);
    second = where<T>(score > first, first, most<T>(score, second));
    one = score > first ? number : one;
    first = most<T>(score, first);
  }
  return {one, two};
}

// Writes the tangent planes of the body near the patches of jets.
template <class T>
DEVICE void find_planes(const Weights<T>& weights, const Rows<T>& jets, const PosedBody<T>& body, const T* frames,
    const PatchRows<T>& rows, int64_t blocks, T* planes, Scratch& scratch) {
  const int64_t mark = scratch.used, regions = body.region.count / 4, all = NearSamplesOf<T>::SIZE;
  T *pieces = scratch.take<T>(all * pieces_of(blocks)), *points = scratch.take<T>(6 * LANES * POINTS * blocks);
  T* there = scratch.take<T>(LANES * blocks);
  int32_t* chosen = scratch.take<int32_t>(2 * LANES * blocks);
  if (scratch.overflowed) return;
  auto near = [&](int64_t block) { return NearSamplesOf<T>(pieces + all * piece_of(block)); };
  auto write = [&](int64_t block, int64_t p, int side, int count, Row<T> fading) {
    const T *own = points + 6 * LANES * (POINTS * block + p), *frame = frames + FRAME * block;
    write_felt_plane<T>(near(block), count, fading, rows3_at(own), rows3_at(own + 3 * LANES), frame,
        planes + LANES * (PLANES_FELT * block + 6 * (POINTS * side + p)));
  };
  auto other_of = [&](int64_t block, int k, int s) {
    const int32_t region = chosen[LANES * (2 * block + s / REGION_SIZE) + lane_of(k)];
    return REGION_SIZE * region + s % REGION_SIZE;
  };
  auto steps_of = [&](int64_t block, int k, int s) {
    return rows.other[LANES * (REGION_SIZE * regions * block + other_of(block, k, s)) + lane_of(k)];
  };
  visit_parts(blocks, POINTS, [&](int64_t block, int64_t p) {
    const T* frame = frames + FRAME * block;
    const Points<T> local = felt_point<T>(weights, jets.at(block), rows.place + LANES * 3 * POINTS * block, int(p));
    T* own = points + 6 * LANES * (POINTS * block + p);
    put3(own, local);
    put3(own + 3 * LANES, out_of_frame(frame, scaled(row_at(frame + SCALE), local)) + centre_of(frame));
  });
  visit_twice(
      blocks, OWN_SAMPLES,
      [&](int64_t block, int64_t s) {
        const int64_t at = LANES * (OWN_SAMPLES * block + s);
        int32_t held[WIDTH];
        for (int k = 0; k < WIDTH; ++k) held[k] = rows.sample[at + lane_of(k)];
        near(block).take(body.skin, held, s, row_at(rows.bias + at));
      },
      POINTS, [&](int64_t block, int64_t p) { write(block, p, 0, OWN_SAMPLES, row_of(T(1))); });
  for (int64_t block : each_block(blocks)) {
    Points<T> middle = {};
    for (int p = 0; p < POINTS; ++p)
      middle = middle + rows3_at(points + 6 * LANES * (POINTS * block + p) + 3 * LANES);
    const TwoRegions<T> found = nearest_regions<T>(body, rows.region + LANES * regions * block,
                                                   scaled(row_of(T(1.0 / POINTS)), middle));
    for (int k = 0; k < WIDTH; ++k) {
      chosen[2 * LANES * block + lane_of(k)] = int32_t(number_in(found.one, k));
      chosen[2 * LANES * block + LANES + lane_of(k)] = int32_t(number_in(found.two, k));
      int any = 0;
      for (int s = 0; s < OTHER_SAMPLES; ++s) any |= steps_of(block, k, s);
      there[LANES * block + lane_of(k)] = T(any != 0);
    }
  }
  visit_twice(
      blocks, OTHER_SAMPLES,
      [&](int64_t block, int64_t s) {
        int32_t held[WIDTH];
        Row<T> bias;
        for (int k = 0; k < WIDTH; ++k) {
          held[k] = int32_t(other_of(block, k, int(s)));
          set_number(bias, k, weights.logs[steps_of(block, k, int(s))]);
        }
        near(block).take(body.skin, held, s, bias);
      },
      POINTS, [&](int64_t block, int64_t p) { write(block, p, 1, OTHER_SAMPLES, row_at(there + LANES * block)); });
  scratch.used = mark;
}

// Writes the closeness (14 rows) of the patches to the planes, and the softened force (27 rows) by which the planes act
// on their jets.
template <class T>
DEVICE void feel_body(const Weights<T>& weights, const Rows<T>& jets, const PatchRows<T>& rows, const T* planes,
    int64_t blocks, const Rows<T>& felt, Scratch& scratch) {
  const int64_t mark = scratch.used, all = 3 * LANES * POINTS;
  T* pieces = scratch.take<T>(all * pieces_of(blocks));  // what pushes the points
  if (scratch.overflowed) return;
  auto push_at = [&](int64_t block, int64_t p) {
    Points<T> at = felt_point<T>(weights, jets.at(block), rows.place + LANES * 3 * POINTS * block, int(p)), push = {};
    for (int side = 0; side < 2; ++side) {
      const T* near = planes + LANES * (PLANES_FELT * block + 6 * (POINTS * side + p));
      Points<T> n = rows3_at(near);
      Row<T> missing = row_at(near + 3 * LANES) + dot(n, at);
      put(felt.at(block) + LANES * (POINTS * side + p), row_at(near + 4 * LANES) * tangent<T>(missing));
      push = plus(push, row_at(near + 5 * LANES) * most<T>(missing, row_of(T(0))), n);
    }
    put3(pieces + all * piece_of(block) + 3 * LANES * p, push);
  };
  visit_twice(blocks, POINTS, push_at, JETS, [&](int64_t block, int64_t i) {
    const JetNumber own = jet_number(i);
    const T* push = pieces + all * piece_of(block) + LANES * own.axis;
    Row<T> sum = row_of(T(0));
    for (int p = 0; p < POINTS; ++p) sum = sum + row_at(push + 3 * LANES * p) * weights.basis[HEIGHT * p + own.number];
    put(felt.at(block) + LANES * (2 * POINTS + i), soft<T>(sum));
  });
  scratch.used = mark;
}

// Reduces a correction of jets, from those before, that takes a point deeper below the planes than it may.
template <class T>
DEVICE void hold_corrections(const Weights<T>& weights, const Rows<T>& before, const PatchRows<T>& rows,
    const T* planes, int64_t blocks, const Rows<T>& jets, Scratch& scratch) {
  const T soft_ = T(SOFT_M / UNIT_M), held = T((FELT_GAP_M + HELD_M) / UNIT_M);
  const int64_t mark = scratch.used, all = LANES * POINTS;
  T* pieces = scratch.take<T>(all * pieces_of(blocks));  // the shares that points may go
  if (scratch.overflowed) return;
  auto share_at = [&](int64_t block, int64_t p) {
    const T *was = before.at(block), *place = rows.place + LANES * 3 * POINTS * block;
    const Points<T> at = felt_point<T>(weights, was, place, int(p));
    const Points<T> way = felt_point<T>(weights, jets.at(block), place, int(p)) - at;
    Row<T> share = row_of(T(1));
    for (int side = 0; side < 2; ++side) {
      const T* near = planes + LANES * (PLANES_FELT * block + 6 * (POINTS * side + p));
      const Points<T> n = rows3_at(near);
      const Row<T> missing = row_at(near + 3 * LANES) + dot(n, at), deeper = row_at(near + 4 * LANES) * dot(n, way);
      const Row<T> room = most<T>(held - missing, row_of(T(0))) + soft_;
      share = least<T>(share, room / most<T>(deeper + soft_, room));
    }
    put(pieces + all * piece_of(block) + LANES * p, share);
  };
  visit_twice(blocks, POINTS, share_at, 3, [&](int64_t block, int64_t third) {
    const T *shares = pieces + all * piece_of(block), *was = before.at(block);
    T* jet = jets.at(block);
    Row<T> share = row_at(shares);
    for (int p = 1; p < POINTS; ++p) share = least<T>(share, row_at(shares + LANES * p));
    for (int64_t i = JETS / 3 * third; i < JETS / 3 * (third + 1); ++i)
      put(jet + LANES * i, row_at(was + LANES * i) + share * (row_at(jet + LANES * i) - row_at(was + LANES * i)));
  });
  scratch.used = mark;
}

}  // namespace network
