// Posed bodies as the network sees them: bones, the code of the pose, and the skin that patches feel.
//
// The formulas are those of drape.geometry.rigid, drape.body.features and drape.contact.skin.
#pragma once
#include "dense.hpp"

constexpr int JOINTS = 24, STATIC_PER_JOINT = 9;
constexpr int PARENTS[JOINTS] = {-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
constexpr int PART_SIZE = 48, REGION_SIZE = 12;  // samples that are posed together, and that are looked up together
constexpr double BENT_SLOPE = 0.01;               // of layers of the body's code

// The product of the quaternions wxyz a and b.
template <class T> INLINE void put_product(const T* a, const T* b, T* out) {
  out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  out[1] = a[1] * b[0] + a[0] * b[1] - a[3] * b[2] + a[2] * b[3];
  out[2] = a[2] * b[0] + a[3] * b[1] + a[0] * b[2] - a[1] * b[3];
  out[3] = a[3] * b[0] - a[2] * b[1] + a[1] * b[2] + a[0] * b[3];
}

// The matrix (9,) of a quaternion of any length.
template <class T> INLINE void put_matrix(const T* q, T* out) {
  const T w = q[0], x = q[1], y = q[2], z = q[3], two = T(2) / (w * w + x * x + y * y + z * z);
  out[0] = T(1) - two * (y * y + z * z), out[1] = two * (x * y - w * z), out[2] = two * (x * z + w * y);
  out[3] = two * (x * y + w * z), out[4] = T(1) - two * (x * x + z * z), out[5] = two * (y * z - w * x);
  out[6] = two * (x * z - w * y), out[7] = two * (y * z + w * x), out[8] = T(1) - two * (x * x + y * y);
}

template <class T> INLINE Vector<T> turned_vector(const T* matrix, Vector<T> a) {
  return {matrix[0] * a.x + matrix[1] * a.y + matrix[2] * a.z, matrix[3] * a.x + matrix[4] * a.y + matrix[5] * a.z,
          matrix[6] * a.x + matrix[7] * a.y + matrix[8] * a.z};
}

// Writes quaternions (24, 4), rotations (24, 9) and joints [m] (24, 3) of bones with local quaternions (24, 4) and joints
// rest [m] (24, 3). The root stays at its place.
template <class T> void pose_bones(const T* local, const T* rest, T* quaternion, T* rotation, T* place) {
  for (int joint = 0; joint < JOINTS; ++joint) {
    const int parent = PARENTS[joint];
    if (parent < 0) {
      for (int i = 0; i < 4; ++i) quaternion[i] = local[i];
    } else {
      put_product(quaternion + 4 * parent, local + 4 * joint, quaternion + 4 * joint);
      put_point(place, joint, point(place, parent) + turned_vector(rotation + 9 * parent, point(rest, joint) - point(rest, parent)));
    }
    put_matrix(quaternion + 4 * joint, rotation + 9 * joint);
  }
}

// Writes drape.body.features.static_features of local quaternions and the bones' rotation (24, 9).
template <class T> void describe_pose(const T* local, const T* rotation, T* features) {
  T matrix[9];
  for (int joint = 0; joint < JOINTS; ++joint) {
    T* own = features + STATIC_PER_JOINT * joint;
    put_matrix(local + 4 * joint, matrix);
    for (int i = 0; i < 3; ++i) {
      // The root's own turn is not told.
      own[i] = joint ? matrix[3 * i] : T(i == 0);
      own[3 + i] = joint ? matrix[3 * i + 1] : T(i == 1);
      own[6 + i] = -rotation[9 * joint + 3 + i];
    }
  }
}

// Writes the samples (S, 8) of drape.contact.samples.sample_table: sums over bones, a part at a time.
template <class T> void pose_skin(const T* rotation, const T* translation, const BodyFeed<T>& feed, T* skin) {
  constexpr int WIDTH = 3 * PART_SIZE;
  const int64_t parts = feed.skin_counts.count, bones = feed.skin_bones.count / parts;
  T posed[3 * WIDTH];
  for (int64_t part = 0; part < parts; ++part) {
    const T* rows = feed.skin_rows + 4 * WIDTH * bones * part;
    for (int column = 0; column < WIDTH; column += LANES) {
      Points<T> sum = {};
      for (int64_t n = 0; n < feed.skin_counts[part]; ++n) {
        const int64_t bone = feed.skin_bones[bones * part + n];
        const T *turn = rotation + 9 * bone, *way = translation + 3 * bone;
        for (int i = 0; i < 4; ++i) {
          Row<T> row = row_at(rows + WIDTH * (4 * n + i) + column);
          sum.x = sum.x + row * (i < 3 ? turn[i] : way[0]);
          sum.y = sum.y + row * (i < 3 ? turn[3 + i] : way[1]);
          sum.z = sum.z + row * (i < 3 ? turn[6 + i] : way[2]);
        }
      }
      put(posed + column, sum.x), put(posed + WIDTH + column, sum.y), put(posed + 2 * WIDTH + column, sum.z);
    }
    for (int first = 0; first < PART_SIZE; first += LANES) {
      const T* from = posed + first;
      Points<T> p = {row_at(from), row_at(from + WIDTH), row_at(from + 2 * WIDTH)}, u, v;
      from += PART_SIZE;
      u = {row_at(from), row_at(from + WIDTH), row_at(from + 2 * WIDTH)};
      from += PART_SIZE;
      v = {row_at(from), row_at(from + WIDTH), row_at(from + 2 * WIDTH)};
      Points<T> n = cross(u, v);
      n = scaled(T(1) / root<T>(most<T>(dot(n, n), row_of(T(1e-12)))), n);
      Row<T> square = dot(p, p), across = dot(p, n);
      for (int lane = 0; lane < LANES; ++lane) {
        T* own = skin + 8 * (PART_SIZE * part + first + lane);
        own[0] = p.x[lane], own[1] = p.y[lane], own[2] = p.z[lane], own[3] = square[lane];
        own[4] = n.x[lane], own[5] = n.y[lane], own[6] = n.z[lane], own[7] = across[lane];
      }
    }
  }
}

// Poses a body for the network: writes the bones, the body's half of the first layer (code), the samples of the skin,
// which are given where the feed has no rows for them, and the mean points of its regions [m] (R, 4), with half of their
// squares.
template <class T> void pose_body(const Weights<T>& weights, const BodyFeed<T>& feed, PosedBody<T>& body, Scratch& scratch) {
  const int64_t mark = scratch.used;
  int64_t widest = weights.mean.count;
  for (int64_t n = 0; n < weights.body.count; ++n)
    if (weights.body[n].bias.count > widest) widest = weights.body[n].bias.count;
  T *features = scratch.take<T>(widest), *outputs = scratch.take<T>(widest);
  if (scratch.overflowed) return;
  put_point(body.place.begin, 0, Vector<T>{});
  pose_bones(feed.local.begin, feed.rest.begin, body.quaternion.begin, body.rotation.begin, body.place.begin);
  for (int joint = 0; joint < JOINTS; ++joint)
    put_point(body.translation.begin, joint, point(body.place.begin, joint) - turned_vector(body.rotation + 9 * joint, point(feed.rest.begin, joint)));
  describe_pose(feed.local.begin, body.rotation.begin, features);
  for (int64_t i = 0; i < feed.betas.count; ++i) features[STATIC_PER_JOINT * JOINTS + i] = feed.betas[i];
  for (int64_t i = 0; i < weights.mean.count; ++i) {
    const T scaled_ = (features[i] - weights.mean[i]) * weights.inverse_deviation[i];
    features[i] = scaled_ > -5 ? (scaled_ < 5 ? scaled_ : T(5)) : T(-5);
  }
  for (int64_t number = 0; number < weights.body.count; ++number) {
    run_body_layer(weights.body[number], features, number + 1 == weights.body.count ? T(1) : T(BENT_SLOPE), outputs);
    T* other = features;
    features = outputs, outputs = other;
  }
  for (int64_t i = 0; i < feed.motion.count; ++i) features[i] += feed.motion[i];
  run_body_layer(weights.from_body, features, T(1), body.code.begin);
  if (feed.skin_rows.count) pose_skin(body.rotation.begin, body.translation.begin, feed, body.skin.begin);
  for (int64_t r = 0; r < body.region.count / 4; ++r) {
    Vector<T> mean = {};
    for (int64_t s = REGION_SIZE * r; s < REGION_SIZE * (r + 1); ++s) mean = mean + point(body.skin + 8 * s, 0);
    mean = scaled(T(1.0 / REGION_SIZE), mean);
    put_point(body.region + 4 * r, 0, mean);
    body.region[4 * r + 3] = T(0.5) * dot(mean, mean);
  }
  scratch.used = mark;
}
