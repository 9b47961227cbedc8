"""The body that cloth meets: its signed distance, and contact by it: repulsion, friction, and equation 4's correction.

A shape is a function from points [m] (N, 3) to the distance [m] (N,), positive outside, and its spatial
gradient (N, 3): a plane, a sphere, or a grid of any closed mesh. Both are made of differentiable operations, so that
contact forces have derivatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import torch
from torch import Tensor

from drape.arrays import check_finite, check_shape
from drape.errors import InputError, MeshError
from drape.geometry import closest, meshes
from recovery.sim.cloth_model import ClothState

SignedDistance = Callable[[Tensor], tuple[Tensor, Tensor]]
BORDER = 12  # cells; the filter's memory falls by 0.27 per cell
LARGEST_GRID = 40_000_000  # nodes, 320 MB


@dataclass(frozen=True)
class PlaneDistance:
    """The signed distance of the half space behind the plane through ``point`` [m] with outward ``normal``, of any
    length."""

    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 1.0, 0.0)

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        normal = torch.tensor(self.normal, dtype=points.dtype)
        normal = normal / torch.linalg.vector_norm(normal)
        distance = (points - torch.tensor(self.point, dtype=points.dtype)) @ normal
        return distance, normal.expand(points.shape)


@dataclass(frozen=True)
class Sphere:
    """The signed distance of the ball of ``radius_m`` about ``centre`` [m]."""

    centre: tuple[float, float, float]
    radius_m: float

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        arm = points - torch.tensor(self.centre, dtype=points.dtype)
        length = torch.sqrt((arm * arm).sum(dim=1) + 1e-30)  # finite gradient at the centre
        return length - self.radius_m, arm / length[:, None]


@dataclass(frozen=True)
class Grown:
    """The signed distance of the body ``bare`` grown by ``by_m`` [m] on all sides: cloth rests that much farther off
    its skin."""

    bare: SignedDistance
    by_m: float

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        distance, gradient = self.bare(points)
        return distance - self.by_m, gradient


def bare(body: SignedDistance) -> SignedDistance:
    """Returns the signed distance of ``body`` before it was ``Grown``: ``body`` itself if it was not."""
    return body.bare if isinstance(body, Grown) else body


class GridDistance:
    """The signed distance of a body: a C2 tricubic B-spline through ``values`` [m] (X, Y, Z) on a grid.

    The value at ``index`` lies at ``origin`` [m] (3,) + ``spacing_m`` * index. The spline reaches from
    the second node of each axis to the last but one; beyond, in the outermost cells too, the distance from there is
    added.
    """

    def __init__(self, values: np.ndarray, origin: np.ndarray, spacing_m: float) -> None:
        check_shape("values", values, (None, None, None))
        check_finite("values", values)
        if min(values.shape) < 4 or not 0.0 < spacing_m < np.inf:
            raise InputError(
                "grid",
                expected="at least 4 nodes along every axis and a spacing > 0",
                got=f"{values.shape} nodes, spacing {spacing_m}",
                cure="Sample a larger or finer grid.",
            )
        # Odd reflection continues slopes; the filter's own border would bend them and ring for some cells.
        padded = np.pad(np.asarray(values, dtype=np.float64), BORDER, mode="reflect", reflect_type="odd")
        inner = (slice(BORDER, -BORDER),) * 3
        coefficients = scipy.ndimage.spline_filter(padded, order=3, mode="mirror")[inner]
        self.shape = coefficients.shape
        self.spacing_m = float(spacing_m)
        self._flat = torch.from_numpy(np.ascontiguousarray(coefficients)).reshape(-1)
        self._origin = torch.tensor(np.asarray(origin, dtype=np.float64))
        self._last = torch.tensor(self.shape, dtype=torch.float64) - 1.0
        x, y, z = (torch.arange(4) * step for step in (self.shape[1] * self.shape[2], self.shape[2], 1))
        self._taps = (x[:, None, None] + y[:, None] + z).reshape(-1)

    @classmethod
    def from_mesh(
        cls, vertices: np.ndarray, faces: np.ndarray, *, spacing_m: float = 0.01, margin_m: float = 0.05
    ) -> GridDistance:
        """Returns the signed distance of a closed mesh, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), sampled in its
        box and ``margin_m`` [m] around it.

        Raises ``MeshError`` for an open mesh, ``InputError`` for lengths that are not positive or a grid that is too
        large.
        """
        faces = check_closed(vertices, faces)
        if not (0.0 < spacing_m < np.inf and 0.0 <= margin_m < np.inf):
            raise InputError(
                "spacing_m and margin_m", expected="lengths > 0", got=f"{spacing_m}, {margin_m}", cure="Pass metres."
            )
        low = vertices.min(axis=0) - margin_m - spacing_m
        counts = np.ceil((vertices.max(axis=0) + margin_m + spacing_m - low) / spacing_m).astype(int) + 1
        if counts.prod() > LARGEST_GRID:
            raise InputError(
                "spacing_m",
                expected=f"at most {LARGEST_GRID} grid nodes",
                got=f"{counts.prod()}",
                cure="Take a coarser spacing, and check that the body is in metres.",
            )
        axes = [origin + spacing_m * np.arange(count) for origin, count in zip(low, counts, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        return cls(closest.signed_distance(points, vertices, faces).reshape(counts), low, spacing_m)

    def __call__(self, points: Tensor) -> tuple[Tensor, Tensor]:
        scaled = (points - self._origin) / self.spacing_m
        # Taps i - 1 .. i + 2 must exist, so the outermost cells are outside.
        inside = torch.minimum(torch.clamp(scaled, min=1.0), self._last - 1.0)
        cell = torch.minimum(torch.floor(inside.detach()), self._last - 2.0)
        t = inside - cell
        first = (cell - 1.0).to(torch.int64)
        start = (first[:, 0] * self.shape[1] + first[:, 1]) * self.shape[2] + first[:, 2]
        taps = self._flat[start[:, None] + self._taps].reshape(-1, 4, 4, 4)
        weight, slope = _bspline(t), _bspline_slope(t)
        z, dz = _contract(taps, weight[:, 2]), _contract(taps, slope[:, 2])
        zy, dzy, zdy = _contract(z, weight[:, 1]), _contract(dz, weight[:, 1]), _contract(z, slope[:, 1])
        value = _contract(zy, weight[:, 0])
        gradient = torch.stack(
            [_contract(zy, slope[:, 0]), _contract(zdy, weight[:, 0]), _contract(dzy, weight[:, 0])], dim=1
        )
        return extend_distance(value, gradient / self.spacing_m, (scaled - inside) * self.spacing_m)


def check_closed(vertices: np.ndarray, faces: np.ndarray, name: str = "body") -> np.ndarray:
    """Returns ``faces`` (F, 3) as integers. Raises ``MeshError`` for an open or empty mesh, which has no inside."""
    faces = meshes.check_faces(faces, len(vertices))
    loops = meshes.boundary_loops(faces)
    if len(faces) == 0 or loops:
        raise MeshError(
            name,
            expected="a closed surface",
            got=f"{len(loops)} open borders" if len(faces) else "no triangles",
            cure="Close its holes (neck, wrists, eyes), and join copies of vertices: what is inside must be defined.",
        )
    return faces


def extend_distance(value: Tensor, gradient: Tensor, off: Tensor) -> tuple[Tensor, Tensor]:
    """Returns distance [m] (N,) and gradient (N, 3) of points, from ``value`` (N,) and ``gradient`` (N, 3) at the
    points of a box that are nearest to them.

    ``off`` [m] (N, 3) leads from there to the points, zero inside the box. Its length is added to the distance.
    """
    far = (off != 0.0).any(dim=1)
    if not far.any():
        return value, gradient
    length = torch.sqrt(torch.where(far, (off * off).sum(dim=1), 1.0))
    gradient = torch.where(off != 0.0, off / length[:, None], gradient)
    return value + torch.where(far, length, 0.0), gradient


def _contract(taps: Tensor, weight: Tensor) -> Tensor:
    """Sum over the last axis of ``taps`` (N, ..., 4) with ``weight`` (N, 4)."""
    return (taps * weight.reshape(len(weight), *(1,) * (taps.ndim - 2), 4)).sum(dim=-1)


def _bspline(t: Tensor) -> Tensor:
    """Weights (..., 4) of the cubic B-spline at ``t`` in [0, 1]."""
    s = 1.0 - t
    middle = (4.0 - 6.0 * t * t + 3.0 * t**3, 4.0 - 6.0 * s * s + 3.0 * s**3)
    return torch.stack([s**3, *middle, t**3], dim=-1) / 6.0


def _bspline_slope(t: Tensor) -> Tensor:
    s = 1.0 - t
    return torch.stack([-s * s, 3.0 * t * t - 4.0 * t, 4.0 * s - 3.0 * s * s, t * t], dim=-1) / 2.0


@dataclass(frozen=True)
class SkinContact:
    """Contact of cloth with ``body``: repulsion, friction and a correction.

    Repulsion has the energy of ``drape.cloth.energies.contact``: ``stiffness_j_m4`` times node area times the squared
    depth below ``gap_m``. Friction is Coulomb's with coefficient ``friction``, smoothed: it grows as
    speed / sqrt(speed^2 + ``slip_speed_m_s``^2), so that a sticking node creeps below that speed. A node that a
    linearised step leaves inside the body is put ``thickness_m`` outside (equation 4).
    """

    body: SignedDistance
    stiffness_j_m4: float = 3.0e5
    gap_m: float = 0.004
    friction: float = 0.3
    slip_speed_m_s: float = 1e-3
    thickness_m: float = 0.001

    def __post_init__(self) -> None:
        numbers = {name: value for name, value in vars(self).items() if name != "body"}
        for name, value in numbers.items():
            if not 0.0 <= value < float("inf") or (name == "slip_speed_m_s" and value == 0.0):
                raise InputError(
                    f"contact {name}", expected="a number >= 0 (slip speed > 0)", got=str(value), cure="Use SI units."
                )

    def energy(self, x: Tensor, node_area: Tensor) -> Tensor:
        """Returns the energy [J] () of the repulsion of nodes at ``x`` [m] (V, 3) with ``node_area`` [m^2] (V,)."""
        depth = torch.clamp(self.gap_m - self.body(x)[0], min=0.0)
        return self.stiffness_j_m4 * (node_area * depth * depth).sum()

    def force(self, x: Tensor, node_area: Tensor) -> Tensor:
        """Returns the repulsion [N] (V, 3) of nodes at ``x`` [m] (V, 3) with ``node_area`` [m^2] (V,)."""
        distance, gradient = self.body(x)
        return self._magnitude(distance, node_area)[:, None] * gradient

    def stiffness(self, x: Tensor, node_area: Tensor) -> tuple[Tensor, Tensor]:
        """Returns c [N/m] (V,) and r (V, 3): the stiffness of the repulsion of each node is c r r^T, the body's
        curvature left out."""
        distance, gradient = self.body(x)
        return torch.where(distance < self.gap_m, 2.0 * self.stiffness_j_m4 * node_area, 0.0), gradient

    def grip(self, x: Tensor, node_area: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the greatest friction [N] (V,) of nodes at ``x`` [m] (V, 3), and the unit normals (V, 3) of the body
        there."""
        distance, gradient = self.body(x)
        return self.friction * self._magnitude(distance, node_area), _unit(gradient)

    def drag(self, x: Tensor, v: Tensor, node_area: Tensor) -> tuple[Tensor, Tensor]:
        """Returns the friction per tangential speed [N s/m] (V,) at velocities ``v`` [m/s] (V, 3), and the unit normals
        (V, 3)."""
        limit, normal = self.grip(x, node_area)
        slip = tangential(v, normal)
        return limit / torch.sqrt((slip * slip).sum(dim=1) + self.slip_speed_m_s**2), normal

    def friction_potential(self, move: Tensor, limit: Tensor, normal: Tensor, *, dt_s: float) -> Tensor:
        """Returns the incremental potential [J] () of moves ``move`` [m] (V, 3) in ``dt_s`` [s] against the greatest
        friction ``limit`` [N] (V,), across the unit ``normal`` (V, 3)."""
        slip = tangential(move, normal)
        smooth = self.slip_speed_m_s * dt_s
        return (limit * (torch.sqrt((slip * slip).sum(dim=1) + smooth**2) - smooth)).sum()

    def friction_resistance(self, move: Tensor, limit: Tensor, normal: Tensor, *, dt_s: float) -> Tensor:
        """Returns the derivative [N] (V, 3) of ``friction_potential`` by ``move``: minus the friction."""
        return self.friction_stiffness(move, limit, normal, dt_s=dt_s)[:, None] * tangential(move, normal)

    def friction_stiffness(self, move: Tensor, limit: Tensor, normal: Tensor, *, dt_s: float) -> Tensor:
        """Returns the secant stiffness [N/m] (V,) of friction: its size over that of the tangential move. The tangent
        stiffness is nowhere larger."""
        slip = tangential(move, normal)
        return limit / torch.sqrt((slip * slip).sum(dim=1) + (self.slip_speed_m_s * dt_s) ** 2)

    def corrected(self, state: ClothState, free: Tensor) -> ClothState:
        """Returns ``state`` with nodes inside the body put ``thickness_m`` outside it, without their inward velocity
        (equation 4 of Yu, Cordier and Seo 2024). ``free`` (V, 1) is above 0 at nodes that may move."""
        distance, gradient = self.body(state.x)
        normal = _unit(gradient)
        inside = ((distance < 0.0)[:, None] & (free > 0.0)).to(state.x.dtype)
        inward = torch.clamp((state.v * normal).sum(dim=1, keepdim=True), max=0.0)
        x = state.x + inside * (self.thickness_m - distance)[:, None] * normal
        return ClothState(x, state.v - inside * inward * normal)

    def _magnitude(self, distance: Tensor, node_area: Tensor) -> Tensor:
        return 2.0 * self.stiffness_j_m4 * node_area * torch.clamp(self.gap_m - distance, min=0.0)


def tangential(vectors: Tensor, normal: Tensor) -> Tensor:
    """Returns ``vectors`` (V, 3) without their parts along the unit ``normal`` (V, 3)."""
    return vectors - (vectors * normal).sum(dim=1, keepdim=True) * normal


def _unit(gradient: Tensor) -> Tensor:
    return gradient / torch.sqrt((gradient * gradient).sum(dim=1, keepdim=True) + 1e-30)
