// Contact with the posed skin: for every vertex a tangent plane of its own part of the body, and of another part.
//
// The skin is a graph of samples (S, 8): point and its square, normal and normal times point.
//
// Own part. Walks over the graph (walks.hpp) lead there from the sample that the network's vertex is at. When the grid
// shows a nearer sample of the same part, the next walk starts there.
//
// Another part. A grid over the samples finds what else is near, the trunk near a sleeve or a thigh near a belly, for a
// quarter of the vertices in each frame; in between the other ones walk. A sample counts where it is far from the own
// one at rest. A nearer one counts where the skin is hollow between the two: it then lies above the tangent plane of
// the own sample, as no sample of the same limb does.
//
// Through. What stretched cloth pulls through an arm in a frame is held by no plane: its sample is on the side that it
// left. Where the network has it before that side, a frame begins at the network's place. The network itself lays cloth
// of the chest into an arm before it. The way out is that to the side which faces the own sample: a sample of another
// part below whose plane both the network's place and the own sample are holds nothing.
//
// Planes. One tangent plane for all that lies nearest to a sample would give limbs facets. The plane of a sample s is
// blended with those of its neighbours n, with weights that end at the samples' spacing r,
//
//     w_n = clip(1 - (|x - b_n|^2 - |x - b_s|^2) / r^2, 0, 1)^2,   d(x) = 1/2 sum w_n (n_n + n) . (x - b_n),
//
// n the blended normal of unit length and sum w = 1. Over a sphere the tangent plane of one sample is off by what the
// surface falls away from it. A chord is at right angles to the mean of the normals at its ends: along this mean the
// distance has no ripple. A plane ends at the side of its sample: beside a heel it would cut through free air. Where x
// is more than BESIDE times r^2 to the side of s, the plane sinks below x.
#pragma once
#include "frames.hpp"
#include "grid.hpp"
#include "sweeps.hpp"
#include "walks.hpp"

constexpr int TURNS = 4;       // frames until every vertex has looked for other parts
constexpr double REACH_M = 0.045;  // how near another part must come: half of an arm
constexpr double PER_CELL = 1.0 / (2.0 * REACH_M);
constexpr double BEYOND_M = 0.020;  // below the plane of another part: in it
constexpr double THROUGH_M = 0.015, BEFORE_M = 0.005;  // below a sample's plane: what came through it, what did not
constexpr double NEARER = 0.8;  // of the squared distance to the own sample: one of its part so near takes its place
constexpr double BESIDE = 1.5, FREE = 2.5;  // squared ways aside of a sample, times r^2, between which a plane ends
constexpr double HOLLOW_M = 0.05, APART_M = 0.12;  // at rest, from which skin may be hollow, and is another part

// Returns whether points lie behind the samples own, in the body or beyond it, where the network's points do not: they
// are more than THROUGH_M below a sample's plane, and no farther aside of the sample than below it.
template <class T> INLINE Mask<T> came_through(Points<T> points, Points<T> network, const int32_t* own,
                                               const Skin<T>& skin) {
  const FourRows<T> s = samples_of(skin.samples, own, 0), n = samples_of(skin.samples, own, 4);
  const Points<T> normal = {n.a, n.b, n.c}, way = points - Points<T>{s.a, s.b, s.c};
  const Row<T> height = dot(way, normal), wanted = dot(network, normal) - n.d;
  return (height < T(-THROUGH_M)) & (dot(way, way) < T(2) * height * height) & (wanted > T(-BEFORE_M));
}

