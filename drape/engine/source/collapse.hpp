// A coarse cloth on some of a garment's vertices: half-edges of its mesh collapse, the shortest first.
//
// A vertex u goes to its neighbour v, and the triangles around u have v for u (Hoppe et al. 1993, "Mesh optimization",
// SIGGRAPH). Triangles at rest are laid flat along warp and weft, so that a corner is moved in the triangle's own chart
// by the way from u to v there. Neither lengths nor grain are lost. Seams, creases and borders are lines: along a seam
// two charts differ, along a border there is one triangle. Vertices on a line go along it only, and where lines meet or
// end they stay. Cloth that is no panels has no seams: a way turns as it goes from chart to chart.
#pragma once
#include "arrays.hpp"

namespace collapse {

constexpr int MOST = 24;  // triangles around a vertex; one with more of them stays
constexpr int LINES = 4;  // edges of a vertex on lines that are remembered
constexpr double SEAM = 0.05;      // share of its length by which an edge differs in the two charts beside a seam
constexpr double STRAIGHT = 0.8;   // cosine of the angle up to which a line may turn in a vertex that goes
constexpr double THINNEST = 0.3;   // 4 sqrt(3) area / sum of squared sides: 1 in a triangle of equal sides
constexpr double ROOT_OF_3 = 1.7320508075688772;

struct Way { double x, y; };  // in a chart [m]
INLINE Way operator-(Way a, Way b) { return {a.x - b.x, a.y - b.y}; }
INLINE double square(Way a) { return a.x * a.x + a.y * a.y; }
INLINE double twice_area(const Way* p) {
  const Way a = p[1] - p[0], b = p[2] - p[0];
  return a.x * b.y - a.y * b.x;
}

// A mesh whose edges are collapsed.
struct Mesh {
  int32_t* faces;    // (F, 3)
  Way* corner;       // (F, 3), each in its triangle's chart
  int32_t* lines;    // (V, LINES): neighbours along lines, -1 where there are no more
  int32_t* fan;      // (V, MOST): triangles around each vertex
  int32_t* valence;  // (V,): their number
  int64_t vertex_count, face_count;
  bool panels;  // whether charts are those of panels

