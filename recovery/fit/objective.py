"""The loss of a drape against its target: curvature-weighted Chamfer distance, contours, seams (equations 5 to 8).

The paper measures from vertex to vertex, which leaves millimetres between two meshes of one surface. Here a point is
compared with the nearest point of the other surface, so a surface is at distance zero from itself in any
triangulation. The nearest points are held while differentiating. The gradient is exact all the same, because a nearest
point moves at right angles to the distance; only the weight at the nearest point is taken as constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.arrays import check_finite, check_shape
from drape.errors import MeshError
from drape.geometry import closest, meshes
from recovery.fit.contours import Contour, Match
from recovery.pattern import geometry
from recovery.pattern.mesh import PatternMesh
from recovery.pattern.model import Pattern
from recovery.pattern.triangulate import signed_areas

FOLD_PER_M = 100.0  # H0 of the weight min(1 + |H| / H0, 5): a fold of 1 cm
LARGEST_WEIGHT = 5.0
CORNERS = (
    np.array([(4.0, 1.0, 1.0), (1.0, 4.0, 1.0), (1.0, 1.0, 4.0)]) / 6.0
)  # points in a triangle, exact for quadratics


class Weights(NamedTuple):
    """Weights of the terms beside the Chamfer distance of the surfaces.

    An infinite weight of ``seams`` makes them a constraint of the search (``seams.py``) and no term of the loss. A
    finite one is the paper's, whose 0.1 and 0.01 have no units, and lets seams give way to what the target tells.
    ``folds`` is the share of the weight by curvature that counts, 0 for none. A search's loss doubles where its
    unknowns are ``reach_m`` [m] (by their norm) from the likely ones. This multiplicative regularisation (van den Berg,
    van Broekhoven and Abubakar 1999) keeps what a drape hardly shows, and leaves an exact fit exact.
    """

    contours: float = 1.0
    seams: float = math.inf
    folds: float = 1.0
    reach_m: float = 0.045

    @property
    def seams_hold(self) -> bool:
        """Whether seams are a constraint."""
        return math.isinf(self.seams)

    @property
    def seam_term(self) -> float:
        """The weight of the seams in the loss: 0 where they are a constraint."""
        return 0.0 if self.seams_hold else self.seams


DEFAULT_WEIGHTS = Weights()


class Terms(NamedTuple):
    """The loss [m^2] and its parts, before their weights: ``surface``, ``contours``, ``seams``."""

    total: Tensor
    surface: Tensor
    contours: Tensor
    seams: Tensor


def mean_curvature(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """|H| [1/m] (V,) by the cotangent formula over a third of the triangles about a vertex; 0 on borders.

    H is the mean of both principal curvatures: 1 / r on a sphere.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", vertices, (None, 3), error=MeshError)
    check_finite("vertices", vertices, error=MeshError)
    faces = meshes.check_faces(faces, len(vertices))
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
    """kappa of equation 7: min(1 + |H| / H0, 5)."""
    return np.minimum(1.0 + curvature / FOLD_PER_M, LARGEST_WEIGHT)


@dataclass(frozen=True, eq=False)
class Target:
    """A target surface: ``vertices`` [m], ``faces``, its ``contours``; ``weights`` (V,) of equation 7.

    ``points`` (3 F, 3) lie in its triangles; ``shares`` (3 F,) are their parts of the area, times their weights.
    ``known`` (F,) is 1 for faces that were seen and 0 for those that close a hole, which have no weight.
    """

    vertices: np.ndarray
    faces: np.ndarray
    contours: list[Contour]
    weights: np.ndarray
    points: np.ndarray
    shares: np.ndarray
    known: np.ndarray

    @classmethod
    def from_mesh(
        cls,
        vertices: np.ndarray,
        faces: np.ndarray,
        contours: list[Contour],
        *,
        folds: float = 1.0,
        known: np.ndarray | None = None,
    ) -> Target:
        """The target of a mesh, of which the faces ``known`` (F,) count, all by default.

        A weight is 1, and ``folds`` times the excess that its curvature gives.
        """
        weights = 1.0 + folds * (fold_weights(mean_curvature(vertices, faces)) - 1.0)
        seen = np.ones(len(faces)) if known is None else np.asarray(known, dtype=np.float64)
        area = seen * meshes.face_areas(vertices, faces)
        points = (CORNERS @ vertices[faces]).reshape(-1, 3)
        shares = np.repeat(area / area.sum() / 3.0, 3) * (weights[faces] @ CORNERS.T).reshape(-1)
        return cls(vertices, faces, contours, weights, points, shares, seen)

    def weights_at(self, there: closest.ClosestPoints) -> np.ndarray:
        """The weights (n,) of equation 7 at points of the surface; none where a hole was closed."""
        kappa = (self.weights[self.faces[there.face]] * there.barycentric).sum(axis=1)
        return kappa * self.known[there.face]