// Moves the places x [m] (P, 3) that came through the skin back to the network's. own (C,) are the samples of the
// coarse places; parent (P,) is the coarse place of each place, empty where each is its own.
template <class T>
DEVICE void lay_back(T* x, const T* network, int64_t places, const Skin<T>& skin, const int32_t* own,
                     const int32_t* parent) {
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block;
    int32_t at[WIDTH];
    for (int k = 0; k < WIDTH; ++k) at[k] = own[parent ? parent[first + lane_of(k)] : first + lane_of(k)];
    const Points<T> points = points_in(x + 3 * first), wanted = points_in(network + 3 * first);
    const Mask<T> through = came_through(points, wanted, at, skin);
    if (!lanes_of<T>(through)) continue;
    put_points(x + 3 * first, Points<T>{where<T>(through, wanted.x, points.x), where<T>(through, wanted.y, points.y),
                                        where<T>(through, wanted.z, points.z)});
  }
}

template <class T> struct Planes { Points<T> foot, unit; };

// Returns the planes of the walks' samples and of their neighbours below points.
template <class T> INLINE Planes<T> planes_below(Points<T> points, Walks& walks, const Skin<T>& skin) {
  look_around(walks, skin.neighbour);
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Row<T> reach;
  for (int k = 0; k < WIDTH; ++k) set_number(reach, k, skin.reach_m2[walks.sample[k]]);
  Row<T> per_m2 = one / reach, total = one;
  FourRows<T> s = samples_of(skin.samples, walks.sample, 0), n = samples_of(skin.samples, walks.sample, 4);
  Points<T> where_ = {s.a, s.b, s.c}, normal = {n.a, n.b, n.c};
  Row<T> product = n.d;
  Row<T> own_square = dot(where_ - points, where_ - points);
  Row<T> height = dot(normal, points) - product;
  Row<T> aside = (own_square - height * height) * per_m2;
  const Indices own = indices_in(walks.sample);
#pragma clang loop unroll(disable)
  for (int k = 0; k < NEIGHBOURS; ++k) {
    const int32_t* near = walks.near + WIDTH * k;
    FourRows<T> p = samples_of(skin.samples, near, 0), q = samples_of(skin.samples, near, 4);
    Points<T> place = {p.a, p.b, p.c}, way = place - points;
    Row<T> share = least<T>(most<T>(one - (dot(way, way) - own_square) * per_m2, zero), one);
    // A sample may be its own neighbour, and counts once.
    Row<T> weight = where<T>(differ<T>(indices_in(near), own), share * share, zero);
    total += weight;
    product = product + weight * q.d;
    where_ = plus(where_, weight, place);
    normal = plus(normal, weight, Points<T>{q.a, q.b, q.c});
  }
  Row<T> per = one / total, square = dot(normal, normal);
  Points<T> unit = scaled(one / root<T>(where<T>(square > zero, square, one)), normal);
  Row<T> by_samples = (dot(points, normal) - product) * per;
  Row<T> by_blend = dot(unit, plus(points, -per, where_));
  Row<T> beside = least<T>(most<T>((aside - T(BESIDE)) * T(1.0 / (FREE - BESIDE)), zero), one);
  Row<T> distance = (one - beside) * T(0.5) * (by_samples + by_blend) + beside * T(REACH_M);
  return {plus(points, -distance, unit), unit};
}

// Returns whether a sample is of another part of the body than the sample own.
template <class T> INLINE bool is_other(const Skin<T>& skin, int32_t own, int32_t sample) {
  Vector<T> apart = point(skin.rest, sample) - point(skin.rest, own);
  T rest = dot(apart, apart);
  if (rest > T(APART_M * APART_M)) return true;
  if (!(rest > T(HOLLOW_M * HOLLOW_M))) return false;
  return dot(skin.normal_of(own), skin.point_of(sample) - skin.point_of(own)) > 0;
}

// Returns the points of the samples in the order of a grid: three rows of all, each with room for LANES more.
template <class T> DEVICE const T* in_cells(const Skin<T>& skin, const Grid& grid, Scratch& scratch) {
  const int64_t size = skin.count + LANES;
  T* laid = scratch.take<T>(3 * size);
  if (scratch.overflowed) return laid;
  for (int64_t entry : each(size)) {
    const bool there = entry < skin.count && grid.cells > 0;
    Vector<T> p = there ? skin.point_of(grid.member[entry]) : Vector<T>{};
    laid[entry] = p.x, laid[size + entry] = p.y, laid[2 * size + entry] = p.z;
  }
  return laid;
}

