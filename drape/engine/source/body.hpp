// Posed bodies as the network sees them: bones, the code of the pose, and the skin that patches feel.
//
// The formulas are those of drape.geometry.rigid, drape.body.features and drape.contact.skin.
#pragma once
#include "dense.hpp"
#include "numbers.hpp"

constexpr int JOINTS = 24, STATIC_PER_JOINT = 9;
TABLE int PARENTS[JOINTS] = {-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21};
constexpr int PART_SIZE = 48, REGION_SIZE = 12;  // samples that are posed together, and that are looked up together

// Writes the product of the quaternions a and b (wxyz).
template <class T> INLINE void put_product(const T* a, const T* b, T* out) {
  out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
  out[1] = a[1] * b[0] + a[0] * b[1] - a[3] * b[2] + a[2] * b[3];
  out[2] = a[2] * b[0] + a[3] * b[1] + a[0] * b[2] - a[1] * b[3];
  out[3] = a[3] * b[0] - a[2] * b[1] + a[1] * b[2] + a[0] * b[3];
}

// Writes the rotation matrix (9,) of a quaternion (wxyz) of any length.
template <class T> INLINE void put_matrix(const T* q, T* out) {
  const T w = q[0], x = q[1], y = q[2], z = q[3], two = T(2) / (w * w + x * x + y * y + z * z);
  out[0] = T(1) - two * (y * y + z * z), out[1] = two * (x * y - w * z), out[2] = two * (x * z + w * y);
  out[3] = two * (x * y + w * z), out[4] = T(1) - two * (x * x + z * z), out[5] = two * (y * z - w * x);
  out[6] = two * (x * z - w * y), out[7] = two * (y * z + w * x), out[8] = T(1) - two * (x * x + y * y);
}

// Writes the unit quaternions (N, 4) and matrices (N, 9) of rotation vectors [rad] (N, 3).
INLINE void describe_turns(const double* turns, int64_t count, double* quaternion, double* matrix) {
  for (int64_t i : each(count)) {
    const Vector<double> turn = point(turns, i);
    const double angle = root(dot(turn, turn));
    const SineCosine half = sine_cosine_of(0.5 * angle);
    double* own = quaternion + 4 * i;
    own[0] = half.cosine;
    put_point(own + 1, 0, scaled(angle > 1e-8 ? half.sine / angle : 0.5, turn));
    put_matrix(own, matrix + 9 * i);
  }
}

template <class T> INLINE Vector<T> turned_vector(const T* matrix, Vector<T> a) {
  return {matrix[0] * a.x + matrix[1] * a.y + matrix[2] * a.z, matrix[3] * a.x + matrix[4] * a.y + matrix[5] * a.z,
          matrix[6] * a.x + matrix[7] * a.y + matrix[8] * a.z};
}

// Writes the bones' quaternions (24, 4), rotations (24, 9) and joints [m] (24, 3) in the body's frame, from local
// quaternions (24, 4) and the joints at rest [m] (24, 3). The root stays at its place.
template <class T> DEVICE void pose_bones(const T* local, const T* rest, T* quaternion, T* rotation, T* place) {
  for (int64_t first : each(1))  // a bone needs those before it
    for (int64_t joint = first; joint < JOINTS; ++joint) {
      const int parent = PARENTS[joint];
      if (parent < 0) {
        for (int i = 0; i < 4; ++i) quaternion[i] = local[i];
      } else {
        put_product(quaternion + 4 * parent, local + 4 * joint, quaternion + 4 * joint);
        put_point(place, joint, point(place, parent) + turned_vector(rotation + 9 * parent,
            point(rest, joint) - point(rest, parent)));
      }
      put_matrix(quaternion + 4 * joint, rotation + 9 * joint);
    }
}

// Writes drape.body.features.static_features (24, 9) of a body with local quaternions (24, 4) and the bones' rotations
// (24, 9).
template <class T> DEVICE void describe_pose(const T* local, const T* rotation, T* features) {
  for (int64_t joint : each(JOINTS)) {
    T matrix[9], *own = features + STATIC_PER_JOINT * joint;
    put_matrix(local + 4 * joint, matrix);
    for (int i = 0; i < 3; ++i) {
      // The root's own turn is no feature.
      own[i] = joint ? matrix[3 * i] : T(i == 0);
      own[3 + i] = joint ? matrix[3 * i + 1] : T(i == 1);
      own[6 + i] = -rotation[9 * joint + 3 + i];
    }
  }
}

