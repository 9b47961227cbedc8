// Garments over and below each other: the skin that an outer one feels, and the ceiling that it is to an inner one.
//
// Raised skin. A sample of the skin goes up along its normal to the highest vertex of the inner garments that lies over
// it, within the samples' spacing. So an outer garment rests on the inner one as that does on the body, with the same
// gap. The skin tells on which side of the inner garment the outer one is, so that this side cannot be lost. Cloth may
// span a crease: trousers hang before the belly of one who squats, far from both of its walls. Walls that were raised
// to that cloth would stand in each other and crumple the outer garment. A sample therefore goes no farther than half
// of the way to skin that faces it; but it goes at least as far as the height of the vertex times the cosine between
// the cloth's normal and the skin's. A sample that rises above CLOSE_M rises above its neighbours below cloth by no
// more than STEEPEST of their distance: no outer garment follows a steeper ground without passing through itself.
//
// Ceiling. In life the outer garment presses the inner one to the skin. So it is a ceiling: for each sample of the skin
// the tangent plane of the outer cloth at the lowest of its vertices that lies over the sample. A sample beside it
// counts as covered where most of its neighbours are, and gets the mean of their planes. What is above the ceiling
// comes down along the planes' normals, to CEILING_GAP_M below the lowest of those of its own sample and of the samples
// around, though no nearer than LEAST_OVER_M to what lies below it. The cloth around comes along: way D spreads over
// the triangles, of two neighbours at distance l
//
//     D_v = (1 - l / FADE_M) D_u   where that is longer than D_v,
//
// and is evened out, since a step at the hem of the outer garment would show below it. Evened, it stays above the skin
// as well. What is above the ceiling still then comes down alone.
#pragma once
#include "places.hpp"
#include "skin.hpp"