// Returns whether the network's place [m] is inside the part of a sample, on a side that is not the one before the
// sample own.
template <class T> INLINE bool is_beyond(const Skin<T>& skin, int32_t own, int32_t sample, Vector<T> network) {
  const Vector<T> normal = skin.normal_of(sample), at = skin.point_of(sample);
  return dot(normal, network - at) < T(-BEYOND_M) && dot(normal, skin.point_of(own) - at) < T(-BEYOND_M);
}

struct NearSamples { int32_t other, same; };

// Returns the sample nearest to a point [m] that is of another part than the sample own and not beyond it for the
// network's place [m], -1 where none is within reach; and the nearest sample of the same part, which is own unless
// another one is NEARER.
template <class T>
INLINE NearSamples near_samples(Vector<T> at, Vector<T> network, const Skin<T>& skin, int32_t own, const Grid& grid,
                                const T* laid) {
  const int64_t size = skin.count + LANES;
  NearSamples found = {-1, own};
  const T reach = T(REACH_M * REACH_M), own_square = T(NEARER) * square_to(at, skin, own);
  T nearest = reach, beside = own_square < reach ? own_square : reach;
  const Cells cells = cells_around(grid, at, REACH_M);
  for (int64_t i = cells.first[0]; i < cells.last[0]; ++i)
    for (int64_t j = cells.first[1]; j < cells.last[1]; ++j) {
      const Run run = column(grid, i, j, cells);
      for (int64_t entry = run.begin; entry < run.end; entry += WIDTH) {
        Row<T> x = several_at(laid + entry) - at.x, y = several_at(laid + size + entry) - at.y;
        Row<T> z = several_at(laid + 2 * size + entry) - at.z;
        Row<T> far = x * x + y * y + z * z;
        T most_ = nearest > beside ? nearest : beside;
        uint32_t near = lanes_of<T>(row_of(most_) > far) & lanes_before(run.end - entry);
        for (; near; near &= near - 1) {
          const int k = first_lane(near);
          const int32_t s = grid.member[entry + k];
          const T square = number_in(far, k);
          if (!(square < (nearest > beside ? nearest : beside))) continue;
          if (is_other(skin, own, s)) {
            if (square < nearest && !is_beyond(skin, own, s, network)) found.other = s, nearest = square;
          } else if (square < beside) {
            found.same = s, beside = square;
          }
        }
      }
    }
  return found;
}

// The planes of other body parts that are still to be computed. Few vertices are near another part, so they wait until
// there are as many as a thread holds lanes.
template <class T> struct LatePlanes {
  const T* x;
  T* planes;
  const Skin<T>& skin;
  Walks walks;
  int waiting;
  INLINE_MEMBER void write() {
    Planes<T> found = planes_below(points_of(x, walks.vertex), walks, skin);
    for (int k = 0; k < waiting; ++k) {
      const int64_t v = walks.vertex[k];
      T* to = planes + PLANES * (v / LANES) + OTHER_PLANE + v % LANES;
      to[0] = number_in(found.foot.x, k), to[LANES] = number_in(found.foot.y, k);
      to[2 * LANES] = number_in(found.foot.z, k), to[3 * LANES] = number_in(found.unit.x, k);
      to[4 * LANES] = number_in(found.unit.y, k), to[5 * LANES] = number_in(found.unit.z, k);
    }
    waiting = 0;
  }
  INLINE_MEMBER void add(int64_t v, int32_t sample) {
    walks.vertex[waiting] = int32_t(v), walks.sample[waiting] = sample;
    if (++waiting == WIDTH) write();
  }
  INLINE_MEMBER void finish() {
    if (waiting == 0) return;
    for (int k = waiting; k < WIDTH; ++k) walks.vertex[k] = walks.vertex[0], walks.sample[k] = walks.sample[0];
    write();
  }
};