  bool has(int32_t f, int32_t v) const { return faces[3 * f] == v || faces[3 * f + 1] == v || faces[3 * f + 2] == v; }
  int corner_of(int32_t f, int32_t v) const { return faces[3 * f] == v ? 0 : faces[3 * f + 1] == v ? 1 : 2; }
  Way place(int32_t f, int32_t v) const { return corner[3 * f + corner_of(f, v)]; }
  int32_t around(int32_t v, int i) const { return fan[MOST * v + i]; }
  int32_t line(int32_t v, int n) const { return lines[LINES * v + n]; }
  bool is_line(int32_t u, int32_t v) const {
    return line(u, 0) == v || line(u, 1) == v || line(u, 2) == v || line(u, 3) == v;
  }
  // Returns the neighbour of u along its line that is not v; v is the other one.
  int32_t far_side(int32_t u, int32_t v) const { return line(u, 0) == v ? line(u, 1) : line(u, 0); }
};

inline void find_fans(const Mesh& mesh) {
  for (int64_t v = 0; v < mesh.vertex_count; ++v) mesh.valence[v] = 0;
  for (int64_t n = 0; n < 3 * mesh.face_count; ++n) {
    const int32_t v = mesh.faces[n];
    if (mesh.valence[v] < MOST) mesh.fan[MOST * v + mesh.valence[v]] = int32_t(n / 3);
    ++mesh.valence[v];
  }
}

// Marks the edge between two vertices as part of a line, at both of them. A vertex with more than LINES such edges
// loses the last one; it stays in any case.
inline void add_line(const Mesh& mesh, int32_t u, int32_t v) {
  const int32_t ends[2] = {u, v};
  for (int side = 0; side < 2; ++side) {
    const int32_t own = ends[side], other = ends[1 - side];
    if (mesh.is_line(own, other)) continue;
    int n = 0;
    while (n < LINES - 1 && mesh.line(own, n) >= 0) ++n;
    mesh.lines[LINES * own + n] = other;
  }
}

// Marks as lines the borders, the seams of panels and the edges creased (n, 2).
inline void find_lines(const Mesh& mesh, const int32_t* creased, int64_t count) {
  for (int32_t f = 0; f < mesh.face_count; ++f)
    for (int k = 0; k < 3; ++k) {
      const int32_t u = mesh.faces[3 * f + k], v = mesh.faces[3 * f + (k + 1) % 3];
      const Way own = mesh.corner[3 * f + (k + 1) % 3] - mesh.corner[3 * f + k];
      bool same = true;
      int beside = 0;
      for (int i = 0; i < mesh.valence[u] && i < MOST; ++i) {
        const int32_t g = mesh.around(u, i);
        if (g == f || !mesh.has(g, v)) continue;
        same &= !mesh.panels || square(mesh.place(g, v) - mesh.place(g, u) - own) <= SEAM * SEAM * square(own);
        ++beside;
      }
      if (beside != 1 || !same) add_line(mesh, u, v);
    }
  for (int64_t n = 0; n < count; ++n) add_line(mesh, creased[2 * n], creased[2 * n + 1]);
}

// Returns whether the edge of u and v can collapse without changing the topology: they have no common neighbours but
// those across their edge, and none of these would close a line.
inline bool is_disk(int32_t u, int32_t v, const Mesh& mesh) {
  int common = 0, shared = 0;
  for (int i = 0; i < mesh.valence[u]; ++i) {
    const int32_t f = mesh.around(u, i);
    if (mesh.has(f, v)) ++shared;
    for (int k = 0; k < 3; ++k) {
      const int32_t w = mesh.faces[3 * f + k];
      if (w == u || w == v) continue;
      if (mesh.has(f, v) && mesh.is_line(u, w)) return false;
      bool seen = false, is_common = false;
      for (int j = 0; j < i; ++j) seen |= mesh.has(mesh.around(u, j), w);
      for (int j = 0; j < mesh.valence[v]; ++j) is_common |= mesh.has(mesh.around(v, j), w);
      common += is_common && !seen;
    }
  }
  return shared > 0 && common == shared;
}

// Returns a way turned from one chart into another: an edge that goes as edge in the first chart goes as other, which
// has the same length, in the second.
inline Way turned(Way way, Way edge, Way other) {
  const double scale = __builtin_sqrt(square(edge) * square(other));
  const double c = (edge.x * other.x + edge.y * other.y) / scale, s = (edge.x * other.y - edge.y * other.x) / scale;
  return {c * way.x - s * way.y, s * way.x + c * way.y};
}

// Writes the way from u to v in the chart of each triangle around u: the way in the triangle that has both and lies on
// the same side of the lines. Returns whether every triangle has one.
inline bool write_ways(int32_t u, int32_t v, const Mesh& mesh, Way* way) {
  bool known[MOST] = {};
  const int count = mesh.valence[u];
  for (int i = 0; i < count; ++i) {
    const int32_t f = mesh.around(u, i);
    if (!mesh.has(f, v)) continue;
    way[i] = mesh.place(f, v) - mesh.place(f, u);
    known[i] = true;
  }
  for (bool changed = true; changed;) {
    changed = false;
    for (int i = 0; i < count; ++i)
      for (int k = 0; k < 3 && !known[i]; ++k) {
        const int32_t w = mesh.faces[3 * mesh.around(u, i) + k];
        if (w == u || mesh.is_line(u, w)) continue;
        for (int j = 0; j < count && !known[i]; ++j)
          if (const int32_t f = mesh.around(u, i), g = mesh.around(u, j); known[j] && mesh.has(g, w)) {
            way[i] = way[j], known[i] = changed = true;
            if (!mesh.panels)
              way[i] = turned(way[j], mesh.place(g, w) - mesh.place(g, u), mesh.place(f, w) - mesh.place(f, u));
          }
      }
  }
  bool all = true;
  for (int i = 0; i < count; ++i) all &= known[i];
  return all;
}

// Returns whether the line through u goes straight on to far, nearly as it comes from its other side.
inline bool is_straight(int32_t u, int32_t far, const Mesh& mesh, const Way* way) {
  bool straight = true;
  for (int i = 0; i < mesh.valence[u]; ++i) {
    const int32_t f = mesh.around(u, i);
    if (!mesh.has(f, far)) continue;
    const Way on = mesh.place(f, far) - mesh.place(f, u);
    const double along = on.x * way[i].x + on.y * way[i].y;
    straight &= along < -STRAIGHT * __builtin_sqrt(square(on) * square(way[i]));
  }
  return straight;
}

// Returns whether a triangle keeps its orientation, is not thin and has no side longer than longest [m] after one
// corner, which, has gone its way.
inline bool keeps_shape(const Way* corner, int which, Way way, double longest) {
  Way place[3] = {corner[0], corner[1], corner[2]};
  place[which] = {place[which].x + way.x, place[which].y + way.y};
  double total = 0, most = 0;
  for (int k = 0; k < 3; ++k) {
    const double side = square(place[(k + 1) % 3] - place[k]);
    total += side;
    if (side > most) most = side;
  }
  const double after = twice_area(place), size = after < 0 ? -after : after;
  return after * twice_area(corner) > 0 && 2 * ROOT_OF_3 * size >= THINNEST * total && most <= longest * longest;
}

// Returns whether u may be moved to v, and writes the ways from u to v.
inline bool may_go(int32_t u, int32_t v, const Mesh& mesh, Way* way, double longest) {
  if (mesh.valence[u] + mesh.valence[v] > MOST) return false;
  const bool on_line = mesh.line(u, 0) >= 0;
  if (on_line && (mesh.line(u, 2) >= 0 || mesh.line(u, 1) < 0 || !mesh.is_line(u, v))) return false;
  if (!is_disk(u, v, mesh) || !write_ways(u, v, mesh, way)) return false;
  if (on_line && !is_straight(u, mesh.far_side(u, v), mesh, way)) return false;
  for (int i = 0; i < mesh.valence[u]; ++i) {
    const int32_t f = mesh.around(u, i);
    if (mesh.has(f, v)) continue;
    if (!keeps_shape(mesh.corner + 3 * f, mesh.corner_of(f, u), way[i], longest)) return false;
  }
  return true;
}

inline void drop(const Mesh& mesh, int32_t v, int32_t f) {
  if (mesh.valence[v] > MOST) return;  // not all of its triangles are known, and it stays
  for (int i = 0; i < mesh.valence[v]; ++i)
    if (mesh.around(v, i) == f) {
      mesh.fan[MOST * v + i] = mesh.around(v, --mesh.valence[v]);
      return;
    }
}

// Moves u to v, by its way in each triangle, and clears alive (F,) for the triangles that vanish.
inline void go(int32_t u, int32_t v, const Mesh& mesh, const Way* way, uint8_t* alive) {
  for (int i = 0; i < mesh.valence[u]; ++i) {
    const int32_t f = mesh.around(u, i);
    if (mesh.has(f, v)) {
      alive[f] = 0;
      for (int k = 0; k < 3; ++k)
        if (mesh.faces[3 * f + k] != u) drop(mesh, mesh.faces[3 * f + k], f);
    } else {
      const int a = 3 * f + mesh.corner_of(f, u);
      mesh.faces[a] = v;
      mesh.corner[a] = {mesh.corner[a].x + way[i].x, mesh.corner[a].y + way[i].y};
      mesh.fan[MOST * v + mesh.valence[v]++] = f;
    }
  }
  mesh.valence[u] = 0;
  if (mesh.line(u, 0) < 0) return;
  const int32_t far = mesh.far_side(u, v);
  for (int n = 0; n < LINES; ++n) {
    if (mesh.line(v, n) == u) mesh.lines[LINES * v + n] = far;
    if (mesh.line(far, n) == u) mesh.lines[LINES * far + n] = v;
    mesh.lines[LINES * u + n] = -1;
  }
}

// A half-edge of the queue; it holds while its ends have these stamps.
struct HalfEdge {
  double length;
  int32_t from, to, from_stamp, to_stamp;
};
INLINE bool comes_before(const HalfEdge& a, const HalfEdge& b) {
  return a.length != b.length ? a.length < b.length : a.from != b.from ? a.from < b.from : a.to < b.to;
}

// The queue of half-edges, a binary heap with the first one on top, and the stamps (V,) of the vertices.
struct Waiting {
  HalfEdge* heap;
  int64_t count, room;
  int32_t* stamp;

