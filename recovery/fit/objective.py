"""The loss of a drape against its target, and the seams as a constraint of the search for the least of it.

The loss is the curvature-weighted Chamfer distance and that of contours (equations 5 to 7). The paper measures from
vertex to vertex, which leaves millimetres between two meshes of one surface. Here a point is compared with the nearest
point of the other surface, so a surface is at distance zero from itself in any triangulation. The nearest points are
held while differentiating. The gradient is exact all the same, because a nearest point moves at right angles to the
distance; only the weight at the nearest point is taken as constant.

In the Gauss-Newton matrix residuals are linear in the drape. A nearest point follows along a surface, so only motion
along the normal counts; at a border only motion across it.

A term of the loss would let seams give way to a target (equation 8 of the paper). What is cut must not. So the search
stays on the surface of free values z where g(z) = 0, with one equation a stitch: g = ln(first edge / second edge) -
ln(ratio of the base). An edge is its chord times a constant, so the derivative of g is exact. A step goes along the
surface, and Newton's method with the shortest correction brings it back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.errors import InputError
from drape.garment.contours import Contour, Match, open_contours
from drape.geometry import closest, meshes
from recovery.pattern import geometry
from recovery.pattern.coordinates import with_controls
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.sewing_pattern import EdgeRef, Pattern
from recovery.pattern.symmetry import FreeControls, Symmetries, free_controls

FOLD_PER_M = 100.0  # H0 of the weight min(1 + |H| / H0, 5): a fold of 1 cm
LARGEST_WEIGHT = 5.0
# Barycentric points in a triangle whose mean integrates quadratics exactly.
CORNERS = np.array([(4.0, 1.0, 1.0), (1.0, 4.0, 1.0), (1.0, 1.0, 4.0)]) / 6.0
EVEN = 0.005  # a base whose edges differ by less has no ease there: its seams are made equal
EXACT = 1e-10  # largest relative error of a length that Newton's method leaves
NEWTON_LIMIT = 30
RANK = 1e-9  # singular values below this share of the largest count as zero: mirrored stitches give an equation twice


class Terms(NamedTuple):
    """The loss ``total`` [m^2] () and its parts ``surface`` and ``contours`` [m^2] (), which sum to it."""

    total: Tensor
    surface: Tensor
    contours: Tensor


def mean_curvature(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns |H| [1/m] (V,) of a mesh, 0 on borders, by the cotangent formula over a third of the triangles about a
    vertex.

    H is the mean of both principal curvatures: 1 / r on a sphere of radius r.
    """
    double = np.maximum(2.0 * meshes.face_areas(vertices, faces), 1e-30)
    total = np.zeros_like(vertices)
    for corner in range(3):
        a, b, c = (faces[:, (corner + k) % 3] for k in range(3))
        cotangent = ((vertices[b] - vertices[a]) * (vertices[c] - vertices[a])).sum(axis=1) / double
        pull = 0.5 * cotangent[:, None] * (vertices[c] - vertices[b])
        np.add.at(total, b, pull)
        np.add.at(total, c, -pull)
    curvature = np.linalg.norm(total, axis=1) / (2.0 * np.maximum(meshes.vertex_areas(vertices, faces), 1e-30))
    for loop in meshes.boundary_loops(faces):
        curvature[loop] = 0.0
    return curvature


def fold_weights(curvature: np.ndarray) -> np.ndarray:
    """Returns the weights min(1 + |H| / H0, 5) (V,) for the ``curvature`` |H| [1/m] (V,), where H0 is ``FOLD_PER_M``
    (equation 7 of the paper)."""
    return np.minimum(1.0 + curvature / FOLD_PER_M, LARGEST_WEIGHT)


@dataclass(frozen=True, eq=False)
class TargetSurface:
    """A target surface: ``vertices`` [m] (V, 3), ``faces`` (F, 3), its open ``contours``, and the fold ``weights``
    (V,).

    ``points`` (3 F, 3) [m] are three in each triangle, face by face. ``shares`` (3 F,) are the shares of the known area
    that these stand for, times the fold weights there. ``known`` (F,), float, is 1 for faces that were seen and 0 for
    those that close a hole, which have no share.
    """

    vertices: np.ndarray
    faces: np.ndarray
    contours: list[Contour]
    weights: np.ndarray
    points: np.ndarray
    shares: np.ndarray
    known: np.ndarray

    @classmethod
    def from_mesh(cls, vertices: np.ndarray, faces: np.ndarray, *, known: np.ndarray | None = None) -> TargetSurface:
        """Returns the target of a mesh, ``vertices`` [m] (V, 3) and ``faces`` (F, 3); faces that are not ``known``
        (F,), bool, close holes. By default all are known."""
        weights = fold_weights(mean_curvature(vertices, faces))
        seen = np.ones(len(faces)) if known is None else np.asarray(known, dtype=np.float64)
        area = seen * meshes.face_areas(vertices, faces)
        points = (CORNERS @ vertices[faces]).reshape(-1, 3)
        shares = np.repeat(area / area.sum() / 3.0, 3) * (weights[faces] @ CORNERS.T).reshape(-1)
        return cls(vertices, faces, open_contours(vertices, faces), weights, points, shares, seen)

    def weights_at(self, there: closest.ClosestPoints) -> np.ndarray:
        """Returns the fold weights (n,) at points of the surface, 0 on faces that close a hole."""
        kappa = (self.weights[self.faces[there.face]] * there.barycentric).sum(axis=1)
        return kappa * self.known[there.face]


