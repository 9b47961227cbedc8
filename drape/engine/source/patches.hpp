// Posed patches: their frames, what a patch sees of its surroundings, and the consensus of charts.
//
// Frames are those of drape.geometry.skinning.blend_frames, surroundings those of training.onefit.patch_surroundings,
// and charts those of training.chart_consensus. A member's columns are its weight w times its rest place and the basis (1, u,
// v, uu, uv, vv); those of the third and fourth order are products of two of them, over w.
#pragma once
#include "body.hpp"

namespace network {

constexpr int ROTATION = 0, CENTRE = 9 * LANES, SCALE = 12 * LANES, FRAME = 13 * LANES;  // of a block's frames; [m]
constexpr int GRAVITY = 3 * JOINTS, SEEN = GRAVITY + 3;  // of the surroundings' rows, behind the joints; their count
constexpr int MEMBERS = 56, COLUMNS = 9, FIT = 21;       // of a chart; of a member; rows of a fit
// numbers of a polynomial in the plane, of the height; of jets
constexpr int PLANE = 6, HEIGHT = 15, JETS = 27, FULL = 45;
constexpr double JOINT_REACH_M = 0.3;

template <class T> INLINE Points<T> centre_of(const T* frame) { return rows3_at(frame + CENTRE); }

// Returns world vectors in the axes of a block's frames; below, the way back.
template <class T> INLINE Points<T> into_frame(const T* f, Points<T> a) {
  return {row_at(f) * a.x + row_at(f + 3 * LANES) * a.y + row_at(f + 6 * LANES) * a.z,
          row_at(f + LANES) * a.x + row_at(f + 4 * LANES) * a.y + row_at(f + 7 * LANES) * a.z,
          row_at(f + 2 * LANES) * a.x + row_at(f + 5 * LANES) * a.y + row_at(f + 8 * LANES) * a.z};
}
template <class T> INLINE Points<T> out_of_frame(const T* f, Points<T> a) {
  return {row_at(f) * a.x + row_at(f + LANES) * a.y + row_at(f + 2 * LANES) * a.z,
          row_at(f + 3 * LANES) * a.x + row_at(f + 4 * LANES) * a.y + row_at(f + 5 * LANES) * a.z,
          row_at(f + 6 * LANES) * a.x + row_at(f + 7 * LANES) * a.y + row_at(f + 8 * LANES) * a.z};
}

// Writes the frames of the patches on a body. signs is room for one number for each two joints.
template <class T>
DEVICE void pose_frames(const PosedBody<T>& body, const PatchRows<T>& rows, int64_t blocks, T* signs, T* frames) {
  for (int64_t both : each(JOINTS * JOINTS)) {
    T same = 0;
    for (int k = 0; k < 4; ++k)
      same += body.quaternion[4 * (both / JOINTS) + k] * body.quaternion[4 * (both % JOINTS) + k];
    signs[both] = same < 0 ? T(-1) : T(1);
  }
  const int64_t betas = body.betas.count;
  for (int64_t block : each_block(blocks)) {
    const int32_t* heaviest = rows.heaviest + LANES * block;
    const T* weights = rows.weights + LANES * JOINTS * block;
    T* to = frames + FRAME * block;
    // Quaternions blend with signs fixed against the patch's heaviest bone, of which a little guards the norm.
    Row<T> q[4];
    for (int i = 0; i < 4; ++i)
      for (int k = 0; k < WIDTH; ++k) set_number(q[i], k, T(1e-6) * body.quaternion[4 * heaviest[lane_of(k)] + i]);
    for (int joint = 0; joint < JOINTS; ++joint) {
      Row<T> sign;
      for (int k = 0; k < WIDTH; ++k) set_number(sign, k, signs[JOINTS * joint + heaviest[lane_of(k)]]);
      Row<T> weight = row_at(weights + LANES * joint) * sign;
      for (int i = 0; i < 4; ++i) q[i] = q[i] + weight * body.quaternion[4 * joint + i];
    }
    Row<T> w = q[0], x = q[1], y = q[2], z = q[3], two = T(2) / (w * w + x * x + y * y + z * z), one = row_of(T(1));
    const Points<T> turn[3] = {{one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)},
                               {two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)},
                               {two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)}};
    const T* rest = rows.rotation + LANES * 9 * block;
    for (int column = 0; column < 3; ++column) {
      Points<T> own = {row_at(rest + LANES * column), row_at(rest + LANES * (3 + column)),
          row_at(rest + LANES * (6 + column))};
      for (int axis = 0; axis < 3; ++axis) put(to + ROTATION + LANES * (3 * axis + column), dot(turn[axis], own));
    }
    // The blended bones move the centre, which the body's shape has displaced.
    Points<T> c = rows3_at(rows.centre + LANES * 3 * block), moved = {};
    const T* slopes = rows.slopes + LANES * 3 * betas * block;
    for (int64_t i = 0; i < betas; ++i)
      c = plus(c, row_of(body.betas[i]), Points<T>{row_at(slopes + LANES * i), row_at(slopes + LANES * (betas + i)),
          row_at(slopes + LANES * (2 * betas + i))});
    for (int joint = 0; joint < JOINTS; ++joint) {
      const T *m = body.rotation + 9 * joint, *t = body.translation + 3 * joint;
      Points<T> way = {c.x * m[0] + c.y * m[1] + c.z * m[2] + t[0], c.x * m[3] + c.y * m[4] + c.z * m[5] + t[1],
                       c.x * m[6] + c.y * m[7] + c.z * m[8] + t[2]};
      moved = plus(moved, row_at(weights + LANES * joint), way);
    }
    put3(to + CENTRE, moved);
    put(to + SCALE, row_at(rows.scale + LANES * block));
  }
}