class Objective:
    """The loss of a drape of ``mesh`` against ``target``; ``contours`` of the drape have their ``matches`` there.

    Seams should keep the ratio of lengths that they have in ``base``, by default the pattern of ``mesh``: a cap that
    is eased into its armhole stays so.
    """

    def __init__(
        self,
        mesh: PatternMesh,
        target: Target,
        contours: list[Contour],
        matches: list[Match],
        weights: Weights = DEFAULT_WEIGHTS,
        *,
        base: Pattern | None = None,
    ) -> None:
        self.mesh, self.target, self.weights = mesh, target, weights
        self._faces = torch.from_numpy(np.ascontiguousarray(mesh.faces))
        area = np.abs(signed_areas(mesh.rest, mesh.panel_faces))
        self.shares = np.repeat(area / area.sum() / 3.0, 3)
        self.pairs = [(contours[m.source].loop, target.contours[m.target].points) for m in matches]
        self.seam_edges = self._seam_edges(mesh.pattern if base is None else base)

    def __call__(self, x: Tensor, rest: Tensor) -> Terms:
        """The loss of nodes ``x`` [m] (N, 3) and panel vertices ``rest`` [m] (P, 2)."""
        surface, contours, seams = self.surface(x), self.open_contours(x), self.seams(rest)
        total = surface + self.weights.contours * contours + self.weights.seam_term * seams
        return Terms(total, surface, contours, seams)

    def surface(self, x: Tensor) -> Tensor:
        """Equation 7 [m^2] between both surfaces, by area instead of by vertex."""
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

    def open_contours(self, x: Tensor) -> Tensor:
        """Chamfer distance [m^2] between matched contours, the mean over them."""
        if not self.pairs:
            return x.sum() * 0.0
        found = [polyline_chamfer(x[torch.from_numpy(loop)], torch.from_numpy(points)) for loop, points in self.pairs]
        return torch.stack(found).mean()

    def seams(self, rest: Tensor) -> Tensor:
        """Equation 8 [m^2]: squared differences in length of sewn segments, one side times the ease of the base."""
        first, second, ratio = self.seam_edges
        lengths = [torch.linalg.vector_norm(rest[ends[:, 1]] - rest[ends[:, 0]], dim=1) for ends in (first, second)]
        return ((lengths[0] - ratio * lengths[1]) ** 2).sum()

    def _seam_edges(self, base: Pattern) -> tuple[Tensor, Tensor, Tensor]:
        """Panel vertices at the ends of sewn segments (E, 2) of both sides, and the ratio (E,) they should have."""
        of_seam = self.mesh.seam_of_pair
        inside = of_seam[1:] == of_seam[:-1]
        ends = [np.stack([side[:-1][inside], side[1:][inside]], axis=1) for side in self.mesh.seam_pairs.T]
        ratio = np.array([seam.first_m / seam.second_m for seam in geometry.seams(base)])[of_seam[:-1][inside]]
        first, second = (torch.from_numpy(side.astype(np.int64)) for side in ends)
        return first, second, torch.from_numpy(ratio)


def polyline_chamfer(first: Tensor, second: Tensor) -> Tensor:
    """Squared distances [m^2] of two closed polylines (n, 3) and (m, 3), both directions summed, by length."""
    return _one_way(first, second) + _one_way(second, first)


def _one_way(points: Tensor, line: Tensor) -> Tensor:
    """Mean squared distance of the closed polyline ``points``, by two points a segment, to the closed one ``line``."""
    samples, shares, best, t = on_line(points, line)
    # The place on the line is held, the line itself may move.
    nearest = line[best] + t[:, None] * (torch.roll(line, -1, dims=0) - line)[best]
    return shares @ ((samples - nearest) ** 2).sum(dim=1)


def on_line(points: Tensor, line: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Samples (2 n, 3) of the closed polyline ``points``, their shares of its length, and their places on ``line``.

    That is the number of the nearest segment and the place on it from 0 to 1, both held while differentiating.
    """
    following = torch.roll(points, -1, dims=0)
    length = torch.linalg.vector_norm(following - points, dim=1)
    shares = torch.cat([length, length]) / (2.0 * length.sum())
    share = 0.5 - 0.5 / 3.0**0.5  # Gauss's points of a segment
    samples = torch.cat([points + share * (following - points), following + share * (points - following)])
    best, t = nearest_on_line(samples, line)
    return samples, shares, best, t


def nearest_on_line(points: Tensor, line: Tensor) -> tuple[Tensor, Tensor]:
    """The segment (n,) of a closed polyline ``line`` (m, 3) nearest to each of ``points`` (n, 3), and the place on it.

    Places (n,) run from 0 to 1. Neither is differentiated.
    """
    with torch.no_grad():
        along = torch.roll(line, -1, dims=0) - line
        squared = torch.clamp((along * along).sum(dim=1), min=1e-30)
        t = torch.clamp(((points[:, None] - line[None]) * along[None]).sum(dim=2) / squared, 0.0, 1.0)
        off = points[:, None] - line[None] - t[..., None] * along[None]
        best = (off * off).sum(dim=2).argmin(dim=1)
        return best, t[torch.arange(len(points)), best]