class Objective:
    """The loss of a drape of ``mesh`` against ``target``; ``matches`` pair ``contours`` of the drape with those of the
    target.

    Seams are a constraint of the search and no term of the loss, unlike equation 8 of the paper.
    """

    def __init__(self, mesh: PatternMesh, target: TargetSurface, contours: list[Contour], matches: list[Match]) -> None:
        self.mesh, self.target = mesh, target
        self._faces = torch.from_numpy(np.ascontiguousarray(mesh.faces))
        area = np.abs(meshes.signed_areas(mesh.rest, mesh.panel_faces))
        self.shares = np.repeat(area / area.sum() / 3.0, 3)
        self.pairs = [(contours[m.source].loop, target.contours[m.target].points) for m in matches]

    def __call__(self, x: Tensor) -> Terms:
        """The loss of nodes ``x`` [m] (N, 3)."""
        surface, contours = self.surface(x), self.contours(x)
        return Terms(surface + contours, surface, contours)

    def surface(self, x: Tensor) -> Tensor:
        """Returns the squared distance [m^2] () of drape and target for nodes ``x`` [m] (N, 3): means over both
        surfaces, weighted by folds (equation 7), summed."""
        points = torch.from_numpy(CORNERS) @ x[self._faces]  # (F, 3, 3)
        points = points.reshape(-1, 3)
        target = self.target
        there = closest.closest_point(points.detach().numpy(), target.vertices, target.faces)
        forth = torch.from_numpy(self.shares * target.weights_at(there)) @ (
            (points - torch.from_numpy(there.point)) ** 2
        ).sum(dim=1)
        here = closest.closest_point(target.points, x.detach().numpy(), self.mesh.faces)
        nearest = (torch.from_numpy(here.barycentric)[:, :, None] * x[self._faces[here.face]]).sum(dim=1)
        back = torch.from_numpy(target.shares) @ ((nearest - torch.from_numpy(target.points)) ** 2).sum(dim=1)
        return forth + back

    def contours(self, x: Tensor) -> Tensor:
        """Returns the ``polyline_chamfer`` [m^2] () of matched contours for nodes ``x`` [m] (N, 3), the mean over the
        pairs; 0 without pairs."""
        if not self.pairs:
            return x.sum() * 0.0
        pairs = [(x[torch.from_numpy(loop)], torch.from_numpy(points)) for loop, points in self.pairs]
        return torch.stack([polyline_chamfer(*pair) for pair in pairs]).mean()


def polyline_chamfer(first: Tensor, second: Tensor) -> Tensor:
    """Returns the mean squared distances [m^2] () of the points of two closed polylines [m] (n, 3) and (m, 3) from the
    other one, both directions summed."""
    return _one_way(first, second) + _one_way(second, first)


def _one_way(points: Tensor, line: Tensor) -> Tensor:
    """Mean squared distance of the closed polyline ``points``, by two points a segment, to the closed one ``line``."""
    samples, shares, best, t = on_line(points, line)
    # The place on the line is held, the line itself may move.
    nearest = line[best] + t[:, None] * (torch.roll(line, -1, dims=0) - line)[best]
    return shares @ ((samples - nearest) ** 2).sum(dim=1)


