"""The inputs of a simulation: the sewn mesh, the parameters that it is differentiated by, and the state."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from drape.arrays import check_finite, check_shape
from drape.cloth.material import OrthotropicMaterial
from drape.cloth.membrane import RestTriangles, rest_triangles
from drape.errors import InputError, MeshError
from drape.geometry import meshes
from recovery.sim.assembly import StaticAssembly

SMALLEST_PANEL_SHARE = 1e-9  # of the mean rest triangle


class ClothState(NamedTuple):
    """Positions ``x`` [m] and velocities ``v`` [m/s] (V, 3) of the nodes, float64."""

    x: Tensor
    v: Tensor


class Parameters(NamedTuple):
    """The leaves that a simulation is differentiated by, besides its state; float64.

    ``panels`` [m] (P, 2) rest positions, ``stretch`` [N/m] (4,) = (H00, H01, H11, H22), ``bending_j`` [J]
    () or (H,) per hinge, ``density_kg_m2`` (), ``force_n`` [N] (V, 3) on the nodes.
    """

    panels: Tensor
    stretch: Tensor
    bending_j: Tensor
    density_kg_m2: Tensor
    force_n: Tensor

    @property
    def membrane(self) -> tuple[Tensor, ...]:
        """The stiffness [N/m] of ``drape.cloth.membrane`` along the panels' x and y."""
        h00, h01, h11, h22 = self.stretch
        return h00, h11, h01, 2.0 * h22


class Rest(NamedTuple):
    """Constants that follow from the panels: ``triangles``, ``hinge_weight`` (H,), and ``node_area`` [m^2] (V,)."""

    triangles: RestTriangles
    hinge_weight: Tensor
    node_area: Tensor


class ClothModel:
    """The constants of a sewn mesh: the node of each panel vertex, the elements, and the static maps.

    ``faces`` (F, 3) are nodes of the sewn mesh, ``panel_faces`` (F, 3) the same triangles as vertices of the panels; a
    node on a seam has several. Without ``panel_faces`` the cloth is one panel. ``fixed`` lists nodes that do not move.
    ``rest_angle`` [rad] (H,) of the hinges is zero, and may be set.
    """

    def __init__(
        self,
        faces: np.ndarray,
        *,
        panel_faces: np.ndarray | None = None,
        fixed: np.ndarray | None = None,
        gravity_m_s2: float = 9.81,
    ) -> None:
        self.faces, self.panel_faces = _checked_faces(faces, faces if panel_faces is None else panel_faces)
        self.node_count, self.panel_count = int(self.faces.max()) + 1, int(self.panel_faces.max()) + 1
        self.node_of_panel_vertex = _sewn(self.faces, self.panel_faces)
        self.fixed = _marked(fixed, self.node_count)
        self.free = torch.from_numpy(~self.fixed).to(torch.float64)[:, None]
        self.gravity = torch.tensor([0.0, -gravity_m_s2, 0.0], dtype=torch.float64)
        self.hinge_nodes = hinges = meshes.hinges(self.faces)
        self.rest_angle = torch.zeros(len(hinges), dtype=torch.float64)
        self.assembly = StaticAssembly([self.faces.T, hinges.T], self.node_count, fixed=self.fixed)
        self._face_index, self._panel_index, self._hinge_index = (
            torch.from_numpy(np.ascontiguousarray(corners.T).reshape(-1))
            for corners in (self.faces, self.panel_faces, hinges)
        )
        sides = meshes.hinge_faces(self.faces)
        starts = self.faces[sides]  # (H, 2, 3): each corner of both faces starts an edge
        edges = np.sort(np.stack([starts, np.roll(starts, -1, axis=2)], axis=3), axis=3)
        shared = (edges == np.sort(hinges[:, :2], axis=1)[:, None, None]).all(axis=3)
        self._hinge_edges = torch.from_numpy(shared.argmax(axis=2) * len(self.faces) + sides)
        self._hinge_sides = torch.from_numpy(sides)

    def parameters(self, panels: np.ndarray, material: OrthotropicMaterial) -> Parameters:
        """Tensors of checked numbers, no force given; ask for gradients with ``requires_grad_`` on those you want."""
        panels = np.asarray(panels, dtype=np.float64)
        check_shape("panels", panels, (self.panel_count, 2), error=MeshError)
        check_finite("panels", panels, error=MeshError)
        corners = panels[self.panel_faces]
        area = 0.5 * np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
        if area.min() <= SMALLEST_PANEL_SHARE * area.mean():
            raise MeshError(
                "panels",
                expected="triangles with an area",
                got=f"triangle {int(area.argmin())} of area {area.min():.3g} m^2",
                cure="Remove collapsed triangles of the panel.",
            )
        return Parameters(
            torch.tensor(panels),
            torch.tensor(material.stretch_n_per_m),
            torch.tensor(material.bending_j, dtype=torch.float64),
            torch.tensor(material.density_kg_m2, dtype=torch.float64),
            torch.zeros((self.node_count, 3), dtype=torch.float64),
        )

    def state(self, positions: np.ndarray, velocities: np.ndarray | None = None) -> ClothState:
        """The state at checked ``positions`` [m] (V, 3), at rest unless ``velocities`` [m/s] are given."""
        x = np.asarray(positions, dtype=np.float64)
        v = np.zeros_like(x) if velocities is None else np.asarray(velocities, dtype=np.float64)
        for name, array in (("positions", x), ("velocities", v)):
            check_shape(name, array, (self.node_count, 3))
            check_finite(name, array)
        if v[self.fixed].any():
            raise InputError("velocities", expected="zero at fixed nodes", got="a moving one", cure="Free that node.")
        return ClothState(torch.tensor(x), torch.tensor(v))

    def rest(self, panels: Tensor) -> Rest:
        """Constants of the rest ``panels`` (P, 2); differentiable."""
        a, b, c = _corners(panels, self._panel_index, 3)
        triangles = rest_triangles(b - a, c - a)
        lengths = torch.cat([(end - start).norm(dim=0) for start, end in ((a, b), (b, c), (c, a))])
        edge, area = lengths[self._hinge_edges].mean(dim=1), triangles.area[self._hinge_sides].sum(dim=1)
        zeros = torch.zeros(self.node_count, dtype=panels.dtype)
        node_area = zeros.index_add(0, self._face_index, (triangles.area / 3.0).repeat(3))
        return Rest(triangles, edge * edge / area, node_area)

    def triangles(self, vectors: Tensor) -> Tensor:
        """Corners (3, 3, F) of the triangles from node vectors (V, 3)."""
        return _corners(vectors, self._face_index, 3)

    def hinges(self, vectors: Tensor) -> Tensor:
        """Corners (4, 3, H) of the hinges from node vectors (V, 3)."""
        return _corners(vectors, self._hinge_index, 4)