namespace layers {

constexpr double HIGHEST_M = 0.06;   // cloth higher than that hangs free
constexpr double SPANNED_M = 0.005;  // where height and height times cosine differ by less, no look is taken across
constexpr double CLOSE_M = 0.02, STEEPEST = 0.7;
constexpr int STEEP_TURNS = 3;       // that look for steep samples, there and back
constexpr double ASIDE = 3.0;        // in spacings: skin farther than that off a sample's normal does not face it
constexpr double CEILING_GAP_M = 0.003;  // contact's gap: the ground then leaves the outer garment where its drape is
constexpr double LEAST_OVER_M = 0.0025;
constexpr double COVERS_M = 0.12;  // an outer garment farther out covers nothing
constexpr int MOST_COVERED = 5, FILLS = 2;  // covered neighbours that make a sample covered, and times of filling so
constexpr double FADE_M = 0.1;
constexpr int EVENED = 4;               // times that the way is averaged with that of the neighbours
constexpr double LEAST_WAY_M = 1e-3;    // by which a way must grow, or the line gets long
constexpr double ASLANT = 0.05;  // cosine between plane and skin below which the skin bounds no way along the plane

constexpr int CEILING = 5;  // of a sample: height [m], infinite where nothing covers it; normal; offset [m]

template <class T> struct Over { T up, aside; };  // how high [m] over a sample, how far from its normal [m^2]
template <class T> INLINE Over<T> over(Vector<T> at, const Skin<T>& skin, int64_t s) {
  const Vector<T> way = at - skin.point_of(s);
  const T up = dot(way, skin.normal_of(s));
  return {up, dot(way, way) - up * up};
}
// Returns the own sample for n = -1, and then its neighbours.
template <class T> INLINE int32_t sample_at(const Skin<T>& skin, int32_t own, int n) {
  return n < 0 ? own : skin.neighbour[NEIGHBOURS * own + n];
}

// Returns half of the distance [m] along the normal from sample s to skin that faces it, at most far [m].
template <class T> INLINE T half_way(int64_t s, T far, const Skin<T>& skin, const Grid& grid) {
  const Vector<T> normal = skin.normal_of(s), here = skin.point_of(s);
  const T aside = T(ASIDE * ASIDE) * skin.reach_m2[s];
  T nearest = far + far;
  const Cells cells = cells_around(grid, plus(here, far, normal), double(far + root(aside)));
  for (int64_t i = cells.first[0]; i < cells.last[0]; ++i)
    for (int64_t j = cells.first[1]; j < cells.last[1]; ++j) {
      const Run run = column(grid, i, j, cells);
      for (int64_t entry = run.begin; entry < run.end; ++entry) {
        const int32_t other = grid.member[entry];
        const Vector<T> way = skin.point_of(other) - here;
        const T along = dot(way, normal);
        const bool faces = dot(normal, skin.normal_of(other)) < 0 && dot(way, way) - along * along < aside;
        if (along > 0 && along < nearest && faces) nearest = along;
      }
    }
  return T(0.5) * nearest;
}

// Lowers the heights [m] (S,) of samples that stand out steeply from their neighbours. The samples that begin higher
// than CLOSE_M are visited in their order, there and back, by one thread, for each reads what the one before has left.
template <class T> DEVICE void lower_steep(const Skin<T>& skin, T* height, Scratch& scratch) {
  int32_t* high = scratch.take<int32_t>(skin.count);
  if (scratch.overflowed) return;
  const int64_t count = collect(skin.count, high, skin.count, [&](int64_t s, int32_t* to, int64_t room) -> int64_t {
    if (!(height[s] > T(CLOSE_M))) return 0;
    if (room > 0) *to = int32_t(s);
    return 1;
  });
  for (int64_t turn : each(count ? 1 : 0))
    for (; turn < 2 * STEEP_TURNS; ++turn)
      for (int64_t entry = 0; entry < count; ++entry) {
        const int64_t s = high[turn % 2 == 0 ? entry : count - 1 - entry];
        for (int n = 0; height[s] > T(CLOSE_M) && n < NEIGHBOURS; ++n) {
          const int32_t other = skin.neighbour[NEIGHBOURS * s + n];
          if (!(height[other] > 0)) continue;
          const Vector<T> apart = point(skin.rest, s) - point(skin.rest, other);
          height[s] = less<T>(height[s], more<T>(height[other] + T(STEEPEST) * root(dot(apart, apart)), T(CLOSE_M)));
        }
      }
}

// Writes how high [m] (S,) a garment raises each sample of the skin, 0 where no vertex lies over it. Its triangles face
// outward, its vertices are [m] (V, 3). Each place raises the sample that it lies at, own (P,), and that one's
// neighbours.
template <class T>
DEVICE void heights_over(const T* vertices, const LaidCloth<T>& cloth, const int32_t* own, const Skin<T>& skin,
                         T* height, Scratch& scratch) {
  const int64_t mark = scratch.used, places = cloth.sheet.vertex.count;
  T *frames = scratch.take<T>(FRAMES * (places / LANES)), *far = scratch.take<T>(skin.count);
  T* x = scratch.take<T>(3 * places);
  const Grid grid = grid_of(skin.samples, skin.count, 8, PER_CELL, scratch);
  if (scratch.overflowed) return;
  placed(vertices, cloth.sheet.vertex, x);
  surface_frames(x, cloth.sheet, frames);
  for (int64_t s : each(skin.count)) height[s] = far[s] = 0;
  for (int64_t v : each(places)) {
    const Vector<T> lies = lane3(frames + FRAMES * (v / LANES), int(v % LANES)), at = point(x, v);
    for (int n = -1; n < NEIGHBOURS; ++n) {
      const int32_t s = sample_at(skin, own[v], n);
      const Over<T> o = over(at, skin, s);
      if (!(o.up > height[s] && o.aside < skin.reach_m2[s])) continue;
      const T up = less<T>(o.up, T(HIGHEST_M));
      raise_to(far + s, up);
      raise_to(height + s, up * dot(lies, skin.normal_of(s)));
    }
  }
  for (int64_t s : each(skin.count))
    height[s] = far[s] > height[s] + T(SPANNED_M) ? more<T>(height[s], half_way(s, far[s], skin, grid)) : far[s];
  lower_steep(skin, height, scratch);
  scratch.used = mark;
}

// Writes the samples (S, 8) of a ground moved out along their normals by the height [m] (S,) of each.
template <class T> DEVICE void raise(const T* ground, int64_t samples, const T* height, T* raised) {
  for (int64_t s : each(samples)) {
    const T *from = ground + 8 * s, up[3] = {height[s] * from[4], height[s] * from[5], height[s] * from[6]};
    T *to = raised + 8 * s, square[3], across[3];
    for (int i = 0; i < 3; ++i) to[i] = from[i] + up[i], to[4 + i] = from[4 + i];
    for (int i = 0; i < 3; ++i) square[i] = to[i] * to[i], across[i] = to[i] * to[4 + i];
    to[3] = square[0] + square[1] + square[2];
    to[7] = across[0] + across[1] + across[2];
  }
}

// Writes the ceiling (S, 5) that a garment with vertices [m] (V, 3) makes over the samples of the skin.
template <class T>
DEVICE void ceiling_over(const T* vertices, const LaidCloth<T>& cloth, const Skin<T>& skin, T* ceiling,
                         Scratch& scratch) {
  const int64_t mark = scratch.used, places = cloth.sheet.vertex.count;
  T *frames = scratch.take<T>(FRAMES * (places / LANES)), *before = scratch.take<T>(CEILING * skin.count);
  T* x = scratch.take<T>(3 * places);
  int32_t* own = scratch.take<int32_t>(places);
  Lowest<T>* lowest = scratch.take<Lowest<T>>(skin.count);
  if (scratch.overflowed) return;
  placed(vertices, cloth.sheet.vertex, x);
  for (int64_t p : each(places)) own[p] = cloth.index[p];
  follow(x, places, skin, own);
  surface_frames(x, cloth.sheet, frames);
  for (int64_t s : each(skin.count)) lowest[s].clear(T(COVERS_M));
  for (int64_t v : each(places)) {
    const Vector<T> lies = lane3(frames + FRAMES * (v / LANES), int(v % LANES)), at = point(x, v);
    for (int n = -1; n < NEIGHBOURS; ++n) {
      const int32_t s = sample_at(skin, own[v], n);
      const Over<T> o = over(at, skin, s);
      const bool faces_out = dot(lies, skin.normal_of(s)) > 0;  // of a trunk's cloth not over an arm's skin
      if (faces_out && (n < 0 || o.aside < skin.reach_m2[s])) lowest[s].offer(o.up, int32_t(v));
    }
  }
  for (int64_t s : each(skin.count)) {
    T* to = ceiling + CEILING * s;
    const int32_t v = lowest[s].who();
    to[0] = v < 0 ? T(__builtin_inf()) : lowest[s].value();
    if (v < 0) put_point(to + 1, 0, Vector<T>{}), to[4] = 0;
    if (v < 0) continue;
    const Vector<T> lies = lane3(frames + FRAMES * (v / LANES), int(v % LANES));
    put_point(to + 1, 0, lies);
    to[4] = dot(lies, point(x, v));
  }
  for (int fill = 0; fill < FILLS; ++fill) {
    copy(before, ceiling, CEILING * skin.count);
    for (int64_t s : each(skin.count)) {
      if (before[CEILING * s] < T(__builtin_inf())) continue;
      T total[CEILING] = {};
      int covered = 0;
      for (int n = 0; n < NEIGHBOURS; ++n) {
        const T* other = before + CEILING * skin.neighbour[NEIGHBOURS * s + n];
        if (!(other[0] < T(__builtin_inf()))) continue;
        ++covered;
        for (int i = 0; i < CEILING; ++i) total[i] += other[i];
      }
      const T length = root(dot(point(total + 1, 0), point(total + 1, 0)));
      if (covered < MOST_COVERED || !(length > 0)) continue;
      T* to = ceiling + CEILING * s;
      to[0] = total[0] / T(covered);
      for (int i = 1; i < CEILING; ++i) to[i] = total[i] / length;
    }
  }
  scratch.used = mark;
}

// Writes the way down [m] (P, 3) of each place that is above the ceiling of the samples that it lies over, zero
// elsewhere. Returns whether any is.
template <class T>
DEVICE bool too_high(const T* x, int64_t places, const int32_t* own, const Skin<T>& skin, const T* ceiling, T* down) {
  int found = 0;
  for (int64_t v : each(places)) {
    const Vector<T> at = point(x, v);
    T highest = 0;
    Vector<T> normal = {};
    for (int n = -1; n < NEIGHBOURS; ++n) {
      const int32_t s = sample_at(skin, own[v], n);
      const T* plane = ceiling + CEILING * s;
      const Over<T> o = over(at, skin, s);
      if (plane[0] == T(__builtin_inf()) || (n >= 0 && !(o.aside < skin.reach_m2[s]))) continue;
      const Vector<T> axis = point(plane + 1, 0);
      T high = dot(axis, at) - plane[4] + T(CEILING_GAP_M);
      const T along = dot(axis, skin.normal_of(s));
      if (along > T(ASLANT)) high = less<T>(high, (o.up - T(LEAST_OVER_M)) / along);
      highest = more<T>(highest, high);
      normal = normal + axis;
    }
    const T length = root(dot(normal, normal));
    if (!(highest > 0 && length > 0)) continue;
    found = 1;
    const Vector<T> way = scaled(-highest, normal);
    put_point(down, v, Vector<T>{way.x / length, way.y / length, way.z / length});
  }
  return most_of_all(found);
}

// Shortens the ways down [m] (P, 3) that end nearer than LEAST_OVER_M to the skin. The skin is the highest of the
// planes of the samples below: in a hollow, as at the neck, the plane of one sample is too low.
template <class T>
DEVICE void stay_above_skin(const T* x, int64_t places, const int32_t* own, const Skin<T>& skin, T* down) {
  for (int64_t v : each(places)) {
    const Vector<T> way = point(down, v), at = point(x, v);
    if (way.x == 0 && way.y == 0 && way.z == 0) continue;
    T share = 1;
    for (int n = -1; n < NEIGHBOURS; ++n) {
      const int32_t s = sample_at(skin, own[v], n);
      const Over<T> o = over(at, skin, s);
      const T deep = -dot(way, skin.normal_of(s)), room = more<T>(o.up - T(LEAST_OVER_M), T(0));
      if (deep * share > room && (n < 0 || o.aside < skin.reach_m2[s])) share = room / deep;
    }
    if (share < 1) put_point(down, v, scaled(share, way));
  }
}

// Spreads the ways down [m] (P, 3), in place, to the cloth around. A place that moves is put into a queue, and its
// neighbours are visited in turn; the queue has an order, so one thread goes along it.
template <class T> DEVICE void spread_down(const T* x, const Sheet<T>& sheet, T* down, Scratch& scratch) {
  const int64_t mark = scratch.used, count = sheet.vertex.count;
  T *length = scratch.take<T>(count), *before = scratch.take<T>(3 * count);
  int32_t* line = scratch.take<int32_t>(count);
  uint8_t* waits = scratch.take<uint8_t>(count);
  if (scratch.overflowed) return;
  auto fan = [&](int64_t v, auto&& visit) {
    for (int64_t row = 2 * sheet.fan_start[v / LANES]; row < 2 * sheet.fan_start[v / LANES + 1]; ++row)
      visit(sheet.fan_other[LANES * row + v % LANES]);
  };
  auto moves = [&](int64_t v, int32_t* to, int64_t room) -> int64_t {
    if (!(length[v] > 0)) return 0;
    if (room > 0) *to = int32_t(v);
    return 1;
  };
  for (int64_t v : each(count)) length[v] = root(dot(point(down, v), point(down, v))), waits[v] = length[v] > 0;
  const int64_t begun = collect(count, line, count, moves);
  for (int64_t first : each(1)) {
    int64_t last = begun;
    for (int64_t waiting = last; waiting > 0; --waiting) {
      const int64_t v = line[first++ % count];
      waits[v] = 0;
      fan(v, [&](int64_t other) {
        if (!(length[v] > length[other])) return;
        const Vector<T> way = point(x, v) - point(x, other);
        const T share = T(1) - root(dot(way, way)) / T(FADE_M);
        if (!(share * length[v] > length[other] + T(LEAST_WAY_M))) return;
        length[other] = share * length[v];
        put_point(down, other, scaled(share, point(down, v)));
        if (waits[other]) return;
        line[last++ % count] = int32_t(other), waits[other] = 1;
        ++waiting;
      });
    }
  }
  const int64_t moved = collect(count, line, count, moves);
  copy(before, down, 3 * count);
  for (int turn = 0; turn < EVENED; ++turn) {
    for (int64_t entry : each(moved)) {
      const int64_t v = line[entry];
      Vector<T> total = point(before, v);
      T number = 1;
      fan(v, [&](int64_t other) { total = total + point(before, other), number += T(1); });
      put_point(down, v, Vector<T>{total.x / number, total.y / number, total.z / number});
    }
    for (int64_t entry : each(moved)) put_point(before, line[entry], point(down, line[entry]));
  }
  scratch.used = mark;
}

// Writes the vertices pressed [m] (V, 3) of an inner garment: those above the ceiling (S, 5) go below it and take the
// cloth around along. Returns whether any was above. own (P,) is the sample that each place lies at.
template <class T>
DEVICE bool press(const T* vertices, const LaidCloth<T>& cloth, const int32_t* own, const Skin<T>& ground,
                  const T* ceiling, T* pressed, Scratch& scratch) {
  const int64_t mark = scratch.used, places = cloth.sheet.vertex.count;
  T *down = scratch.take<T>(3 * places), *x = scratch.take<T>(3 * places);
  if (scratch.overflowed) return false;
  placed(vertices, cloth.sheet.vertex, x);
  for (int64_t i : each(3 * places)) down[i] = 0;
  const bool found = too_high(x, places, own, ground, ceiling, down);
  if (found) {
    spread_down(x, cloth.sheet, down, scratch);
    stay_above_skin(x, places, own, ground, down);
    for (int64_t i : each(3 * places)) x[i] += down[i], down[i] = 0;
    too_high(x, places, own, ground, ceiling, down);
    for (int64_t v : each(cloth.sheet.place.count))
      put_point(pressed, v, point(x, cloth.sheet.place[v]) + point(down, cloth.sheet.place[v]));
  }
  scratch.used = mark;
  return found;
}

}  // namespace layers