// Moves other (P,), the samples of other body parts, on to those near x [m] (P, 3), which the network has at network
// [m] (P, 3) and at the samples own (P,). Writes the samples at (P,) that x lies at, and both tangent planes. The grid
// is asked for the vertices whose number is turn modulo TURNS, and for all where turn is negative. A plane is the foot
// of x on it and its normal; where no other part is near the second normal is zero.
template <class T>
DEVICE void touch(const T* x, const T* network, int64_t places, const Skin<T>& skin, const int32_t* vertex, int32_t* own,
                  int32_t* other, int32_t* at, int64_t turn, T* planes, Scratch& scratch) {
  const int64_t mark = scratch.used;
  const Grid grid = grid_of(skin.samples, skin.count, 8, PER_CELL, scratch);
  const T* laid = in_cells(skin, grid, scratch);
  if (scratch.overflowed) return;
  const Row<T> zero = row_of(T(0));
  Walks walks;
  LatePlanes<T> late = {x, planes, skin, {}, 0};
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block;
    T* to = planes + PLANES * block;
    for (int k = 0; k < WIDTH; ++k) walks.sample[k] = own[first + lane_of(k)];
    Points<T> points = points_in(x + 3 * first);
    for (uint32_t far = walk(points, walks, skin, WALK_STEPS); far; far &= far - 1) {
      const int k = first_lane(far);
      const Vector<T> normal = skin.normal_of(own[first + lane_of(k)]);
      walks.sample[k] = walked_along(point(x, first + lane_of(k)), skin, walks.sample[k], normal);
    }
    for (int k = 0; k < WIDTH; ++k) at[first + lane_of(k)] = walks.sample[k];
    Planes<T> below = planes_below(points, walks, skin);
    put3(to + OWN_PLANE, below.foot);
    put3(to + OWN_PLANE + 3 * LANES, below.unit);
    for (int row = OTHER_PLANE; row < HELD_ROW; row += LANES) put(to + row, zero);
    put(to + NEAR_ROW, zero);
    for (int k = 0; k < WIDTH; ++k) {
      const int64_t v = first + lane_of(k);
      const Vector<T> place = point(x, v), wanted = point(network, v);
      int32_t found = other[v];
      if (turn < 0 || vertex[v] % TURNS == turn) {
        const NearSamples near = near_samples(place, wanted, skin, walks.sample[k], grid, laid);
        found = near.other;
        if (near.same != walks.sample[k]) own[v] = near.same;
      } else if (found >= 0) {
        found = walked(place, skin, found, WALK_STEPS);
        const bool far = square_to(place, skin, found) >= T(REACH_M * REACH_M);
        const int32_t mine = walks.sample[k];
        if (far || !is_other(skin, mine, found) || is_beyond(skin, mine, found, wanted)) found = -1;
      }
      other[v] = found;
      if (found >= 0) late.add(v, found);
    }
  }
  late.finish();
  scratch.used = mark;
}

// Returns the planes below points of a block, by walks from the samples own (C,) of their coarse places parent.
template <class T>
INLINE Planes<T> own_planes(Points<T> points, const int32_t* own, const int32_t* parent, Walks& walks,
                            const Skin<T>& skin) {
  for (int k = 0; k < WIDTH; ++k) walks.sample[k] = own[parent ? parent[lane_of(k)] : lane_of(k)];
  walk(points, walks, skin, WALK_STEPS);
  return planes_below(points, walks, skin);
}

