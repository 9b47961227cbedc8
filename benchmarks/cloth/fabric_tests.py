"""The textile tests of a fabric in the simulator: cantilever, tensile strip and Cusick's drape, on uneven meshes.

Panels have x along the weft and y along the warp; a strip is cut along its own x and turned by the grain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.signal import find_peaks
from scipy.spatial import Delaunay

from drape.cloth.fabric import Fabric, bending_angle, hinge_rigidity
from drape.cloth.material import Material
from recovery.sim.model import ClothModel, ClothState, Parameters
from recovery.sim.newton import Report, equilibrium, newton_step

TOLERANCE_N = 1e-6  # of the cloth's weight per node, 1e-5 to 1e-4 N
PEIRCE_ANGLE_DEG = 41.5
STRIP_WIDTH_M, STRIP_LENGTH_M = 0.025, 0.15
DISC_RADIUS_M, PEDESTAL_RADIUS_M = 0.15, 0.09
SHADOW_PIXEL_M = 0.4e-3
ROUNDS = 30  # of moving the free points of a mesh to the middle of their fans
ROW = 0.5 * np.sqrt(3.0)  # height of a row of triangles, in edges
# The drapemeter lowers its outer ring and leaves the cloth hanging: here the weight grows in small shares. With the
# whole weight at once the cloth falls, breaks into half as many nodes again, and stays there with more energy.
SHARES = np.linspace(0.05, 1.0, 20)
STEPS_PER_SHARE, SHARE_DT_S, SHARE_ITERATIONS = 2, 0.1, 4
NODE_DEPTH_M = 0.003  # a fold less deep than this is no node


class Mesh(NamedTuple):
    """Points [m] (V, 2), triangles (F, 3), counter-clockwise, and the points that are held."""

    points: np.ndarray
    faces: np.ndarray
    held: np.ndarray


@dataclass(frozen=True)
class Drape:
    """A draped disc: ``vertices`` [m] (V, 3), ``mesh`` at rest, drape coefficient [%], nodes, how the solve ended."""

    vertices: np.ndarray
    mesh: Mesh
    coefficient_pct: float
    nodes: int
    report: Report


# --- meshes ----------------------------------------------------------------------------------------------------------


def strip_mesh(length_m: float, edge_m: float, *, line: bool) -> Mesh:
    """A strip about x = 0; held is its left end or, with ``line``, the line in its middle."""
    half, width = 0.5 * length_m, STRIP_WIDTH_M
    columns, rows = (max(round(size / edge_m), 2) for size in (half, width))
    x, y = np.linspace(-half, half, 2 * columns + 1), np.linspace(0.0, width, rows + 1)
    ends = [np.stack([np.full_like(y, at), y], axis=1) for at in ((0.0, -half, half) if line else (-half, half))]
    sides = [np.stack([x[1:-1], np.full_like(x[1:-1], at)], axis=1) for at in (0.0, width)]
    if line:
        sides = [np.delete(side, columns - 1, axis=0) for side in sides]
    rng = np.random.default_rng(0)
    count = round(length_m * width / (ROW * edge_m**2)) - sum(map(len, ends + sides)) // 2
    inside = rng.uniform([-half, 0.0], [half, width], (max(count, 0), 2))
    return _even(np.concatenate([*ends, *sides]), inside, held=len(y), edge_m=edge_m)


def disc_mesh(edge_m: float, *, seed: int = 0) -> Mesh:
    """The specimen outside of the pedestal; two rings at its border are held.

    The last held ring lies a quarter of an edge's row outside of the pedestal: half of what the cloth bends at that
    ring belongs to the triangles within it, which are flat.
    """
    inner, middle = PEDESTAL_RADIUS_M - 0.5 * ROW * edge_m, PEDESTAL_RADIUS_M + 0.5 * ROW * edge_m
    rings = [_ring(radius, edge_m) for radius in (inner, middle, DISC_RADIUS_M)]
    rng = np.random.default_rng(seed)
    area = np.pi * (DISC_RADIUS_M**2 - middle**2)
    count = round(area / (ROW * edge_m**2)) - (len(rings[1]) + len(rings[2])) // 2
    radius = np.sqrt(rng.uniform((middle + 0.4 * edge_m) ** 2, (DISC_RADIUS_M - 0.4 * edge_m) ** 2, count))
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    inside = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    held = len(rings[0]) + len(rings[1])
    return _even(np.concatenate(rings), inside, held=held, edge_m=edge_m, hole_m=inner)


def _ring(radius: float, edge_m: float) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, round(2.0 * np.pi * radius / edge_m), endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _even(border: np.ndarray, inside: np.ndarray, *, held: int, edge_m: float, hole_m: float = 0.0) -> Mesh:
    """Delaunay triangles after the points ``inside`` were moved to the middles of their fans; uneven, no lattice."""
    points = np.concatenate([border, inside])
    for _ in range(ROUNDS):
        faces = _triangles(points, edge_m, hole_m)
        corners = points[faces]
        area = np.repeat(np.abs(_doubled_area(corners)), 3)
        index = faces.reshape(-1)
        middle = np.repeat(corners.mean(axis=1), 3, axis=0)
        moved = np.stack([np.bincount(index, area * middle[:, k], len(points)) for k in range(2)], axis=1)
        moved /= np.bincount(index, area, len(points))[:, None]
        points[len(border) :] = moved[len(border) :]
    return Mesh(points, _triangles(points, edge_m, hole_m), np.arange(held))


def _triangles(points: np.ndarray, edge_m: float, hole_m: float) -> np.ndarray:
    faces = Delaunay(points).simplices.astype(np.int64)
    area = _doubled_area(points[faces])
    outside = np.linalg.norm(points[faces].mean(axis=1), axis=1) > 0.999 * hole_m
    faces[area < 0.0] = faces[area < 0.0, ::-1]
    return faces[(np.abs(area) > 1e-3 * edge_m**2) & (outside | (hole_m == 0.0))]


def _doubled_area(corners: np.ndarray) -> np.ndarray:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


# --- a fabric on a mesh ----------------------------------------------------------------------------------------------


def simulated(fabric: Fabric, mesh: Mesh, *, angle_rad: float = 0.0) -> tuple[ClothModel, Parameters]:
    """The mesh cut with its x at ``angle_rad`` to the warp: rest panels in grain axes, a rigidity for each hinge."""
    model = ClothModel(mesh.faces, fixed=mesh.held, gravity_m_s2=Material.gravity_m_s2)
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    panels = mesh.points @ np.array([[s, c], [-c, s]])
    parameters = model.parameters(panels, Material.of(fabric).woven)
    edge = panels[model.hinge_nodes[:, 1]] - panels[model.hinge_nodes[:, 0]]
    return model, parameters._replace(bending_j=torch.from_numpy(hinge_rigidity(fabric, bending_angle(edge))))


def _flat(mesh: Mesh, *, noise_m: float = 0.0, seed: int = 0) -> np.ndarray:
    """The mesh in the plane y = 0, its free points off it by random ``noise_m``."""
    height = np.random.default_rng(seed).normal(size=len(mesh.points)) * noise_m
    height[mesh.held] = 0.0
    return np.stack([mesh.points[:, 0], height, -mesh.points[:, 1]], axis=1)


def _settled(model: ClothModel, start: ClothState, parameters: Parameters) -> tuple[np.ndarray, Report]:
    with torch.no_grad():
        state, report = equilibrium(model, start, parameters, tolerance_n=TOLERANCE_N)
    return state.x.numpy(), report


# --- cantilever ------------------------------------------------------------------------------------------------------


def peirce_share(angle_rad: float) -> float:
    """Bending length over overhang of a strip whose tip hangs ``angle_rad`` below its edge (Peirce 1930)."""
    return float((np.cos(0.5 * angle_rad) / (8.0 * np.tan(angle_rad))) ** (1.0 / 3.0))


def bending_length(fabric: Fabric, edge_m: float, *, angle_rad: float, expected_m: float) -> float:
    """Bending length [m] of a strip cut at ``angle_rad`` to the warp, measured as on a Shirley tester.

    A strip twice as long lies over a line, so that symmetry clamps it; the overhang is the one at which
    ``expected_m`` gives the tester's 41.5 degrees, and Peirce's formula takes the angle that it hangs at.
    """
    overhang = expected_m / peirce_share(np.radians(PEIRCE_ANGLE_DEG))
    mesh = strip_mesh(2.0 * overhang, edge_m, line=True)
    model, parameters = simulated(fabric, mesh, angle_rad=angle_rad)
    x, report = _settled(model, model.state(_flat(mesh)), parameters)
    if not report.converged:
        return float("nan")
    shares = []
    for end in (-overhang, overhang):
        tip = x[np.isclose(mesh.points[:, 0], end)].mean(axis=0)
        shares.append(peirce_share(float(np.arctan2(-tip[1], abs(tip[0])))))
    return overhang * float(np.mean(shares))


# --- tensile strip ---------------------------------------------------------------------------------------------------


def stretch_under(modulus_n_per_m: float, load_n_per_m: float) -> float:
    """The stretch l > 1 at which ``modulus`` l (l^2 - 1) / 2 is the load per width."""
    roots = np.roots([1.0, 0.0, -1.0, -2.0 * load_n_per_m / modulus_n_per_m])
    return float(roots.real[np.abs(roots.imag) < 1e-9].max())


def strip_stretch(fabric: Fabric, edge_m: float, *, angle_rad: float, load_n_per_m: float) -> float:
    """Stretch in the middle of a strip (25 by 150 mm) cut at ``angle_rad`` to the warp and pulled at one end."""
    mesh = strip_mesh(STRIP_LENGTH_M, edge_m, line=False)
    model, parameters = simulated(fabric, mesh, angle_rad=angle_rad)
    model.gravity = torch.zeros(3, dtype=torch.float64)
    end = np.isclose(mesh.points[:, 0], 0.5 * STRIP_LENGTH_M)
    order = np.flatnonzero(end)[np.argsort(mesh.points[end, 1])]
    share = np.convolve(np.diff(mesh.points[order, 1]), [0.5, 0.5], mode="full")
    force = np.zeros((len(mesh.points), 3))
    force[order, 0] = load_n_per_m * share
    x, _ = _settled(model, model.state(_flat(mesh)), parameters._replace(force_n=torch.from_numpy(force)))
    gauge = np.abs(mesh.points[:, 0]) < 0.25 * STRIP_LENGTH_M
    at = mesh.points[gauge, 0]
    return float(np.polyfit(at, x[gauge, 0], 1)[0])


# --- Cusick's drape --------------------------------------------------------------------------------------------------


def cusick(fabric: Fabric, edge_m: float, *, seed: int = 0) -> Drape:
    """A disc of 30 cm draped over a pedestal of 18 cm, clamped between plates (BS 5058, ISO 9073-9).

    The cloth starts flat with a random unevenness of 0.1 mm and takes its weight in twenty shares.
    """
    mesh = disc_mesh(edge_m, seed=seed)
    model, parameters = simulated(fabric, mesh)
    weight = model.gravity.clone()
    state = model.state(_flat(mesh, noise_m=1e-4, seed=seed))
    with torch.no_grad():
        for share in SHARES:
            model.gravity = share * weight
            for _ in range(STEPS_PER_SHARE):
                state, _ = newton_step(
                    model,
                    state,
                    parameters,
                    dt_s=SHARE_DT_S,
                    tolerance_n=10.0 * TOLERANCE_N,
                    iteration_limit=SHARE_ITERATIONS,
                )
    x, report = _settled(model, state, parameters)
    return Drape(x, mesh, drape_coefficient(x, mesh.faces), node_count(x, mesh), report)


def drape_coefficient(vertices: np.ndarray, faces: np.ndarray) -> float:
    """100 (shadow - pedestal) / (disc - pedestal) of a draped disc, its shadow cast downwards."""
    half = round(1.02 * DISC_RADIUS_M / SHADOW_PIXEL_M)
    shadow = _covered(vertices[:, [0, 2]] / SHADOW_PIXEL_M + half, faces, 2 * half)
    middle = (np.arange(2 * half) + 0.5 - half) * SHADOW_PIXEL_M
    shadow |= middle[:, None] ** 2 + middle[None] ** 2 < PEDESTAL_RADIUS_M**2
    pedestal = np.pi * PEDESTAL_RADIUS_M**2
    area = SHADOW_PIXEL_M**2 * float(shadow.sum())
    return 100.0 * (area - pedestal) / (np.pi * DISC_RADIUS_M**2 - pedestal)


def _covered(points: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """Pixels (``size``, ``size``) whose middle lies in a triangle of ``points`` [pixels] (V, 2)."""
    pixels = np.zeros((size, size), dtype=bool)
    for a, b, c in points[faces]:
        low = np.maximum(np.floor(np.minimum(np.minimum(a, b), c)).astype(int), 0)
        high = np.minimum(np.ceil(np.maximum(np.maximum(a, b), c)).astype(int), size)
        first, second = b - a, c - a
        area = first[0] * second[1] - first[1] * second[0]
        if area == 0.0:
            continue
        x = (np.arange(low[0], high[0]) + 0.5 - a[0])[:, None]
        y = (np.arange(low[1], high[1]) + 0.5 - a[1])[None]
        u, v = (x * second[1] - y * second[0]) / area, (y * first[0] - x * first[1]) / area
        pixels[low[0] : high[0], low[1] : high[1]] |= (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    return pixels


def node_count(vertices: np.ndarray, mesh: Mesh) -> int:
    """Folds along the rim: maxima of its distance from the axis that stand out by ``NODE_DEPTH_M``."""
    rim = np.flatnonzero(np.linalg.norm(mesh.points, axis=1) > 0.9995 * DISC_RADIUS_M)
    rim = rim[np.argsort(np.arctan2(mesh.points[rim, 1], mesh.points[rim, 0]))]
    radius = np.hypot(vertices[rim, 0], vertices[rim, 2])
    peaks, _ = find_peaks(np.tile(radius, 3), prominence=NODE_DEPTH_M)  # three rounds: the rim has no end
    return int(((peaks >= len(rim)) & (peaks < 2 * len(rim))).sum())
