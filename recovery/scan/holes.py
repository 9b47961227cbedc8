"""Tells a scan's holes from its openings and closes them; what closes a hole is marked and has no weight in a fit.

A scanner leaves holes inside the cloth and bites in its border. Neither is an opening: nothing goes through it. A hole
lies in the cloth, so the cloth at its rim looks the way that the hole does; at the rim of a cuff the cloth looks
sideways. Where a body is known its bones decide. A bite is found in the border unrolled into the plane: there a
straight hem is a straight line, however it is folded, and a bite is a pocket with a narrow mouth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import spsolve

from drape.garment.contours import Loop, borders, plainly_opening
from drape.garment.files.mesh import GarmentMesh
from drape.geometry import mesh_graphs, meshes
from recovery import progress

NOISE = 0.2  # a mesh of more ``roughness`` than this is noisy; scans without noise have up to 0.17
SHRINK, GROW, SMOOTHINGS = 0.5, -0.53, 8  # of Taubin's smoothing, which keeps what is larger than a few edges
CLOSED = "closed hole"  # the material of faces that close a hole
LARGEST_BEND = 0.25  # most that a fair surface rises above the flattest one, over a rim's radius
MOUTH_SHARE, POCKET_SHARE = 0.3, 0.45  # largest mouth and depth line of a bite, over a border's length
# A pocket of a border is a bite if its line is longer than its mouth by the share DEEPER and ROUNDER times the share by
# which the arc of a round opening would be.
DEEPER, ROUNDER = 0.1, 1.5
NARROWER = 0.2  # share of a mouth's length that counts against a bite, so that it ends where the mouth does
LIP_VERTICES, LIP_TURN_RAD = 2, 0.4  # a border that turns by this, over as many vertices on both sides, is a lip
CALMINGS = 16  # most of Taubin's smoothings of a border that is searched for bites
LARGEST_LOOP = 4000  # vertices of a border that are searched for bites


class Closing(NamedTuple):
    """A ``mesh`` whose holes and bites are closed, the numbers of ``holes`` and ``bites`` that were, and the length
    ``largest`` of the longest rim among them, in the mesh's unit."""

    mesh: GarmentMesh
    holes: int
    bites: int
    largest: float

    def words(self, face_count: int) -> list[str]:
        """Returns a list with a sentence on what was closed, or an empty list if nothing was. Faces of ``mesh`` from
        ``face_count`` on are those that close something."""
        if not self.holes + self.bites:
            return []
        area = meshes.face_areas(self.mesh.vertices, self.mesh.faces)
        root = float(np.sqrt(area.sum()))
        return [
            f"closed {self.holes} holes and {self.bites} bites in borders, the largest "
            f"{100 * self.largest / root:.0f} % of the root of the area round: "
            f"{100.0 * float(area[face_count:].sum() / area.sum()):.1f} % of the cloth is not known and has no weight"
        ]


def known_faces(mesh: GarmentMesh) -> np.ndarray:
    """Returns which faces were in the file, bool (F,): False for those that close a hole."""
    if CLOSED not in mesh.material_names:
        return np.ones(len(mesh.faces), dtype=bool)
    return mesh.face_material != mesh.material_names.index(CLOSED)


def close_holes(
    mesh: GarmentMesh, is_hole: Callable[[Loop], bool], is_opening: Callable[[Loop], bool] = plainly_opening
) -> Closing:
    """Returns ``mesh`` with faces that close its holes and bites, and their counts.

    Holes are the borders that ``is_hole``; bites are looked for in the other ones that ``is_opening``. The faces of
    ``mesh`` agree in orientation.
    """
    loops = borders(mesh)
    holes = [border for border in loops if is_hole(border)]
    rims, largest = [border.loop for border in holes], max((border.length for border in holes), default=0.0)
    bites = [bite for border in loops if is_opening(border) and not is_hole(border) for bite in bites_of(mesh, border)]
    patched = mesh
    for number, rim in enumerate(rims):
        progress.tick(f"hole {number + 1} of {len(rims)} closed")
        patched = _patched(patched, rim, None)
    for rim in bites:
        way = mesh.vertices[rim[1:]] - mesh.vertices[rim[:-1]]
        largest = max(largest, float(np.linalg.norm(way, axis=1).sum()))
        patched = _patched(patched, rim, _mouth(mesh.vertices[rim]))
    if patched is not mesh:
        patched = fair_patches(patched)
    return Closing(patched, len(rims), len(bites), largest)


# --- bites -----------------------------------------------------------------------------------------------------------


