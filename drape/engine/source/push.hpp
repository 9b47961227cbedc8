// The push-out, a collision projection: drape.contact.projection.push_in_parts of one frame, where its steps are told.
//
// A block of sixteen vertices is a row. It shares a list of skin samples, whose numbers are the same for all lanes; two
// blocks, a group, query together for other parts of the body.
#pragma once
#include "felt.hpp"

namespace network {

constexpr int PUSH_GROUP = 2, CLUSTER_SIZE = 4, CHARTS = 4, CLOTH_MEMBERS = 24;
constexpr int TERMS = 10, PUSH_WIDTH = 64;  // of a patch's polynomial; charts of a tile
constexpr int PUSH_PLANE = 5 * LANES;       // normal, missing way and share: of the own part, then of others
constexpr double DEPTH_LOW_M = -0.035, DEPTH_HIGH_M = -0.025;  // a point deeper inside belongs to another surface
constexpr double LARGEST_PUSH_M = 0.030;
// normals fade before weights times coordinates are subnormal
constexpr double LEAST_WEIGHT = 1e-37, LEAST_NORMALS = 1e-30;
constexpr int HAS_OTHER = 2;       // in 255ths: a list has an other part where some sample is one by this much
constexpr double JET_OVER = 2.0;  // times a fit of what is missing: a fit spreads a push and so falls short of it

// Writes the plane of each of a block's points in the blend of count samples with the logits bias. Means are taken by
// sums of exponentials without a search for the largest, so that they fade to nothing far from all samples.
template <class T>
void write_push_plane(Points<T> at, const T* const* samples, const T* bias, int count, T clearance, T* plane) {
  Row<T> total = row_of(T(0)), across = total;
  Points<T> mean = {}, normal = {};
  for (int k = 0; k < count; ++k) {
    const T* s = samples[k];
    const Points<T> b = {row_of(s[0]), row_of(s[1]), row_of(s[2])}, off = at - b;
    Row<T> weight = exponential<T>(bias[k] - T(PER_BANDWIDTH) * dot(off, off));
    total = total + weight;
    mean = plus(mean, weight, b);
    normal = plus(normal, weight, Points<T>{row_of(s[4]), row_of(s[5]), row_of(s[6])});
    across = across + weight * s[7];
  }
  Row<T> per = T(1) / most<T>(total, row_of(T(LEAST_NORMALS)));
  SurfaceOf<T> found = surface<T>(at, scaled(T(1) / most<T>(total, row_of(T(LEAST_WEIGHT))), mean), scaled(per, normal),
      per * across);
  put3(plane, found.normal);
  put(plane + 3 * LANES, clearance - found.distance);
  put(plane + 4 * LANES, found.there * ramp<T>(found.distance, T(DEPTH_LOW_M), T(DEPTH_HIGH_M)));
}

// Writes the planes of all blocks with the points start [m], three rows each. region is room for four numbers of each
// region.
template <class T>
void find_push_planes(const T* start, const T* skin, const PushFeed<T>& feed, const T* logs, T clearance,
    T* region, T* planes) {
  const int64_t groups = feed.block_vertex.count / (PUSH_GROUP * LANES), regions = feed.region_bias.count / groups;
  put_regions(skin, regions, region);
  const T* samples[OWN_SAMPLES];
  T bias[OTHER_SAMPLES];
  for (int64_t group = 0; group < groups; ++group) {
    Vector<T> centre = {};
    for (int64_t block = PUSH_GROUP * group; block < PUSH_GROUP * (group + 1); ++block) {
      const int32_t* cluster = feed.own_cluster + OWN_SAMPLES / CLUSTER_SIZE * block;
      for (int k = 0; k < OWN_SAMPLES; ++k)
        samples[k] = skin + 8 * (CLUSTER_SIZE * int64_t(cluster[k / CLUSTER_SIZE]) + k % CLUSTER_SIZE);
      const Points<T> at = rows3_at(start + 3 * LANES * block);
      write_push_plane<T>(at, samples, feed.own_bias + OWN_SAMPLES * block, OWN_SAMPLES, clearance,
          planes + 2 * PUSH_PLANE * block);
      centre = centre + sums<T>(at);
    }
    centre = scaled(T(1.0 / (PUSH_GROUP * LANES)), centre);
    // first and second become the biases of the two regions of other parts that are nearest to the group.
    T first = T(-1e30), second = first;
    int64_t one = 0, two = 0;
    for (int64_t r = 0; r < regions; ++r) {
      const T near = dot(centre, point(region + 4 * r, 0)) - region[4 * r + 3];
      const T score = T(REGION_BIAS_M2) * feed.region_bias[regions * group + r] + T(2) * near;
      if (score > first) second = first, two = one, first = score, one = r;
      else if (score > second) second = score, two = r;
    }
    bool there = false;
    for (int k = 0; k < OTHER_SAMPLES; ++k) {
      const int64_t sample = REGION_SIZE * (k < REGION_SIZE ? one : two) + k % REGION_SIZE;
      const uint8_t steps = feed.other[REGION_SIZE * regions * group + sample];
      samples[k] = skin + 8 * sample, bias[k] = logs[steps];
      there |= steps >= HAS_OTHER;
    }
    for (int64_t block = PUSH_GROUP * group; block < PUSH_GROUP * (group + 1); ++block) {
      T* plane = planes + PUSH_PLANE * (2 * block + 1);
      const Points<T> at = rows3_at(start + 3 * LANES * block);
      for (int i = 0; i < 5 && !there; ++i) put(plane + LANES * i, T(0));
      if (there) write_push_plane<T>(at, samples, bias, OTHER_SAMPLES, clearance, plane);
    }
  }
}

// Returns moved pushed along a plane by the distance that it still lacks, to first order; saturated.
template <class T> INLINE Points<T> pushed_along(const T* plane, Points<T> moved) {
  const Points<T> normal = rows3_at(plane);
  Row<T> missing = most<T>(row_at(plane + 3 * LANES) - dot(moved, normal), row_of(T(0)));
  const Row<T> way = T(LARGEST_PUSH_M) * tangent<T>(missing * T(1.0 / LARGEST_PUSH_M)) * row_at(plane + 4 * LANES);
  return plus(moved, way, normal);
}
// Returns moved pushed out of other parts, and then out of the own part, which has the last word.
template <class T> INLINE Points<T> pushed_out(const T* planes, Points<T> moved) {
  return pushed_along(planes, pushed_along(planes + PUSH_PLANE, moved));
}

// Adds to the coefficients [m] (K, 3, 10) the least-squares polynomials of the patches for the displacement [m] of the
// blocks, times over. means is room for a point a block.
template <class T>
void fit_push(const T* displacement, const PushFeed<T>& feed, T over, T* means, T* coefficients) {
  const int64_t blocks = feed.block_vertex.count / LANES, members = feed.patch_block.count / feed.patches;
  for (int64_t block = 0; block < blocks; ++block)
    put_point(means, block, scaled(T(1.0 / LANES), sums<T>(rows3_at(displacement + 3 * LANES * block))));
  for (int64_t k = 0; k < feed.patches; ++k, coefficients += 3 * TERMS) {
    T sum[3][TERMS] = {};
    for (int64_t i = members * k; i < members * (k + 1); ++i) {
      const T *fit = feed.patch_fit + TERMS * i, *mean = means + 3 * feed.patch_block[i];
      for (int axis = 0; axis < 3; ++axis)
        for (int term = 0; term < TERMS; ++term) sum[axis][term] += fit[term] * mean[axis];
    }
    for (int i = 0; i < 3 * TERMS; ++i) coefficients[i] += over * sum[i / TERMS][i % TERMS];
  }
}

// Writes the displacement [m] of the blocks, which is the blend of the patches' polynomials. said is room for a point a
// chart.
template <class T> void blend_push(const T* coefficients, const PushFeed<T>& feed, T* said, T* displacement) {
  for (int64_t tile = 0; tile < feed.tile_patch.count; ++tile) {
    const T* own = coefficients + 3 * TERMS * feed.tile_patch[tile];
    const T* basis = feed.tile_basis + TERMS * PUSH_WIDTH * tile;
    for (int column = 0; column < PUSH_WIDTH; column += LANES) {
      Points<T> sum = {};
      for (int term = 0; term < TERMS; ++term) {
        const Row<T> row = row_at(basis + PUSH_WIDTH * term + column);
        sum = {sum.x + row * own[term], sum.y + row * own[TERMS + term], sum.z + row * own[2 * TERMS + term]};
      }
      put_points(said + 3 * (PUSH_WIDTH * tile + column), sum);
    }
  }
  const int64_t slots = feed.block_vertex.count;
  for (int64_t slot = 0; slot < slots; slot += LANES) {
    Points<T> sum = points_at(said, feed.slot_charts + slot);
    for (int chart = 1; chart < CHARTS; ++chart) sum = sum + points_at(said, feed.slot_charts + slots * chart + slot);
    put3(displacement + 3 * slot, sum);
  }
}

// Writes to out the vertices [m] (V, 3) pushed out of a body with the samples skin (S, 8), and how far [m] each went to
// way (V,). logs (256,) are the logits of samples by how much they belong to other parts. For drapes by jets it also
// writes, after so many rounds, the push as coefficients [m] (K, 3, 10), and to left [m] the longest way that a vertex
// which they move still lacks.
template <class T>
void push_out(const T* vertices, const T* skin, const PushFeed<T>& feed, const T* logs, T clearance,
    int64_t rounds, T* out, T* way, T* coefficients, T* left, Scratch& scratch) {
  const int64_t mark = scratch.used, slots = feed.block_vertex.count, blocks = slots / LANES;
  const int64_t regions = feed.region_bias.count / (blocks / PUSH_GROUP);
  T *start = scratch.take<T>(3 * slots), *moved = scratch.take<T>(3 * slots), *places = scratch.take<T>(3 * slots);
  T *planes = scratch.take<T>(2 * PUSH_PLANE * blocks), *region = scratch.take<T>(4 * regions);
  T *means = scratch.take<T>(3 * blocks), *said = scratch.take<T>(3 * PUSH_WIDTH * feed.tile_patch.count);
  T* ways = scratch.take<T>(slots);
  if (scratch.overflowed) return;
  for (int64_t block = 0; block < blocks; ++block)
    put3(start + 3 * LANES * block, points_at(vertices, feed.block_vertex + LANES * block));
  find_push_planes(start, skin, feed, logs, clearance, region, planes);
  for (int64_t block = 0; block < blocks; ++block)
    put3(moved + 3 * LANES * block, pushed_out<T>(planes + 2 * PUSH_PLANE * block, Points<T>{}));
  for (int64_t i = 0; i < 3 * TERMS * feed.patches; ++i) coefficients[i] = 0;
  for (int64_t round = 0; round < rounds; ++round) {
    fit_push(moved, feed, round ? T(JET_OVER) : T(1), means, coefficients);
    blend_push(coefficients, feed, said, moved);
    Row<T> furthest = row_of(T(0));
    for (int64_t block = 0; block < blocks; ++block) {
      T* own = moved + 3 * LANES * block;
      const Points<T> carried = rows3_at(own), after = pushed_out<T>(planes + 2 * PUSH_PLANE * block, carried);
      const Points<T> rest = after - carried;
      furthest = most<T>(furthest, dot(rest, rest));
      put3(own, rest);
      if (round) continue;
      put_points(places + 3 * LANES * block, rows3_at(start + 3 * LANES * block) + after);
      put(ways + LANES * block, root<T>(dot(after, after)));
    }
    *left = 0;
    for (int lane = 0; lane < LANES; ++lane) *left = more(root(T(furthest[lane])), *left);
    for (int64_t v = 0; round == 0 && v < feed.vertex_slot.count; ++v) {
      put_point(out, v, point(places, feed.vertex_slot[v]));
      way[v] = ways[feed.vertex_slot[v]];
    }
  }
  scratch.used = mark;
}

// Writes the samples (4 clusters, 8) on garments with the draped vertices under [m] (U, 3). They come in clusters of
// four, whose points and two tangents are sums over member (clusters, 24) with the weights rows (clusters, 24, 12).
template <class T> void pose_cloth(const T* under, const int32_t* member, const T* rows, int64_t clusters, T* samples) {
  for (int64_t cluster = 0; cluster < clusters; ++cluster) {
    Four<T> sum[3][3] = {};
    for (int m = 0; m < CLOTH_MEMBERS; ++m, ++member, rows += 3 * CLUSTER_SIZE) {
      const T* place = under + 3 * int64_t(*member);
      for (int kind = 0; kind < 3; ++kind)
        for (int axis = 0; axis < 3; ++axis)
          sum[kind][axis] = sum[kind][axis] + loaded<Four<T>>(rows + CLUSTER_SIZE * kind) * place[axis];
    }
    Points<T> posed[3] = {};
    for (int kind = 0; kind < 3; ++kind)
      for (int i = 0; i < CLUSTER_SIZE; ++i) {
        posed[kind].x[i] = sum[kind][0][i];
        posed[kind].y[i] = sum[kind][1][i];
        posed[kind].z[i] = sum[kind][2][i];
      }
    put_samples<T>(samples + 8 * CLUSTER_SIZE * cluster, posed[0], unit_cross<T>(posed[1], posed[2]), CLUSTER_SIZE);
  }
}

}  // namespace network
