"""A coarse cloth on some of a garment's vertices, at rest as the fine one is.

Half-edges collapse, the shortest first: a vertex u goes to its neighbour v, and the triangles around u have v for u
(Hoppe et al. 1993, "Mesh optimization", SIGGRAPH). Triangles at rest are laid flat along warp and weft, so that a
corner is moved in the triangle's own chart by the way from u to v there. Neither lengths nor grain are lost. Seams,
creases and borders are lines: along a seam two charts differ, along a border there is one triangle. Vertices on a line
go along it only, and where lines meet or end they stay.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.cloth.rest_state import RestState
from drape.geometry import meshes
from drape.geometry.closest import nearest_vertices
from drape.kernels.compiled import kernel, part

EDGE_M = 0.026
SEAM = 0.05  # share of its length by which an edge differs in the two charts beside a seam
CREASE_RAD = 0.2  # of a hinge at rest
STRAIGHT = 0.8  # cosine of the angle up to which a line may turn in a vertex that goes
MOST = 24  # triangles around a vertex
LINES = 4  # edges of a vertex on lines that are remembered
LONGEST = 1.7  # times the mean edge that is asked for
THINNEST = 0.3  # 4 sqrt(3) area / sum of squared sides: 1 in a triangle of equal sides


@dataclass(frozen=True, eq=False)
class CoarseMesh:
    """``vertex`` (n,): the fine vertices that are kept; ``faces`` (f, 3) of them by their number in ``vertex``; their
    ``rest``."""

    vertex: np.ndarray
    faces: np.ndarray
    rest: RestState


def coarse_mesh(rest: RestState, vertices: np.ndarray, faces: np.ndarray, edge_m: float = EDGE_M) -> CoarseMesh:
    """A mesh on some of ``vertices`` [m] (V, 3) for the cloth of ``faces`` (F, 3) with the state ``rest``.

    Its edges are ``edge_m`` [m] long in the mean, if seams and creases leave room for that, and it has a third of the
    vertices at most.
    """
    count, hinges = len(vertices), meshes.hinges(faces)
    target = min(rest.face_area.sum() / (0.5 * np.sqrt(3.0) * edge_m**2), count / 3.0)  # two triangles a vertex
    edge_m = np.sqrt(rest.face_area.sum() / (0.5 * np.sqrt(3.0) * target))
    corner = np.zeros((len(faces), 3, 2))
    corner[:, 1:] = rest.edges
    creased = hinges[np.abs(rest.hinge_angle) > CREASE_RAD, :2]
    left, lines = faces.astype(np.int32), np.full((count, LINES), -1, np.int32)
    alive = _collapse(left, corner, np.ascontiguousarray(creased, np.int32), lines, int(target), edge_m)
    left, corner = left[alive], corner[alive]
    vertex = np.unique(left)
    small = np.searchsorted(vertex, left)
    edges = corner[:, 1:] - corner[:, :1]
    found = meshes.hinges(small)
    ends = vertex[found[:, :2]]
    _, near = nearest_vertices(vertices[ends].mean(axis=1), vertices[hinges[:, :2]].mean(axis=1))
    on_line = (lines[ends[:, 0]] == ends[:, 1:]).any(axis=1)
    angle = np.where(on_line, rest.hinge_angle[near], 0.0)
    return CoarseMesh(vertex, small, RestState(edges, angle, rest.stiffening[near]))


class Fans(NamedTuple):
    """A mesh that collapses: ``faces`` (F, 3), the ``corner`` (F, 3, 2) [m] of each in its chart, the ``fan`` (V,
    ``MOST``) of triangles around each vertex and their number, its ``valence`` (V,), and its neighbours on ``lines``
    (V, ``LINES``), -1 where there are no more."""

    faces: np.ndarray
    corner: np.ndarray
    fan: np.ndarray
    valence: np.ndarray
    lines: np.ndarray


@kernel
def _collapse(faces, corner, creased, lines, target, edge_m):
    """Collapses until ``target`` vertices are left or none will go, and returns which ``faces`` are (F,).

    ``faces`` and the ``corner`` (F, 3, 2) of each in its chart [m] are written to; so are ``lines`` (V, ``LINES``), the
    neighbours of each vertex along lines, -1 where there are no more. The pairs ``creased`` (n, 2) are on lines too.
    """
    count, alive = len(lines), np.ones(len(faces), np.bool_)
    fan, valence = np.empty((count, MOST), np.int32), np.zeros(count, np.int32)
    for f in range(len(faces)):
        for k in range(3):
            v = faces[f, k]
            if valence[v] < MOST:
                fan[v, valence[v]] = f
            valence[v] += 1
    mesh = Fans(faces, corner, fan, valence, lines)
    _find_lines(mesh, creased)
    stamp, heap = np.zeros(count, np.int64), [(0.0, 0, 0, 0, 0)]
    heap.clear()
    left = 0
    for u in range(count):
        left += valence[u] > 0
        _push(u, mesh, stamp, heap)
    way, place = np.empty((MOST, 2)), np.empty((3, 2))
    while len(heap) and left > target:
        _, u, v, own, other = heapq.heappop(heap)
        if valence[u] == 0 or valence[v] == 0 or stamp[u] != own or stamp[v] != other:
            continue
        if not _may_go(u, v, mesh, way, place, LONGEST * edge_m):
            continue
        _go(u, v, mesh, way, alive)
        left -= 1
        for i in range(valence[v]):
            for k in range(3):
                stamp[faces[fan[v, i], k]] += 1
        for i in range(valence[v]):
            for k in range(3):
                _push(faces[fan[v, i], k], mesh, stamp, heap)
    return alive


@part
def _corner_of(faces, f, v):
    return 0 if faces[f, 0] == v else 1 if faces[f, 1] == v else 2


@part
def _has(faces, f, v):
    return faces[f, 0] == v or faces[f, 1] == v or faces[f, 2] == v


@part
def _is_line(lines, u, v):
    found = False
    for n in range(LINES):
        found |= lines[u, n] == v
    return found


@kernel
def _find_lines(mesh, creased):
    faces, corner, fan, valence, lines = mesh
    for f in range(len(faces)):
        for k in range(3):
            u, v = faces[f, k], faces[f, (k + 1) % 3]
            du, dv = corner[f, (k + 1) % 3, 0] - corner[f, k, 0], corner[f, (k + 1) % 3, 1] - corner[f, k, 1]
            same, beside = True, 0
            for i in range(min(valence[u], MOST)):
                g = fan[u, i]
                if g != f and _has(faces, g, v):
                    a, b = _corner_of(faces, g, u), _corner_of(faces, g, v)
                    eu, ev = corner[g, b, 0] - corner[g, a, 0] - du, corner[g, b, 1] - corner[g, a, 1] - dv
                    same &= eu * eu + ev * ev <= SEAM * SEAM * (du * du + dv * dv)
                    beside += 1
            if beside != 1 or not same:
                _add_line(lines, u, v)
    for n in range(len(creased)):
        _add_line(lines, creased[n, 0], creased[n, 1])


@kernel
def _add_line(lines, u, v):
    """Remembers the edge from ``u`` to ``v`` for both ends. Of more than ``LINES`` the last one is written over: such a
    vertex stays anyway."""
    for a, b in ((u, v), (v, u)):
        if not _is_line(lines, a, b):
            n = 0
            while n < LINES - 1 and lines[a, n] >= 0:
                n += 1
            lines[a, n] = b


@kernel
def _push(u, mesh, stamp, heap):
    """Puts the half-edges from ``u`` on the ``heap``, by their length."""
    faces, corner, fan, valence, _lines = mesh
    if valence[u] > MOST:
        return
    for i in range(valence[u]):
        f = fan[u, i]
        a = _corner_of(faces, f, u)
        for k in range(3):
            if k == a:
                continue
            x, y = corner[f, k, 0] - corner[f, a, 0], corner[f, k, 1] - corner[f, a, 1]
            v = faces[f, k]
            heapq.heappush(heap, (np.sqrt(x * x + y * y), np.int64(u), np.int64(v), stamp[u], stamp[v]))


@kernel
def _may_go(u, v, mesh, way, place, longest):
    """Whether ``u`` may go to ``v``; writes the ``way`` [m] from u to v in the charts of the triangles around u."""
    faces, corner, fan, valence, lines = mesh
    if valence[u] > MOST or valence[u] + valence[v] > MOST:
        return False
    if lines[u, 0] >= 0 and (lines[u, 2] >= 0 or lines[u, 1] < 0 or not _is_line(lines, u, v)):
        return False
    if not _is_disk(u, v, mesh):
        return False
    if not _write_ways(u, v, mesh, way):
        return False
    if lines[u, 0] >= 0 and not _is_straight(u, lines[u, 1] if lines[u, 0] == v else lines[u, 0], mesh, way):
        return False
    for i in range(valence[u]):
        f = fan[u, i]
        if _has(faces, f, v):
            continue
        before = _twice_area(corner[f])
        a = _corner_of(faces, f, u)
        place[:] = corner[f]
        place[a] += way[i]
        total, most = 0.0, 0.0
        for k in range(3):
            x, y = place[(k + 1) % 3, 0] - place[k, 0], place[(k + 1) % 3, 1] - place[k, 1]
            total += x * x + y * y
            most = max(most, x * x + y * y)
        after = _twice_area(place)
        if after * before <= 0.0 or 2.0 * np.sqrt(3.0) * abs(after) < THINNEST * total or most > longest * longest:
            return False
    return True


@part
def _twice_area(p):
    return (p[1, 0] - p[0, 0]) * (p[2, 1] - p[0, 1]) - (p[1, 1] - p[0, 1]) * (p[2, 0] - p[0, 0])


@kernel
def _is_disk(u, v, mesh):
    """Whether u and v have no common neighbours but across their edge, and none of these would close a line."""
    faces, _corner, fan, valence, lines = mesh
    common, shared = 0, 0
    for i in range(valence[u]):
        f = fan[u, i]
        if _has(faces, f, v):
            shared += 1
            for k in range(3):
                w = faces[f, k]
                if w not in (u, v) and _is_line(lines, u, w):
                    return False
    for i in range(valence[u]):
        for k in range(3):
            w = faces[fan[u, i], k]
            if w in (u, v):
                continue
            seen = False
            for j in range(i):
                seen |= _has(faces, fan[u, j], w)
            if seen:
                continue
            for j in range(valence[v]):
                if _has(faces, fan[v, j], w):
                    common += 1
                    break
    return shared > 0 and common == shared


@kernel
def _write_ways(u, v, mesh, way):
    """Writes the ``way`` from u to v in the chart of each triangle around u: that of the triangle which has both and
    lies on the same side of the lines. Whether all have one."""
    faces, corner, fan, valence, lines = mesh
    known = np.zeros(MOST, np.bool_)
    for i in range(valence[u]):
        f = fan[u, i]
        if _has(faces, f, v):
            way[i] = corner[f, _corner_of(faces, f, v)] - corner[f, _corner_of(faces, f, u)]
            known[i] = True
    changed = True
    while changed:
        changed = False
        for i in range(valence[u]):
            if known[i]:
                continue
            for k in range(3):
                w = faces[fan[u, i], k]
                if w == u or _is_line(lines, u, w):
                    continue
                for j in range(valence[u]):
                    if known[j] and not known[i] and _has(faces, fan[u, j], w):
                        way[i] = way[j]
                        known[i] = changed = True
    all_known = True
    for i in range(valence[u]):
        all_known &= known[i]
    return all_known


@kernel
def _is_straight(u, far, mesh, way):
    """Whether the line through ``u`` goes on to ``far`` nearly as its ``way`` to the other side comes."""
    faces, corner, fan, valence, _lines = mesh
    straight = True
    for i in range(valence[u]):
        f = fan[u, i]
        if _has(faces, f, far):
            x, y = corner[f, _corner_of(faces, f, far)] - corner[f, _corner_of(faces, f, u)]
            along = x * way[i, 0] + y * way[i, 1]
            straight &= along < -STRAIGHT * np.sqrt((x * x + y * y) * (way[i, 0] ** 2 + way[i, 1] ** 2))
    return straight


@kernel
def _go(u, v, mesh, way, alive):
    faces, corner, fan, valence, lines = mesh
    for i in range(valence[u]):
        f = fan[u, i]
        if _has(faces, f, v):
            alive[f] = False
            for k in range(3):
                if faces[f, k] != u:
                    _drop(fan, valence, faces[f, k], f)
        else:
            a = _corner_of(faces, f, u)
            faces[f, a] = v
            corner[f, a] += way[i]
            fan[v, valence[v]] = f
            valence[v] += 1
    valence[u] = 0
    if lines[u, 0] >= 0:
        far = lines[u, 1] if lines[u, 0] == v else lines[u, 0]
        for n in range(LINES):
            if lines[v, n] == u:
                lines[v, n] = far
            if lines[far, n] == u:
                lines[far, n] = v
        lines[u] = -1


@part
def _drop(fan, valence, v, f):
    for i in range(valence[v]):
        if fan[v, i] == f:
            valence[v] -= 1
            fan[v, i] = fan[v, valence[v]]
            break