def on_line(points: Tensor, line: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Returns samples (2 n, 3) of the closed polyline ``points`` (n, 3), their shares (2 n,) of its length, and where
    each is nearest to the closed polyline ``line`` (m, 3): the segment's number (2 n,), and the place (2 n,) on it from
    0 to 1.

    Number and place are held constant while differentiating.
    """
    following = torch.roll(points, -1, dims=0)
    length = torch.linalg.vector_norm(following - points, dim=1)
    shares = torch.cat([length, length]) / (2.0 * length.sum())
    share = 0.5 - 0.5 / 3.0**0.5  # Gauss's points of a segment
    samples = torch.cat([points + share * (following - points), following + share * (points - following)])
    best, t = nearest_on_line(samples, line)
    return samples, shares, best, t


def nearest_on_line(points: Tensor, line: Tensor) -> tuple[Tensor, Tensor]:
    """Returns for each of ``points`` (n, 3) the number (n,) of the nearest segment of the closed polyline ``line`` (m,
    3), and the place (n,) on it, from 0 to 1. Neither is differentiated."""
    with torch.no_grad():
        along = torch.roll(line, -1, dims=0) - line
        squared = torch.clamp((along * along).sum(dim=1), min=1e-30)
        t = torch.clamp(((points[:, None] - line[None]) * along[None]).sum(dim=2) / squared, 0.0, 1.0)
        off = points[:, None] - line[None] - t[..., None] * along[None]
        best = (off * off).sum(dim=2).argmin(dim=1)
        return best, t[torch.arange(len(points)), best]


# --- second derivatives ----------------------------------------------------------------------------------------------


def gauss_newton_matrix(objective: Objective, x: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Returns the matrix (Z, Z) [m^2 per m^2] of second derivatives of the loss by Z unknowns [m], at nodes ``x`` [m]
    (N, 3), by Gauss and Newton. ``moves`` (N, 3, Z) are the derivatives of the nodes by the unknowns."""
    faces, target = objective.mesh.faces, objective.target
    points = (CORNERS @ x[faces]).reshape(-1, 3)
    there = closest.closest_point(points, target.vertices, target.faces)
    kappa = target.weights_at(there)
    normal = meshes.face_normals(target.vertices, target.faces)[there.face]
    along = np.einsum("qc,fcdz->fqdz", CORNERS, moves[faces]).reshape(len(points), 3, -1)
    total = _normal_part(along, _across(normal, points - there.point, there, target.faces), objective.shares * kappa)
    here = closest.closest_point(target.points, x, faces)
    normal = meshes.face_normals(x, faces)[here.face]
    along = np.einsum("nc,ncdz->ndz", here.barycentric, moves[faces[here.face]])
    total = total + _normal_part(along, _across(normal, target.points - here.point, here, faces), target.shares)
    for loop, line in objective.pairs:
        total = total + _contour_part(x[loop], line, moves[loop]) / len(objective.pairs)
    return total


def _across(normal: np.ndarray, offset: np.ndarray, found: closest.ClosestPoints, faces: np.ndarray) -> np.ndarray:
    """The direction (n, 3) of each distance: the normal, beyond a border that of the offset."""
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    beyond = closest.on_border(found, faces)[:, None] & (length > 1e-9)
    return np.where(beyond, offset / np.maximum(length, 1e-30), normal)


def _normal_part(along: np.ndarray, direction: np.ndarray, shares: np.ndarray) -> np.ndarray:
    rows = np.einsum("nd,ndz->nz", direction, along)
    return 2.0 * (rows * shares[:, None]).T @ rows


def _contour_part(points: np.ndarray, line: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Second derivative of ``polyline_chamfer`` by moves (n, 3, Z) of the first line."""
    following, later = np.roll(points, -1, axis=0), np.roll(moves, -1, axis=0)
    total = np.zeros((moves.shape[2],) * 2)
    own, other = torch.from_numpy(np.ascontiguousarray(points)), torch.from_numpy(np.ascontiguousarray(line))
    length = np.linalg.norm(following - points, axis=1)
    samples, shares, best, _ = on_line(own, other)
    share = np.linalg.norm(samples.numpy() - np.concatenate([points, points]), axis=1) / np.concatenate(
        [length, length]
    )
    share = share[:, None, None]
    along = (1.0 - share) * np.concatenate([moves, moves]) + share * np.concatenate([later, later])
    total += _cross_part(along, np.roll(line, -1, axis=0)[best.numpy()] - line[best.numpy()], shares.numpy())
    _, shares, best, t = on_line(other, own)
    at, t = best.numpy(), t.numpy()[:, None, None]
    along = (1.0 - t) * moves[at] + t * later[at]
    return total + _cross_part(along, following[at] - points[at], shares.numpy())


def _cross_part(along: np.ndarray, way: np.ndarray, shares: np.ndarray) -> np.ndarray:
    unit = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-30)
    rows = along - unit[:, :, None] * np.einsum("nd,ndz->nz", unit, along)[:, None]
    return 2.0 * np.einsum("n,ndz,ndy->zy", shares, rows, rows)


def wanted_ratios(base: Pattern) -> np.ndarray:
    """Returns for each of the S stitches of ``base`` the ratio (S,) of its first edge's length to its second's; exactly
    1 where they differ by at most ``EVEN``."""
    ratio = np.array([seam.first_m / seam.second_m for seam in geometry.seams(base)])
    return np.where(np.abs(ratio - 1.0) <= EVEN, 1.0, ratio)


def ease_left(pattern: Pattern, base: Pattern) -> np.ndarray:
    """Returns the relative error (S,) of each stitch of ``pattern``: the ratio of its edges' lengths over that in
    ``base``, less 1."""
    return np.array([seam.first_m / seam.second_m for seam in geometry.seams(pattern)]) / wanted_ratios(base) - 1.0


class SeamConstraint:
    """The constraint that the S stitches of ``pattern`` have the ratios of edge lengths that those of ``base`` have, as
    a function of the Z ``free`` values of its corners."""

    def __init__(self, pattern: Pattern, free: FreeControls, base: Pattern) -> None:
        self.free = free
        self._number = {panel.name: number for number, panel in enumerate(pattern.panels)}
        sides = [[getattr(stitch, side) for stitch in pattern.stitches] for side in ("first", "second")]
        self._chords = np.stack([self._chord_rows(refs) for refs in sides])  # (2, S, 2 coordinates, 1 + Z)
        per_chord = [
            np.array([geometry.relative_length(pattern.panel(ref.panel).edges[ref.edge]) for ref in refs])
            for refs in sides
        ]
        self.offset = np.log(per_chord[0]) - np.log(per_chord[1]) - np.log(wanted_ratios(base))

    def _chord_rows(self, refs: list[EdgeRef]) -> np.ndarray:
        """Chords (S, 2, 1 + Z) of edges as linear functions of (1, z)."""
        rows = np.concatenate([self.free.origin.reshape(-1, 1), self.free.basis], axis=1).reshape(
            len(self.free.controls), 2, -1
        )
        chords = np.zeros((len(refs), *rows.shape[1:]))
        for number, ref in enumerate(refs):
            corners = np.flatnonzero(self.free.controls.panel == self._number[ref.panel])
            chords[number] = rows[corners[(ref.edge + 1) % len(corners)]] - rows[corners[ref.edge]]
        return chords

    def apart(self, values: np.ndarray) -> np.ndarray:
        """Returns the logarithm g (S,) of every seam's ratio over the one in the base, at ``values`` [m] (Z,); 0 where
        it is kept."""
        chords = self._chords @ np.concatenate([[1.0], values])
        length = np.log(np.linalg.norm(chords, axis=2))
        return length[0] - length[1] + self.offset

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """Returns the derivatives (S, Z) [1/m] of ``apart`` at ``values`` [m] (Z,)."""
        chords = self._chords @ np.concatenate([[1.0], values])
        along = chords / (chords**2).sum(axis=2, keepdims=True)
        rows = np.einsum("esc,escz->esz", along, self._chords[..., 1:])
        return rows[0] - rows[1]

    def along(self, values: np.ndarray) -> np.ndarray:
        """Returns orthonormal directions (Z, M) in which no seam's ratio changes, to first order at ``values`` [m]
        (Z,)."""
        _, size, ways = np.linalg.svd(self.slopes(values), full_matrices=True)
        rank = int((size > RANK * max(size.max(initial=0.0), 1e-30)).sum())
        return ways[rank:].T

    def kept(self, values: np.ndarray) -> np.ndarray | None:
        """Returns values [m] (Z,) near ``values``, by Newton's shortest steps, at which all seams have their ratios;
        None where it finds none."""
        values = np.array(values, dtype=np.float64)
        for _ in range(NEWTON_LIMIT):
            apart = self.apart(values)
            if np.abs(apart).max(initial=0.0) <= EXACT:
                return values
            if not np.isfinite(apart).all():
                return None
            values = values - np.linalg.lstsq(self.slopes(values), apart, rcond=RANK)[0]
        return None


def sewable(pattern: Pattern, base: Pattern, symmetries: Symmetries) -> Pattern:
    """Returns ``pattern`` with its corners moved as little as gives its seams the ratios of edge lengths of ``base``.

    ``symmetries`` of the pattern stay. Raises ``InputError`` where no corners do.
    """
    free = free_controls(pattern, symmetries)
    values = SeamConstraint(pattern, free, base).kept(np.zeros(free.count))
    if values is None:
        raise InputError(
            "seams",
            expected="edges that can be made as long as those they are sewn to",
            got="corners that cannot be moved so",
            cure="Check the base's seams: python -m recovery.pattern show.",
        )
    return with_controls(pattern, free.controls, free.positions(values))