// Writes the joints and gravity in the axes of each patch to the first SEEN rows.
template <class T>
DEVICE void see_surroundings(const PosedBody<T>& body, const T* frames, int64_t blocks, const Rows<T>& seen) {
  visit_parts(blocks, JOINTS, [&](int64_t block, int64_t joint) {
    const T* frame = frames + FRAME * block;
    const Points<T> centre = centre_of(frame);
    const Vector<T> p = point(body.place.begin, joint);
    Points<T> way = into_frame(frame, Points<T>{p.x - centre.x, p.y - centre.y, p.z - centre.z});
    Row<T> reach = root<T>(most<T>(dot(way, way), row_of(T(1e-12))));
    Row<T> share = tangent<T>(reach * T(1.0 / JOINT_REACH_M)) / reach;
    put3(seen.at(block) + LANES * 3 * joint, scaled(share, way));
  });
  visit_parts(blocks, 3, [&](int64_t block, int64_t axis) {
    put(seen.at(block) + LANES * (GRAVITY + axis), -row_at(frames + FRAME * block + ROTATION + LANES * (3 + axis)));
  });
}

template <class T> INLINE Row<T> in_plane(const T* jet, const Row<T> (&basis)[6]) {
  Row<T> sum = row_at(jet) * basis[0];
  for (int i = 1; i < 6; ++i) sum = sum + row_at(jet + LANES * i) * basis[i];
  return sum;
}

// Writes to said [m] (members, 3) the places where charts put their members, times the members' weights. Without jets
// the charts are at rest in their frames.
template <class T>
DEVICE void say(const Rows<T>& jets, const T* frames, const PatchRows<T>& rows, int64_t blocks, T* said) {
  visit_parts(blocks, MEMBERS, [&](int64_t block, int64_t member) {
    const T* frame = frames + FRAME * block;
    const T* jet = jets.values ? jets.at(block) : nullptr;
    const Points<T> centre = centre_of(frame);
    const Row<T> scale = row_at(frame + SCALE);
    const T* c = rows.columns + LANES * COLUMNS * (MEMBERS * block + member);
    Points<T> p = rows3_at(c);
    const Row<T> basis[6] = {row_at(c + 3 * LANES), row_at(c + 4 * LANES), row_at(c + 5 * LANES),
                             row_at(c + 6 * LANES), row_at(c + 7 * LANES), row_at(c + 8 * LANES)};
    const Row<T> weight = basis[0], u = basis[1], v = basis[2], uu = basis[3], uv = basis[4], vv = basis[5];
    if (jet) {
      p.x = p.x + in_plane<T>(jet, basis), p.y = p.y + in_plane<T>(jet + LANES * PLANE, basis);
      p.z = p.z + in_plane<T>(jet + 2 * LANES * PLANE, basis);
      const T* high = jet + 3 * LANES * PLANE;
      const Row<T> product[9] = {uu * u, uu * v, vv * u, vv * v, uu * uu, uu * uv, uv * uv, uv * vv, vv * vv};
      Row<T> more_ = row_at(high) * product[0];
      for (int i = 1; i < 9; ++i) more_ = more_ + row_at(high + LANES * i) * product[i];
      p.z = p.z + T(1) / most<T>(weight, row_of(T(1e-30))) * more_;
    }
    const Points<T> world = plus(out_of_frame(frame, scaled(scale, p)), weight, centre);
    put_points(said + 3 * LANES * (MEMBERS * block + member), world);
  });
}

