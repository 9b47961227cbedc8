"""Pushes a rest garment out of the body until every vertex is clear of it, and keeps its detail.

A template that cuts into the body spoils everything after it (measured:
28 % colliding vertices under motion before the push, 1.2 % after), so the end is a guarantee
and not a penalty: ``clear_body`` returns only what it has measured to be clear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from scipy.spatial import KDTree

from drape.errors import MeshError
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import ClosedMesh
from drape.geometry.symmetric import ShiftedSystems, symmetric_factor

CLEARANCE_M = 0.006
MARGIN_M = 2e-4  # pushes aim this far beyond the clearance, so that the last smoothing does not fall short of it
LAYER_SOFTNESS_M = (
    0.003  # cloth nearer than about this to the clearance is lifted in proportion: layers keep their order
)
LAYER_REACH_M = 0.010  # cloth this near lies on or under the same cloth and moves with it
FAR_M = 2.0 * CLEARANCE_M  # cloth beyond needs no push, wherever it is exactly
ROUNDS = 40
STIFFNESS_M2 = 0.03**2  # smoothing length of the first push, squared; halves from round to round
REST_SHARE = 0.02  # how much a vertex that is clear resists being taken along
FEW_HEAVY = 8  # up to so many vertices that are short, columns of the inverse take less time than a factor
THROUGH_ROUNDS, THROUGH_M, THROUGH_STEPS = 20, 0.06, 16  # rounds in which cloth leaves limbs through it; how far
FEW_SHARE, FEW_DEPTH_M = 0.03, 0.004  # this share of the cloth may end as deep in the skin as this
ALONG = 0.85  # above this cosine the ways out of the body and along the cloth's normal are the same
FACING = 4.0  # cloth that looks into a limb and would go so many times its depth through it came the other way
LOOKS_OUT = 0.75  # a piece of which less looks outward has inner walls, which look inward
GIVE_UP_DEPTH_M = 0.06  # no cloth was modelled so deep in its avatar: it belongs to another one


@dataclass(frozen=True, eq=False)
class Cleared:
    """A garment's vertices after the push out of the body: ``vertices`` [m] (N, 3); ``clearance_m``, the smallest
    distance to the body; ``push_m``, the largest movement of a vertex; ``rounds``, the number of pushes."""

    vertices: np.ndarray
    clearance_m: float
    push_m: float
    rounds: int


class _Skin:
    """A closed body, asked for the signed distance of points that move: those that stayed clear of it are not asked."""

    def __init__(self, points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.body, self.faces = ClosedMesh(vertices, faces), faces
        self.normals = meshes.vertex_normals(vertices, faces)
        self.points, count = points, len(points)
        self.signed, self.direction, self.nearest = np.zeros(count), np.zeros((count, 3)), np.zeros(count, dtype=int)
        self._ask(np.arange(count))

    def move(self, points: np.ndarray) -> None:
        """Takes the points to their new places ``points`` [m] (N, 3). A distance beyond ``FAR_M`` falls by no more than
        its point moves: ``signed`` may be less than it is there."""
        bound = self.signed - np.linalg.norm(points - self.points, axis=1)
        self.points, self.signed = points, np.maximum(bound, FAR_M)
        self._ask(np.flatnonzero(bound < FAR_M))

    def _ask(self, rows: np.ndarray) -> None:
        if not len(rows):
            return
        points = self.points[rows]
        signed, near = self.body.signed_closest(points)
        outward = np.einsum("nk,nkc->nc", near.barycentric, self.normals[self.faces[near.face]])
        gap = points - near.point
        length = np.linalg.norm(gap, axis=1)
        # On the surface itself the gap has no direction, the body's normal has.
        trusted = (length > 1e-4)[:, None]
        away = np.where(trusted, np.sign(signed)[:, None] * gap / np.maximum(length, 1e-12)[:, None], outward)
        self.direction[rows] = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        self.signed[rows], self.nearest[rows] = signed, near.face


class _Smoothing:
    """Solves (W + s L) x = W b for the laplacian L [1/m^2] (N, N) and weights W that are ``REST_SHARE`` but where b is.

    Where few weights differ, x are columns of the inverse of R = ``REST_SHARE`` + s L, whose factor serves every round
    of one s (Woodbury): with E those columns of the identity, x = R^-1 E y and (1 + (1 - ``REST_SHARE``) E^T R^-1 E) y
    = E^T b.
    """

    def __init__(self, laplacian: scipy.sparse.csr_matrix) -> None:
        self._laplacian, self._of, self._factor = laplacian, -1.0, None
        self._systems = ShiftedSystems(laplacian)

    def solve(self, weight: np.ndarray, wanted: np.ndarray, stiffness: float) -> np.ndarray:
        """x (N, 3) for ``weight`` (N,), b = ``wanted`` (N, 3) and s = ``stiffness`` [m^2]."""
        heavy = np.flatnonzero(weight == 1.0)
        if len(heavy) > FEW_HEAVY or np.delete(wanted, heavy, axis=0).any():
            return self._systems.solve(weight, stiffness, weight[:, None] * wanted)
        if self._factor is None or self._of != stiffness:
            rest = REST_SHARE * scipy.sparse.identity(len(weight)) + stiffness * self._laplacian
            self._of, self._factor = stiffness, symmetric_factor(rest)
        ones = np.zeros((len(weight), len(heavy)))
        ones[heavy, np.arange(len(heavy))] = 1.0
        columns = self._factor.solve(ones)
        return columns @ np.linalg.solve(np.eye(len(heavy)) + (1.0 - REST_SHARE) * columns[heavy], wanted[heavy])


def clear_body(
    vertices: np.ndarray,
    faces: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    *,
    rounds: int = ROUNDS,
    least_m: float = CLEARANCE_M,
    give_up_m: float = GIVE_UP_DEPTH_M,
    through: bool = False,
) -> Cleared:
    """Returns ``vertices`` [m] (N, 3) pushed out of the closed body until each is at least ``CLEARANCE_M`` outside, in
    the same frame, with their least distance from it and their largest movement.

    The first push maps distances through a softened maximum, which is monotone, so that a lining stays under its cloth.
    Later pushes lift what is still short. Each push is spread over the cloth, over shorter lengths from round to round,
    so that it ends without spikes. With ``through`` limbs may stick through the cloth, as toes through a short sock:
    cloth inside them leaves by the side that it looks to.

    Raises ``MeshError`` if a vertex begins deeper than ``give_up_m`` in the body, or if one is nearer than ``least_m``
    after ``rounds`` pushes. If at most ``FEW_SHARE`` of the vertices are short of ``CLEARANCE_M``, these may end up to
    ``FEW_DEPTH_M`` inside.
    """
    target, moved = CLEARANCE_M + MARGIN_M, vertices.copy()
    skin = _Skin(moved, body_vertices, body_faces)
    _check_depth(skin.signed, give_up_m)
    smoothing = _Smoothing(_layered_laplacian(moved, faces, skin.nearest, body_vertices, body_faces))
    lift = target + LAYER_SOFTNESS_M * np.logaddexp(0.0, (skin.signed - target) / LAYER_SOFTNESS_M) - skin.signed
    stiffness = STIFFNESS_M2
    for round_number in range(rounds):
        short = skin.signed < target - 0.5 * MARGIN_M
        if not short.any():
            return _cleared(vertices, skin, round_number)
        if round_number:
            lift = np.where(short, target - skin.signed, 0.0)
        wanted = lift[:, None] * skin.direction
        if through and round_number < THROUGH_ROUNDS:
            wanted = _through(moved, faces, skin.signed, skin.direction, wanted, skin.body)
        weight = np.where(lift > 1e-5, 1.0, REST_SHARE)
        # A vertex takes its neighbours along; where it must move alone the weight lets it.
        moved = moved + smoothing.solve(weight, wanted, stiffness)
        stiffness = max(0.6 * stiffness, 0.004**2) if round_number < rounds - 8 else 0.0
        skin.move(moved)
    _check_clear(skin, rounds, least_m, through=through)
    return _cleared(vertices, skin, rounds)


def _cleared(start: np.ndarray, skin: _Skin, rounds: int) -> Cleared:
    push_m = float(np.linalg.norm(skin.points - start, axis=1).max())
    return Cleared(skin.points, float(skin.signed.min()), push_m, rounds)


def _check_depth(signed: np.ndarray, give_up_m: float) -> None:
    """Refuses (``MeshError``) cloth that begins deeper than ``give_up_m`` in the body."""
    if signed.min() < -give_up_m:
        raise MeshError(
            "garment",
            expected=f"vertices at most {1e3 * give_up_m:.0f} mm inside the body",
            got=f"{-1e3 * signed.min():.0f} mm at vertex {int(signed.argmin())}",
            cure="Say which avatar the garment was modelled on.",
        )


def _check_clear(skin: _Skin, rounds: int, least_m: float, *, through: bool) -> None:
    """Refuses (``MeshError``) cloth that all pushes have left nearer than ``least_m``, in more than a few places."""
    signed, short = skin.signed, skin.signed < CLEARANCE_M
    across = skin.points[short] + 2.0 * CLEARANCE_M * skin.direction[short]
    if through and signed.min() > 0.0 and (skin.body.signed_closest(across)[0] < CLEARANCE_M).all():
        least_m = 0.0  # two skins face each other there, with less room than twice the clearance between them
    if short.mean() <= FEW_SHARE:  # between toes or fingers: a frame lifts what is left
        least_m = min(least_m, -FEW_DEPTH_M)
    if signed.min() < least_m:
        raise MeshError(
            "garment",
            expected=f"a clearance of {1e3 * CLEARANCE_M:.1f} mm to the body",
            got=f"{1e3 * signed.min():.1f} mm at vertex {int(signed.argmin())} after {rounds} pushes",
            cure="Model the garment with more ease there, or say which avatar it was modelled on.",
        )


def _through(
    points: np.ndarray,
    faces: np.ndarray,
    signed: np.ndarray,
    direction: np.ndarray,
    wanted: np.ndarray,
    body: ClosedMesh,
) -> np.ndarray:
    """``wanted`` pushes [m] (N, 3), but along their normals for ``points`` in the body that look away from the skin.

    Facings, as of cuffs that are turned in, look into the limb from just below the skin, and leave as they came.
    """
    normals = meshes.vertex_normals(points, faces)
    agreement = np.einsum("nc,nc->n", normals, direction)
    piece = mesh_graphs.connected_components(faces, len(points))
    out = np.bincount(piece, agreement > 0.0) > LOOKS_OUT * np.bincount(piece)
    cloth = np.flatnonzero((signed < 0.0) & (agreement < ALONG) & out[piece])
    steps = np.linspace(0.0, THROUGH_M, THROUGH_STEPS + 1)[1:]
    along = points[cloth, None] + steps[:, None] * normals[cloth, None]
    depth = body.signed_closest(along.reshape(-1, 3))[0].reshape(along.shape[:2])
    left = np.logical_or.accumulate(depth > 0.0, axis=1)
    clear = (depth > CLEARANCE_M) & ~np.logical_or.accumulate(left & (depth < 0.0), axis=1)  # before the next limb
    exit_m = steps[clear.argmax(axis=1)]
    facing = (agreement[cloth] < 0.0) & (exit_m > FACING * -signed[cloth])
    ends, wanted = clear.any(axis=1) & ~facing, wanted.copy()
    wanted[cloth[ends]] = exit_m[ends, None] * normals[cloth[ends]]
    return wanted


def _layered_laplacian(
    vertices: np.ndarray, faces: np.ndarray, nearest: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray
) -> scipy.sparse.csr_matrix:
    """Laplacian [1/m^2] (N, N) over the mesh's edges and over pairs of layers on the same side of the body."""
    edges = meshes.unique_edges(faces)
    pairs = KDTree(vertices).query_pairs(LAYER_REACH_M, output_type="ndarray")
    normals = meshes.face_normals(body_vertices, body_faces)[nearest]
    if len(pairs):
        pairs = pairs[np.einsum("nc,nc->n", normals[pairs[:, 0]], normals[pairs[:, 1]]) > 0.5]
    joined = np.unique(np.sort(np.concatenate([edges, pairs]), axis=1), axis=0)
    weight = 1.0 / np.maximum(meshes.edge_lengths(vertices, joined), 2e-3) ** 2
    return mesh_graphs.weighted_laplacian(mesh_graphs.edge_matrix(joined, weight, len(vertices)))