def unroll_border(mesh: GarmentMesh, loop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the border ``loop`` (n,) unrolled into the plane, twice round: points (2 n + 1, 2), and the lengths (2 n
    + 1,) along the line to each, in the mesh's unit.

    The line turns as the border turns inside the cloth, which lies on its left. It is smoothed a little.
    """
    points = mesh.vertices[loop]
    length = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    turn = np.pi - _cloth_angles(mesh)[loop]
    twice_turn, twice = np.tile(turn, 2), np.tile(length, 2)
    heading = np.cumsum(np.concatenate([[0.0], twice_turn[1:]]))
    way = twice[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    flat = np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)])
    flat[1:-1] = 0.25 * flat[:-2] + 0.5 * flat[1:-1] + 0.25 * flat[2:]  # a jagged border is not a longer one
    return flat, np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))])


def _cloth_angles(mesh: GarmentMesh) -> np.ndarray:
    """The angle [rad] (V,) of the cloth about every vertex: 2 pi inside flat cloth, pi at a straight border."""
    corners = mesh.vertices[mesh.faces]
    a, b = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    angle = np.arctan2(np.linalg.norm(np.cross(a, b), axis=2), (a * b).sum(axis=2))
    return np.bincount(mesh.faces.reshape(-1), angle.reshape(-1), len(mesh.vertices))


def bites_of(mesh: GarmentMesh, border: Loop) -> list[np.ndarray]:
    """Returns the bites of a ``border``, pockets with a narrow mouth: the vertices (k,) of each, along the border from
    one end of the mouth to the other.

    None overlap. There are none in a border of fewer than 8 vertices or more than ``LARGEST_LOOP``.
    """
    count = len(border.loop)
    if not 8 <= count <= LARGEST_LOOP:
        return []
    vertices = mesh.vertices.copy()
    vertices[border.loop] = points = _calmed_line(vertices[border.loop])
    flat, run = unroll_border(replace(mesh, vertices=vertices), border.loop)
    candidates = []
    lip = _lips(flat, count)
    for start in np.flatnonzero(lip).tolist():
        progress.tick("bites of a border are looked for")
        last = int(np.searchsorted(run, run[start] + POCKET_SHARE * border.length))
        ends = np.arange(start + 2, min(last, start + count))
        if not len(ends):
            continue
        way = flat[ends] - flat[start]
        # Noise bends the unrolled line; the straight way in space is never longer than that in the cloth.
        straight = np.linalg.norm(points[ends % count] - points[start], axis=1)
        mouth, line = np.maximum(np.linalg.norm(way, axis=1), straight), run[ends] - run[start]
        share = mouth / border.length
        half = np.arcsin(np.minimum(np.pi * share, 1.0))
        round_excess = half / np.maximum(np.sin(half), 1e-9) - 1.0
        good = (share < MOUTH_SHARE) & (line > (1.0 + DEEPER + ROUNDER * round_excess) * mouth) & lip[ends % count]
        if good.any():
            gain = np.where(good, line - (1.0 + NARROWER) * mouth, -np.inf)
            candidates.append((float(gain.max()), start, int(ends[gain.argmax()])))
    return _disjoint(candidates, flat, border)


def _calmed_line(points: np.ndarray) -> np.ndarray:
    """The closed line ``points`` (n, 3) smoothed as by Taubin until its corners are no noise: it has pockets, too."""

    def bend(line: np.ndarray) -> np.ndarray:
        return 0.5 * (np.roll(line, 1, axis=0) + np.roll(line, -1, axis=0)) - line

    for _ in range(CALMINGS):
        step = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1).mean()
        if np.median(np.linalg.norm(bend(points), axis=1)) <= 0.5 * NOISE * step:
            break
        for size in (SHRINK, GROW):
            points = points + size * bend(points)
    return points


def _lips(flat: np.ndarray, count: int) -> np.ndarray:
    """Where a border turns into the cloth (n,), or near: the lips of a mouth. A neckline, however deep, has none."""
    at = np.arange(count) + LIP_VERTICES  # the line goes twice round
    before, after = flat[at] - flat[at - LIP_VERTICES], flat[at + LIP_VERTICES] - flat[at]
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1))
    lip = np.roll(turn > LIP_TURN_RAD, LIP_VERTICES)
    return np.any([np.roll(lip, step) for step in range(-LIP_VERTICES, LIP_VERTICES + 1)], axis=0)


def _disjoint(candidates: list[tuple[float, int, int]], flat: np.ndarray, border: Loop) -> list[np.ndarray]:
    """The bites (k,) among ``candidates`` (length saved, start, end), the one that saves most first.

    All lie on the side of the cloth, and none over another.
    """
    used = np.zeros(len(border.loop), dtype=bool)
    rings = []
    for _, start, end in sorted(candidates, reverse=True):
        inner = np.arange(start, end) % len(border.loop)
        if used[inner].any():
            continue
        way, off = flat[end] - flat[start], flat[start + 1 : end] - flat[start]
        left = way[0] * off[:, 1] - way[1] * off[:, 0]
        if (left < -1e-3 * border.length * np.linalg.norm(way)).any():
            continue  # the border goes out of the mouth: a tongue, no bite
        used[inner] = True
        rings.append(border.loop[np.arange(start, end + 1) % len(border.loop)])
    return rings


def _mouth(rim: np.ndarray) -> np.ndarray:
    """Points (m, 3) on the straight mouth from the last point of ``rim`` to the first, as dense as the rim."""
    step = float(np.median(np.linalg.norm(np.diff(rim, axis=0), axis=1)))
    # At least one point: an edge between the ends may be there already.
    count = max(2, round(float(np.linalg.norm(rim[0] - rim[-1])) / max(step, 1e-300)))
    share = np.arange(1, count)[:, None] / count
    return (1.0 - share) * rim[-1] + share * rim[0]


# --- patches ---------------------------------------------------------------------------------------------------------


def _patched(mesh: GarmentMesh, rim: np.ndarray, mouth: np.ndarray | None) -> GarmentMesh:
    """``mesh`` with a patch on the hole with the border ``rim`` (n,), or on a bite whose ``mouth`` (m, 3) stays border.

    The patch is made of rings, each half as dense as the one outside it, about the middle of the rim.
    """
    count = len(mesh.vertices)
    new = np.zeros((0, 3)) if mouth is None else mouth
    ring = np.concatenate([rim, count + np.arange(len(new))])
    points = np.concatenate([mesh.vertices[ring[: len(rim)]], new])
    vertices, faces = [mesh.vertices, new], []
    following = count + len(new)
    middle = points.mean(axis=0)
    while len(ring) > 8:
        inner_points = points[::2] + 0.5 * (middle - points[::2])
        inner = following + np.arange(len(inner_points))
        following += len(inner)
        vertices.append(inner_points)
        faces.append(_ring_faces(ring, inner))
        ring, points = inner, inner_points
    vertices.append(middle[None])
    faces.append(np.stack([np.roll(ring, -1), ring, np.full(len(ring), following)], axis=1))
    return _with_faces(mesh, np.concatenate(vertices), np.concatenate(faces))


def _ring_faces(outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
    """Faces between a ring and one with every second vertex of it; the border runs along the outer one."""
    own = inner[np.arange(len(outer)) // 2]
    following, own_following = np.roll(outer, -1), np.roll(own, -1)
    rows = [np.stack([following, outer, own], axis=1)]
    step = own != own_following
    rows.append(np.stack([following[step], own[step], own_following[step]], axis=1))
    return np.concatenate(rows)


def _with_faces(mesh: GarmentMesh, vertices: np.ndarray, faces: np.ndarray) -> GarmentMesh:
    names = mesh.material_names if CLOSED in mesh.material_names else (*mesh.material_names, CLOSED)
    material = np.concatenate([mesh.face_material, np.full(len(faces), names.index(CLOSED))])
    return replace(
        mesh,
        vertices=vertices,
        faces=np.concatenate([mesh.faces, faces]),
        uv=np.zeros((0, 2)),
        uv_faces=np.zeros((0, 3), dtype=np.int64),
        material_names=names,
        face_material=material,
    )


def fair_patches(mesh: GarmentMesh) -> GarmentMesh:
    """Returns ``mesh`` whose patches, the faces that close holes, are as smooth as the cloth about them lets them be.

    Vertices move to the least bending (squared umbrella Laplacian); where noise makes that bulge, to the least area.
    Borders stay, and with them the mouths of bites.
    """
    known = known_faces(mesh)
    free = np.zeros(len(mesh.vertices), dtype=bool)
    free[mesh.faces[~known]] = True
    free[mesh.faces[known]] = False
    free[meshes.boundary_vertices(mesh.faces)] = False
    if not free.any():
        return mesh
    laplacian = scipy.sparse.csc_matrix(mesh_graphs.umbrella_laplacian(mesh.faces, len(mesh.vertices)))
    flattest = _solved(laplacian, mesh.vertices, free)
    fairest = _solved(scipy.sparse.csc_matrix(laplacian.T @ laplacian), mesh.vertices, free)
    patch = mesh_graphs.connected_components(mesh.faces[~known], len(mesh.vertices))
    rise = np.linalg.norm(fairest - flattest, axis=1)
    vertices = flattest.copy()
    for number in np.unique(patch[free]):
        mine = patch == number
        radius = float(np.linalg.norm(mesh.vertices[mine] - mesh.vertices[mine].mean(axis=0), axis=1).max())
        if rise[mine].max() <= LARGEST_BEND * radius:
            vertices[mine & free] = fairest[mine & free]
    return replace(mesh, vertices=vertices)


def _solved(matrix: scipy.sparse.csc_matrix, vertices: np.ndarray, free: np.ndarray) -> np.ndarray:
    """``vertices`` with the ``free`` ones where ``matrix`` times them is zero in their rows."""
    rows = matrix[free]
    right = -rows[:, ~free] @ vertices[~free]
    moved = vertices.copy()
    moved[free] = spsolve(scipy.sparse.csc_matrix(rows[:, free]), right).reshape(-1, 3)
    return moved
