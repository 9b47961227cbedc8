// Parts of folds, lift, layers and colliders that tests hold to their laws one by one.
#include "eased.hpp"
#include "exports.hpp"
#include "layers.hpp"

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT void drape_law_farthest_##suffix(const T* x, const T* y, int64_t places, T* far) {                            \
    *far = farthest_m(x, y, places);                                                                                   \
  }                                                                                                                    \
  EXPORT int64_t drape_law_turns_##suffix(const T* before, const T* network, const FoldConstants<T>* cloth,            \
                                          int64_t passes, T* turns, Scratch* scratch) {                                \
    const int64_t count = FRAMES * (cloth->sheet.vertex.count / LANES);                                                \
    T *then = scratch->take<T>(count), *now = scratch->take<T>(count);                                                 \
    if (scratch->overflowed) return -1;                                                                                \
    surface_frames(before, cloth->sheet, then);                                                                        \
    surface_frames(network, cloth->sheet, now);                                                                        \
    surface_turns(then, now, cloth->sheet, int(passes), turns, *scratch);                                              \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT void drape_law_carry_gradient_##suffix(const T* x, const T* before, const T* turns,                           \
                                                const FoldConstants<T>* cloth, T* gradient) {                          \
    carry_gradient(x, before, turns, cloth->sheet, gradient);                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_law_forget_##suffix(const T* before, const T* network, const FoldConstants<T>* cloth, T* forget,\
                                           Scratch* scratch) {                                                         \
    T* frames = scratch->take<T>(FRAMES * (cloth->sheet.vertex.count / LANES));                                        \
    if (scratch->overflowed) return -1;                                                                                \
    surface_frames(network, cloth->sheet, frames);                                                                     \
    write_forget(before, network, frames, cloth->sheet, forget);                                                       \
    return 0;                                                                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_law_mend_##suffix(T* off, const FoldConstants<T>* cloth, double far, const T* forget,           \
                                         Scratch* scratch) {                                                           \
    T* before = scratch->take<T>(3 * cloth->sheet.vertex.count);                                                       \
    if (scratch->overflowed) return -1;                                                                                \
    mend(off, cloth->sheet, T(far), forget, before);                                                                   \
    return 0;                                                                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_law_even_hem_##suffix(T* off, const T* before, const T* network, const FoldConstants<T>* cloth, \
                                             Scratch* scratch) {                                                       \
    T* even = scratch->take<T>(cloth->hem.count);                                                                      \
    if (scratch->overflowed) return -1;                                                                                \
    even_hem(off, before, network, cloth->hem, even);                                                                  \
    return 0;                                                                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_law_ease_##suffix(T* x, const T* network, const T* crossed, double share,                       \
                                         const FoldConstants<T>* cloth, Scratch* scratch) {                            \
    ease(x, network, crossed, T(share), cloth->sheet, *scratch);                                                       \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_ease_off_##suffix(const T* under, const T* before, double share, const int32_t* own,        \
                                             const T* skin, int64_t samples, const FoldConstants<T>* cloth,            \
                                             int64_t steps, T* eased, T* off, Scratch* scratch) {                      \
    const int64_t places = cloth->sheet.vertex.count;                                                                  \
    int32_t *here = scratch->take<int32_t>(places), *other = scratch->take<int32_t>(places);                           \
    int32_t* at = scratch->take<int32_t>(places);                                                                      \
    if (scratch->overflowed) return -1;                                                                                \
    for (int64_t p = 0; p < places; ++p) here[p] = own[p];                                                             \
    ease_off(under, before, T(share), here, other, at, skin_of(skin, samples, cloth->graph), *cloth, steps, eased,     \
             off, *scratch);                                                                                           \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT void drape_law_lift_##suffix(T* x, int64_t places, const T* planes, double clearance, T* way) {               \
    lift(x, places, planes, T(clearance), way);                                                                        \
  }                                                                                                                    \
  EXPORT int64_t drape_law_limit_##suffix(T* x, const FoldConstants<T>* cloth, Scratch* scratch) {                     \
    limit_strain(x, cloth->sheet, *scratch);                                                                           \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_rooms_##suffix(const T* points, const SheetNeighbours<T>* neighbours, double reach, T* room,\
                                          int32_t* nearest, Scratch* scratch) {                                        \
    rooms(points, *neighbours, T(reach), room, nearest, *scratch);                                                     \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_fine_room_##suffix(const T* x, const T* coarse, const Levels<T>* levels, T* planes,         \
                                              Scratch* scratch) {                                                      \
    keep_fine_apart<T>(x, coarse, *levels, planes, *scratch);                                                          \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_crossing_##suffix(const T* x, const Tangles<T>* tangles, const int32_t* chosen,             \
                                             int64_t count, int32_t* pairs, Scratch* scratch) {                        \
    const int64_t found = crossing(x, *tangles, chosen, count, (Pair*)pairs, *scratch);                                \
    return scratch->overflowed ? -1 : found;                                                                           \
  }                                                                                                                    \
  EXPORT int64_t drape_law_untangle_##suffix(T* x, int64_t places, const Tangles<T>* tangles, const int32_t* chosen,   \
                                             int64_t number, double farthest, T* count, Scratch* scratch) {            \
    const int64_t found = untangle(x, places, *tangles, chosen, number, T(farthest), UNTANGLE_STEPS, count, *scratch); \
    return scratch->overflowed ? -1 : found;                                                                           \
  }                                                                                                                    \
  EXPORT void drape_law_hold_##suffix(const FoldConstants<T>* cloth, T* planes) {                                      \
    hold_places<T>(cloth->sheet, nullptr, T(0), planes);                                                               \
  }                                                                                                                    \
  EXPORT void drape_law_gradient_##suffix(const T* x, const FoldConstants<T>* cloth, const T* planes, const T* network,\
                                          T* gradient) {                                                               \
    gradient_at(x, cloth->sheet, planes, network, T(HOLD), gradient);                                                  \
  }                                                                                                                    \
  EXPORT void drape_law_sweep_##suffix(T* x, const FoldConstants<T>* cloth, const T* planes, const T* network,        \
                                       int64_t over) {                                                                 \
    descend(x, cloth->sheet, planes, network, over);                                                                   \
  }                                                                                                                    \
  EXPORT int64_t drape_law_whole_step_##suffix(T* x, const FoldConstants<T>* cloth, const T* gradient,                \
                                               Scratch* scratch) {                                                     \
    const int64_t count = cloth->factor.place.count;                                                                   \
    T *q = scratch->take<T>(3 * count), *s = scratch->take<T>(3 * (count + LANES));                                    \
    if (scratch->overflowed) return -1;                                                                                \
    whole_step(x, cloth->factor, gradient, q, s);                                                                      \
    return 0;                                                                                                          \
  }                                                                                                                    \
  EXPORT int64_t drape_law_solve_##suffix(const FoldConstants<T>* cloth, T* y, Scratch* scratch) {                     \
    T* s = scratch->take<T>(3 * (cloth->factor.place.count + LANES));                                                  \
    if (scratch->overflowed) return -1;                                                                                \
    solve(cloth->factor, y, s);                                                                                        \
    return 0;                                                                                                          \
  }                                                                                                                    \
  EXPORT void drape_law_stuck_places_##suffix(const T* grip, int64_t places, const int32_t* own, const T* skin,        \
                                              int64_t samples, const SkinGraph<T>* graph, T* stuck) {                  \
    stuck_places(grip, places, own, skin_of(skin, samples, *graph), stuck);                                            \
  }                                                                                                                    \
  EXPORT int64_t drape_law_touch_##suffix(const T* x, const T* network, int64_t places,                                \
                                          const T* skin, int64_t samples,                                              \
                                          const SkinGraph<T>* graph, const int32_t* vertex, int32_t* own,              \
                                          int32_t* other, int32_t* at, int64_t turn, T* planes, Scratch* scratch) {    \
    touch(x, network, places, skin_of(skin, samples, *graph), vertex, own, other, at, turn, planes, *scratch);         \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT void drape_law_own_planes_##suffix(const T* x, int64_t places, const T* skin, int64_t samples,                \
                                            const SkinGraph<T>* graph, const int32_t* own, const int32_t* parent,      \
                                            T* planes) {                                                               \
    put_own_planes(x, places, skin_of(skin, samples, *graph), own, parent, planes);                                    \
  }                                                                                                                    \
  EXPORT void drape_law_other_planes_##suffix(const T* x, int64_t places, const T* skin, int64_t samples,              \
                                              const SkinGraph<T>* graph, const int32_t* other, const int32_t* parent,  \
                                              T* planes) {                                                             \
    put_other_planes(x, places, skin_of(skin, samples, *graph), other, parent, planes);                                \
  }                                                                                                                    \
  EXPORT void drape_law_stay_above_skin_##suffix(const T* x, int64_t places, const int32_t* own, const T* skin,        \
                                                 int64_t samples, const SkinGraph<T>* graph, T* down) {                \
    layers::stay_above_skin(x, places, own, skin_of(skin, samples, *graph), down);                                     \
  }