def _checked_faces(faces: np.ndarray, panel_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as integers. Raises ``MeshError`` if they do not match, are empty, or leave vertices loose."""
    checked = [meshes.check_faces(each, int(np.max(each, initial=-1)) + 1) for each in (faces, panel_faces)]
    if checked[0].shape != checked[1].shape or len(checked[0]) == 0:
        raise MeshError(
            "panel_faces",
            expected=f"one panel triangle for each of {max(len(checked[0]), 1)} or more sewn triangles",
            got=f"{len(checked[1])} for {len(checked[0])}",
            cure="Pass the panels' triangles in the order of the sewn ones.",
        )
    for name, used in zip(("faces", "panel_faces"), checked, strict=True):
        if loose := int(used.max()) + 1 - len(np.unique(used)):
            raise MeshError(
                name,
                expected="every vertex in a triangle",
                got=f"{loose} loose vertices",
                cure="Remove vertices that no triangle uses.",
            )
    return checked[0], checked[1]


def _sewn(faces: np.ndarray, panel_faces: np.ndarray) -> np.ndarray:
    """The node (P,) of every panel vertex. Raises ``MeshError`` if one has two."""
    node_of = np.full(int(panel_faces.max()) + 1, -1)
    node_of[panel_faces.reshape(-1)] = faces.reshape(-1)
    if (node_of[panel_faces] != faces).any():
        raise MeshError(
            "panel_faces",
            expected="every panel vertex sewn to one node",
            got="a panel vertex with two nodes",
            cure="Split that panel vertex.",
        )
    return node_of


def _marked(fixed: np.ndarray | None, count: int) -> np.ndarray:
    """Which of ``count`` nodes are among ``fixed``. Raises ``InputError`` for a node that is none."""
    nodes = np.zeros(0, dtype=np.int64) if fixed is None else np.asarray(fixed, dtype=np.int64)
    if nodes.size and not (nodes.min() >= 0 and nodes.max() < count):
        raise InputError(
            "fixed",
            expected=f"nodes in [0, {count})",
            got=f"[{nodes.min()}, {nodes.max()}]",
            cure="Name nodes of the sewn mesh.",
        )
    return np.isin(np.arange(count), nodes)


def _corners(vectors: Tensor, index: Tensor, count: int) -> Tensor:
    """Corners (count, D, n) of elements from ``vectors`` (V, D) at ``index`` (count * n,), all first corners first."""
    return vectors.T[:, index].reshape(vectors.shape[1], count, -1).transpose(0, 1)
