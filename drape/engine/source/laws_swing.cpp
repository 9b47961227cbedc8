// Parts of swing that tests hold to their laws one by one.
#include "exports.hpp"
#include "swing.hpp"

namespace {

// Writes gradient and Hessian of the length's energy at the places x [m] (P, 3), nine rows a block, to found; still are
// the places in still cloth.
template <class T>
void length(const T* x, const T* still, const SwingRows<T>& rows, T young, T* found, Scratch& scratch) {
  T* bound = scratch.take<T>(6 * LANES * rows.start[rows.moving]);
  if (scratch.overflowed) return;
  swing::write_bounds(still, rows, bound);
  for (int64_t block = 0; block < rows.moving; ++block) {
    const Model<T> model = swing::length_model(x, block, rows, young, bound);
    const Symmetric<Row<T>> h = model.hessian;
    T* to = found + 9 * LANES * block;
    put3(to, model.gradient);
    put3(to + 3 * LANES, Points<T>{h.xx, h.xy, h.xz});
    put3(to + 6 * LANES, Points<T>{h.yy, h.yz, h.zz});
  }
}

// Sweeps the nodes c [m] (N, 3), far from any skin, by springs [N/m] (N,) to their targets [m] (N, 3).
template <class T>
void keep_length(T* c, const T* target, const T* spring, const T* still, const SwingMesh<T>& mesh, T young,
                 int64_t sweeps, Scratch& scratch) {
  const SwingRows<T>& rows = mesh.rows;
  const int64_t nodes = mesh.vertex.count, places = 3 * rows.node.count;
  T *x = scratch.take<T>(places), *rest = scratch.take<T>(places), *held = scratch.take<T>(swing::HELD * rows.moving);
  T *bound = scratch.take<T>(6 * LANES * rows.start[rows.moving]), *planes = scratch.take<T>(8 * nodes);
  int32_t *touched = scratch.take<int32_t>(nodes), *other = scratch.take<int32_t>(nodes);
  if (scratch.overflowed) return;
  for (int64_t i = 0; i < 8 * nodes; ++i) planes[i] = 0;
  for (int64_t i = 0; i < nodes; ++i) touched[i] = 0, other[i] = -1;
  const T far[8] = {0, 5, 0, 0, 0, 1, 0, 0};
  swing::at_places(still, rows, rest);
  swing::write_bounds(rest, rows, bound);
  const bool beside = swing::lay_held(target, spring, {far, other, touched, planes, planes}, mesh, held);
  swing::at_places(c, rows, x);
  swing::keep_length(c, x, rows, young, bound, held, beside, sweeps);
}

// Writes the columns of the rotations nearest to sixteen matrices, nine rows each, to found.
template <class T> void rotations(const T* m, T least_, T* found) {
  const Matrix<T> r = rotation_of<T>({rows3_at(m), rows3_at(m + 3 * LANES), rows3_at(m + 6 * LANES)}, row_of(least_));
  put3(found, r.a), put3(found + 3 * LANES, r.b), put3(found + 6 * LANES, r.c);
}

}  // namespace

#define FOR_TYPE(T, suffix)                                                                                            \
  EXPORT int64_t drape_law_length_##suffix(const T* x, const T* still, const SwingRows<T>* rows, double young,         \
                                           T* found, Scratch* scratch) {                                               \
    length(x, still, *rows, T(young), found, *scratch);                                                                \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_keep_length_##suffix(T* c, const T* target, const T* spring, const T* still,                \
                                                const SwingMesh<T>* mesh, double young, int64_t sweeps,                \
                                                Scratch* scratch) {                                                    \
    keep_length(c, target, spring, still, *mesh, T(young), sweeps, *scratch);                                          \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_fall_back_##suffix(T* u, const SwingMesh<T>* mesh, const T* inertia, const T* hold,         \
                                              const T* rhs, int64_t rounds, Scratch* scratch) {                        \
    swing::fall_back(u, *mesh, inertia, hold, T(1), rhs, rounds, *scratch);                                            \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_move_vertices_##suffix(const T* vertices, int64_t count, const T* still, const T* swung,    \
                                                  const SwingMesh<T>* mesh, double share, T* out, Scratch* scratch) {  \
    move_vertices(vertices, count, still, swung, *mesh, T(share), out, *scratch);                                      \
    return -scratch->overflowed;                                                                                       \
  }                                                                                                                    \
  EXPORT int64_t drape_law_rotations_##suffix(const T* m, double least_, T* found) {                                   \
    rotations(m, T(least_), found);                                                                                    \
    return 0;                                                                                                          \
  }

FOR_TYPE(double, f64)