  bool holds(const HalfEdge& e, const Mesh& mesh) const {
    return mesh.valence[e.from] && mesh.valence[e.to] && stamp[e.from] == e.from_stamp && stamp[e.to] == e.to_stamp;
  }
  void sink(int64_t place) {
    const HalfEdge own = heap[place];
    for (int64_t below; (below = 2 * place + 1) < count; place = below) {
      if (below + 1 < count && comes_before(heap[below + 1], heap[below])) ++below;
      if (!comes_before(heap[below], own)) break;
      heap[place] = heap[below];
    }
    heap[place] = own;
  }
  void push(const HalfEdge& own) {
    int64_t place = count++;
    for (; place > 0 && comes_before(own, heap[(place - 1) / 2]); place = (place - 1) / 2)
      heap[place] = heap[(place - 1) / 2];
    heap[place] = own;
  }
  HalfEdge pop() {
    const HalfEdge top = heap[0];
    heap[0] = heap[--count];
    if (count) sink(0);
    return top;
  }
  // Removes half-edges that do not hold any more; at most two for each side of a triangle are left.
  void tidy(const Mesh& mesh) {
    int64_t left = 0;
    for (int64_t n = 0; n < count; ++n)
      if (holds(heap[n], mesh)) heap[left++] = heap[n];
    count = left;
    for (int64_t n = count / 2 - 1; n >= 0; --n) sink(n);
  }
};

inline void push_from(int32_t u, const Mesh& mesh, Waiting& waiting) {
  if (mesh.valence[u] > MOST) return;
  if (waiting.count + 2 * MOST > waiting.room) waiting.tidy(mesh);
  for (int i = 0; i < mesh.valence[u]; ++i) {
    const int32_t f = mesh.around(u, i);
    for (int k = 0; k < 3; ++k) {
      const int32_t v = mesh.faces[3 * f + k];
      if (v == u) continue;
      const double length = __builtin_sqrt(square(mesh.corner[3 * f + k] - mesh.place(f, u)));
      waiting.push({length, u, v, waiting.stamp[u], waiting.stamp[v]});
    }
  }
}

// Collapses edges of a mesh with faces (F, 3) until target vertices are left or none may go, and writes which faces are
// left, alive (F,). No new side is longer than longest [m]. Faces, their corners in their charts [m] (F, 3, 2), and
// lines (V, LINES), -1 on entry, are changed in place. The edges creased (n, 2) are lines too.
inline void coarsened(Mesh mesh, const int32_t* creased, int64_t creased_count, int64_t target, double longest,
                      uint8_t* alive, Scratch& scratch) {
  const int64_t vertices = mesh.vertex_count, room = 8 * mesh.face_count + 2 * MOST;
  mesh.fan = scratch.take<int32_t>(MOST * vertices);
  mesh.valence = scratch.take<int32_t>(vertices);
  int32_t* pushed = scratch.take<int32_t>(vertices);
  Waiting waiting = {scratch.take<HalfEdge>(room), 0, room, scratch.take<int32_t>(vertices)};
  if (scratch.overflowed) return;
  find_fans(mesh);
  find_lines(mesh, creased, creased_count);
  int64_t left = 0;
  for (int32_t u = 0; u < vertices; ++u) waiting.stamp[u] = pushed[u] = 0, left += mesh.valence[u] > 0;
  for (int64_t f = 0; f < mesh.face_count; ++f) alive[f] = 1;
  for (int32_t u = 0; u < vertices; ++u) push_from(u, mesh, waiting);
  Way way[MOST];
  for (int32_t number = 1; waiting.count && left > target;) {
    const HalfEdge first = waiting.pop();
    if (!waiting.holds(first, mesh) || !may_go(first.from, first.to, mesh, way, longest)) continue;
    const int32_t v = first.to;
    go(first.from, v, mesh, way, alive);
    --left;
    for (int i = 0; i < 3 * mesh.valence[v]; ++i) waiting.stamp[mesh.faces[3 * mesh.around(v, i / 3) + i % 3]] = number;
    for (int i = 0; i < 3 * mesh.valence[v]; ++i) {
      const int32_t w = mesh.faces[3 * mesh.around(v, i / 3) + i % 3];
      if (pushed[w] != number) push_from(w, mesh, waiting);
      pushed[w] = number;
    }
    ++number;
  }
}

}  // namespace collapse