// Writes the fields of drape.body.features.Kinematics for F bodies with local quaternions (F, 24, 4), root translations
// trans [m] (F, 3) and joints at rest [m] (24, 3): static descriptors (F, 24, 9), joints [m] (F, 24, 3) and rotations
// (F, 24, 9).
template <class T>
void describe_bodies(const T* local, const T* trans, const T* rest, int64_t frames, T* features, T* joints,
    T* rotations) {
  T quaternion[4 * JOINTS];
  for (int64_t frame = 0; frame < frames; ++frame, local += 4 * JOINTS, features += STATIC_PER_JOINT * JOINTS,
               joints += 3 * JOINTS, rotations += 9 * JOINTS) {
    put_point(joints, 0, point(rest, 0) + point(trans, frame));
    pose_bones(local, rest, quaternion, rotations, joints);
    describe_pose(local, rotations, features);
  }
}

// Writes the eight numbers of each of so many samples: the point, its square, the normal, and the product of normal and
// point.
template <class T> INLINE void put_samples(T* skin, Points<T> p, Points<T> n, int count) {
  const Row<T> square = dot(p, p), across = dot(p, n);
  for (int k = 0; k < WIDTH && k < count; ++k) {
    T* own = skin + 8 * lane_of(k);
    own[0] = number_in(p.x, k), own[1] = number_in(p.y, k), own[2] = number_in(p.z, k), own[3] = number_in(square, k);
    own[4] = number_in(n.x, k), own[5] = number_in(n.y, k), own[6] = number_in(n.z, k), own[7] = number_in(across, k);
  }
}

// The unit normals of surfaces with the tangents u and v.
template <class T> INLINE Points<T> unit_cross(Points<T> u, Points<T> v) {
  const Points<T> n = cross(u, v);
  return scaled(T(1) / root<T>(most<T>(dot(n, n), row_of(T(1e-12)))), n);
}

// Where bones with so many rows (4 a bone, each of SKIN_ROW numbers) carry sixteen columns of a part.
constexpr int SKIN_ROW = 3 * PART_SIZE;  // points and both tangents of a part
template <class T>
INLINE Points<T> posed_column(const T* rotation, const T* translation, const T* rows, const int32_t* bones,
                              int64_t count) {
  Points<T> sum = {};
  for (int64_t n = 0; n < count; ++n) {
    const T *turn = rotation + 9 * bones[n], *way = translation + 3 * bones[n];
    for (int i = 0; i < 4; ++i) {
      Row<T> row = row_at(rows + SKIN_ROW * (4 * n + i));
      sum.x = sum.x + row * (i < 3 ? turn[i] : way[0]);
      sum.y = sum.y + row * (i < 3 ? turn[3 + i] : way[1]);
      sum.z = sum.z + row * (i < 3 ? turn[6 + i] : way[2]);
    }
  }
  return sum;
}

// Writes the samples (S, 8) of drape.contact.samples.sample_table: sums over bones, sixteen samples at a time.
template <class T>
DEVICE void pose_skin(const T* rotation, const T* translation, const BodyFeed<T>& feed, T* skin) {
  const int64_t parts = feed.skin_counts.count, bones = feed.skin_bones.count / parts;
  visit_parts(parts, PART_SIZE / LANES, [&](int64_t part, int64_t block) {
    const T* rows = feed.skin_rows + 4 * SKIN_ROW * bones * part + LANES * block;
    Points<T> found[3];
    for (int kind = 0; kind < 3; ++kind)
      found[kind] = posed_column(rotation, translation, rows + PART_SIZE * kind, feed.skin_bones + bones * part,
                                 feed.skin_counts[part]);
    put_samples<T>(skin + 8 * (PART_SIZE * part + LANES * block), found[0], unit_cross<T>(found[1], found[2]), LANES);
  });
}