FOR_TYPE(float, f32)
FOR_TYPE(double, f64)

// What folds do in motion: calmness, grip, the longest step of untangling [m], momentum.
EXPORT void drape_law_pace_f64(double way_m, double step_s, int64_t stiff, double* out) {
  const double calm = calmness(way_m), found[] = {calm, grip_left(way_m, step_s), farthest_way(way_m),
                                                  momentum_of(calm, stiff)};
  __builtin_memcpy(out, found, sizeof found);
}

// The colliders (M, 16), all of float64.
static Array<double> rows(const double* colliders, int64_t count) {
  Array<double> found;
  found.begin = (double*)colliders, found.count = COLLIDER * count;
  return found;
}
static void put_out(double* to, Out out) {
  to[0] = out.distance;
  put_point(to + 1, 0, out.normal);
}
EXPORT void drape_law_outside_f64(const double* collider, const double* at, double* out) {
  put_out(out, outside_of(collider, point(at, 0)));
}
EXPORT void drape_law_entered_f64(const double* collider, const double* start, const double* end, double* out) {
  put_out(out, entered(collider, point(start, 0), point(end, 0)));
}
EXPORT int64_t drape_law_node_planes_f64(const double* c, const double* came, int64_t nodes, const double* colliders,
                                         int64_t count, const double* skin, const int32_t* touched, double* planes) {
  return write_node_planes(c, came, nodes, false, rows(colliders, count), skin, touched, planes);
}
EXPORT void drape_law_collider_planes_f64(const double* x, int64_t places, const double* colliders, int64_t count,
                                          double* planes) {
  put_collider_planes(x, places, rows(colliders, count), planes);
}
EXPORT void drape_law_leave_f64(double* x, int64_t places, const double* colliders, int64_t count, const double* planes,
                                double clearance) {
  leave_colliders(x, places, rows(colliders, count), planes, clearance);
}