// Writes the anchors [m] (A, 3): each is the sum of what its four charts said.
template <class T> DEVICE void place_anchors(const T* said, const Array<uint32_t>& anchor, T* anchors) {
  for (int64_t a : each(anchor.count / 4)) {
    const uint32_t* i = anchor + 4 * a;
    put_point(anchors, a, point(said, i[0]) + point(said, i[1]) + (point(said, i[2]) + point(said, i[3])));
  }
}

// Writes the numbers of a fit to MEMBERS rows of off, from a row of the fit on, less those at rest.
template <int COUNT, class T> INLINE void fit_rows(const T* off, const T* fit, const T* rest, T* to) {
  Row<T> sum[COUNT];
  for (int i = 0; i < COUNT; ++i) sum[i] = row_of(T(0));
  for (int member = 0; member < MEMBERS; ++member, fit += LANES * FIT) {
    Row<T> own = row_at(off + LANES * member);
#pragma clang loop unroll(full)
    for (int i = 0; i < COUNT; ++i) sum[i] = sum[i] + own * row_at(fit + LANES * i);
  }
  for (int i = 0; i < COUNT; ++i) put(to + LANES * i, sum[i] - row_at(rest + LANES * i));
}

// Writes jets that fit the anchors [m] (A, 3): 45 numbers a patch with closing, else 27.
template <class T>
DEVICE void fit_anchors(const T* anchors, const T* frames, const PatchRows<T>& rows, int64_t blocks, bool closing,
    const Rows<T>& jets, Scratch& scratch) {
  const int64_t mark = scratch.used, all = 3 * LANES * MEMBERS;
  T* pieces = scratch.take<T>(all * pieces_of(blocks));
  if (scratch.overflowed) return;
  auto lay_off = [&](int64_t block, int64_t member) {
    const T* frame = frames + FRAME * block;
    const Row<T> per = T(1) / row_at(frame + SCALE);
    Points<T> place = points_at(anchors, rows.member + LANES * (MEMBERS * block + member));
    Points<T> way = scaled(per, into_frame(frame, place - centre_of(frame)));
    T* off = pieces + all * piece_of(block) + LANES * member;
    put(off, way.x), put(off + LANES * MEMBERS, way.y), put(off + 2 * LANES * MEMBERS, way.z);
  };
  auto fit = [&](int64_t block, int64_t part) {
    const T *from = rows.fit + LANES * FIT * MEMBERS * block, *rest = rows.rest + LANES * 3 * FIT * block;
    const T* off = pieces + all * piece_of(block);
    T* to = jets.at(block);
    if (!closing && part >= 3) {  // in the plane
      const int64_t axis = part - 3;
      fit_rows<6>(off + LANES * MEMBERS * axis, from + LANES * HEIGHT, rest + LANES * (FIT * axis + HEIGHT),
          to + LANES * PLANE * axis);
    } else {
      const int64_t axis = closing ? part / 3 : 2, first = 5 * (part % 3);
      fit_rows<5>(off + LANES * MEMBERS * axis, from + LANES * first, rest + LANES * (FIT * axis + first),
          to + LANES * ((closing ? HEIGHT * axis : 2 * PLANE) + first));
    }
  };
  visit_twice(blocks, MEMBERS, lay_off, closing ? 9 : 5, fit);
  scratch.used = mark;
}

}  // namespace network