// Writes how unlike the kept poses the poses with joint matrices (F, 24, 9) are, (F,): the largest, over the parts of a
// body, of the distances from the nearest kept pose. A part is a layer that computes |k|^2 - 2 k.x for each kept pose
// k.
template <class T>
DEVICE void compare_poses(const KeptPoses<T>& kept, const T* matrices, int64_t frames, T* novelty, Scratch& scratch) {
  int64_t most_ = 0;
  for (int64_t p = 0; p < kept.parts.count; ++p) most_ = more(most_, kept.parts[p].bias.count);
  T *numbers = scratch.take<T>(kept.entry.count), *squares = scratch.take<T>(most_);
  if (scratch.overflowed) return;
  for (int64_t frame = 0; frame < frames; ++frame, matrices += 9 * JOINTS) {
    const int32_t* entry = kept.entry;
    T furthest = 0;
    for (int64_t p = 0; p < kept.parts.count; ++p) {
      const Layer<T>& part = kept.parts[p];
      const int64_t count = part.weight.count / part.bias.count;
      T own = 0;
      for (int64_t i : each(count)) numbers[i] = matrices[entry[i]];
      for (int64_t i = 0; i < count; ++i) own += numbers[i] * numbers[i];
      entry += count;
      run_body_layer(part, numbers, squares);
      T nearest = squares[0];
      for (int64_t k : each(kept.counts[p])) nearest = less(squares[k], nearest);
      furthest = more((-most_of_all(-nearest) + own) / kept.over[p], furthest);
    }
    if (is_first_thread()) novelty[frame] = root(furthest);
  }
}

// Writes for each region of samples its mean point [m] and half of that point's square, (R, 4).
template <class T> DEVICE void put_regions(const T* skin, int64_t regions, T* region) {
  for (int64_t r : each(regions)) {
    Vector<T> mean = {};
    for (int64_t s = REGION_SIZE * r; s < REGION_SIZE * (r + 1); ++s) mean = mean + point(skin + 8 * s, 0);
    mean = scaled(T(1.0 / REGION_SIZE), mean);
    put_point(region + 4 * r, 0, mean);
    region[4 * r + 3] = T(0.5) * dot(mean, mean);
  }
}

// Poses a body for the network: writes the bones, code (the body's half of the network's first layer), the posed skin
// samples, which are given where the feed has no rows for them, and for each region its mean point [m] and half of that
// point's square, (R, 4).
template <class T> DEVICE void pose_body(const Weights<T>& weights, const BodyFeed<T>& feed, PosedBody<T>& body,
    Scratch& scratch) {
  const int64_t mark = scratch.used;
  int64_t widest = STATIC_PER_JOINT * JOINTS + feed.betas.count;
  for (int64_t n = 0; n < weights.body.count; ++n)
    if (weights.body[n].bias.count > widest) widest = weights.body[n].bias.count;
  T *features = scratch.take<T>(widest), *outputs = scratch.take<T>(widest);
  if (scratch.overflowed) return;
  for (int64_t i : each(3)) body.place[i] = 0;
  pose_bones(feed.local.begin, feed.rest.begin, body.quaternion.begin, body.rotation.begin, body.place.begin);
  for (int64_t joint : each(JOINTS))
    put_point(body.translation.begin, joint, point(body.place.begin, joint) - turned_vector(body.rotation + 9 * joint,
        point(feed.rest.begin, joint)));
  describe_pose(feed.local.begin, body.rotation.begin, features);
  for (int64_t i : each(feed.betas.count)) features[STATIC_PER_JOINT * JOINTS + i] = feed.betas[i];
  for (int64_t i : each(weights.mean.count)) {
    const T scaled_ = (features[i] - weights.mean[i]) * weights.inverse_deviation[i];
    features[i] = scaled_ > -5 ? (scaled_ < 5 ? scaled_ : T(5)) : T(-5);
  }
  for (int64_t number = 0; number < weights.body.count; ++number) {
    run_body_layer(weights.body[number], features, outputs);
    T* other = features;
    features = outputs, outputs = other;
  }
  for (int64_t i : each(feed.motion.count)) features[i] += feed.motion[i];
  if (weights.from_body.bias.count)  // none where only bones and skin are wanted
    run_body_layer(weights.from_body, features, body.code.begin);
  if (feed.skin_rows.count) pose_skin(body.rotation.begin, body.translation.begin, feed, body.skin.begin);
  put_regions(body.skin.begin, body.region.count / 4, body.region.begin);
  scratch.used = mark;
}