// Writes the planes below x [m] (P, 3), by walks from the samples own (C,) of their coarse places parent (P,), or of
// the places themselves where parent is empty.
template <class T>
DEVICE void put_own_planes(const T* x, int64_t places, const Skin<T>& skin, const int32_t* own, const int32_t* parent,
                           T* planes) {
  Walks walks;
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block;
    const int32_t *from = parent ? own : own + first, *of = parent ? parent + first : nullptr;
    Planes<T> below = own_planes(points_in(x + 3 * first), from, of, walks, skin);
    T* to = planes + PLANES * block;
    put3(to + OWN_PLANE, below.foot);
    put3(to + OWN_PLANE + 3 * LANES, below.unit);
  }
}

// Writes the planes of other body parts below x [m] (P, 3), those of the samples other (C,) of their coarse places
// parent (P,); none for a sample -1.
template <class T>
DEVICE void put_other_planes(const T* x, int64_t places, const Skin<T>& skin, const int32_t* other,
                             const int32_t* parent, T* planes) {
  LatePlanes<T> late = {x, planes, skin, {}, 0};
  for (int64_t v : each(places))
    if (other[parent[v]] >= 0) late.add(v, other[parent[v]]);
  late.finish();
}

// The frames of the samples own of a block: the normal, the way to the first neighbour laid into the tangent plane, and
// their cross product. A sample without neighbours moves what lies on it along the normal alone.
template <class T> struct SkinFrames {
  Points<T> at;
  AxesOf<T> axes;
};
template <class T> INLINE SkinFrames<T> skin_frames(const Skin<T>& skin, const int32_t* own) {
  int32_t near[WIDTH];
  for (int k = 0; k < WIDTH; ++k) near[k] = skin.neighbour[NEIGHBOURS * own[lane_of(k)]];
  FourRows<T> s = samples_at(skin.samples, own, 0), q = samples_at(skin.samples, own, 4);
  FourRows<T> t = samples_of(skin.samples, near, 0);
  const Row<T> zero = row_of(T(0)), one = row_of(T(1));
  Points<T> at = {s.a, s.b, s.c}, n = {q.a, q.b, q.c}, way = Points<T>{t.a, t.b, t.c} - at;
  Points<T> e = plus(way, -dot(way, n), n);
  Row<T> square = dot(e, e);
  e = scaled(one / root<T>(where<T>(square > zero, square, one)), e);
  return {at, {n, e, cross(n, e)}};
}

// Writes to stuck [m] (P, 3) the places to which the posed skin has taken the cloth that sticks to it. grip [m] (P, 3)
// are the places in the frames of the samples own (P,).
template <class T>
DEVICE void stuck_places(const T* grip, int64_t places, const int32_t* own, const Skin<T>& skin, T* stuck) {
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block;
    SkinFrames<T> frame = skin_frames(skin, own + first);
    put_points(stuck + 3 * first, frame.at + to_world(frame.axes, points_in(grip + 3 * first)));
  }
}

// Writes to grip the places that the cloth sticks to after x [m] (P, 3) has moved, in the frames of the samples own;
// stuck [m] (P, 3) are those before. A place comes along below x, and stays behind by no more than SLIP_M.
template <class T>
DEVICE void write_grip(const T* x, int64_t places, const T* stuck, const int32_t* own, const Skin<T>& skin, T* grip) {
  const Row<T> one = row_of(T(1)), slip_m = row_of(T(SLIP_M));
  for (int64_t block : each_block(places / LANES)) {
    const int64_t first = LANES * block;
    SkinFrames<T> frame = skin_frames(skin, own + first);
    Points<T> points = points_in(x + 3 * first), n = frame.axes.n;
    Points<T> slip = points - points_in(stuck + 3 * first);
    slip = plus(slip, -dot(slip, n), n);
    Row<T> length = root<T>(most<T>(dot(slip, slip), slip_m * slip_m));
    Row<T> share = where<T>(length > slip_m, slip_m / length, one);
    put_points(grip + 3 * first, to_frame(frame.axes, plus(points, -share, slip) - frame.at));
  }
}
