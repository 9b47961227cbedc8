"""A sewn mesh of cloth: its parameters and state, the energy of all of it with its derivatives, and their matrices.

The formulas of membrane and bending are those of ``drape.cloth.membrane`` and ``drape.cloth.bending``. The mesh never
changes, so static maps assemble it (section 3.4.3 and appendix B of Yu, Cordier and Seo 2024): one constant matrix of
ones sums all element gradients into the nodes, another all element Hessians into the entries of the global matrix,
whose pattern is fixed too. SuperLU factors that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
import torch
from scipy.sparse.linalg import SuperLU, splu
from torch import Tensor

from drape.arrays import check_finite, check_shape
from drape.cloth import bending, membrane
from drape.cloth.material import OrthotropicMaterial
from drape.cloth.membrane import RestTriangles, rest_triangles
from drape.errors import InputError, MeshError
from drape.geometry import meshes

SMALLEST_PANEL_SHARE = 1e-9  # least area of a rest triangle over the mean


class StaticAssembly:
    """Constant sparse maps that sum what single elements have, gradients and Hessians, into that of all nodes.

    ``elements`` has an array (corner, n) of node numbers for each group of elements. The unknowns are numbered ``3 node
    + coordinate``. ``fixed`` (V,), bool, marks nodes that do not move.
    """

    def __init__(self, elements: list[np.ndarray], node_count: int, *, fixed: np.ndarray) -> None:
        self.node_count = node_count
        self.size = 3 * node_count
        self.free = np.repeat(~fixed, 3)
        unknowns = [
            (3 * nodes[:, None] + np.arange(3)[None, :, None]).reshape(-1, nodes.shape[1]) for nodes in elements
        ]
        diagonal = np.arange(self.size).reshape(-1, 3)
        row_groups = [np.broadcast_to(u[:, None], (len(u), *u.shape)) for u in unknowns]
        column_groups = [np.broadcast_to(u[None], (len(u), *u.shape)) for u in unknowns]
        row_groups.append(np.repeat(diagonal[:, :, None], 3, axis=2))
        column_groups.append(np.repeat(diagonal[:, None, :], 3, axis=1))
        # Column-major keys: SuperLU wants CSC, and the pattern is symmetric.
        keys = [(c.reshape(-1) * self.size + r.reshape(-1)) for r, c in zip(row_groups, column_groups, strict=True)]
        pattern, place = np.unique(np.concatenate(keys), return_inverse=True)
        splits = np.cumsum([len(key) for key in keys])[:-1]
        places = np.split(place.reshape(-1), splits)
        self.entry_count = len(pattern)
        self._rows = (pattern % self.size).astype(np.int32)
        columns = pattern // self.size
        self._starts = np.searchsorted(columns, np.arange(self.size + 1)).astype(np.int32)
        self._hessian_maps = [_ones(where, self.entry_count) for where in places[:-1]]
        self._block_places = places[-1].reshape(-1, 3, 3)
        self._gradient_maps = [_ones(u.reshape(-1), self.size) for u in unknowns]
        self._kept = self.free[self._rows] & self.free[columns]
        self._fixed_diagonal = (self._rows == columns) & ~self.free[columns]

    def gradient(self, stacks: list[np.ndarray]) -> np.ndarray:
        """Returns the sum (V, 3) of element gradients; ``stacks`` has an array (corner, 3, n) for each group of
        elements."""
        pairs = zip(self._gradient_maps, stacks, strict=True)
        return sum((ones @ stack.reshape(-1) for ones, stack in pairs), np.zeros(self.size)).reshape(-1, 3)

    def matrix(self, stacks: list[np.ndarray], *, blocks: np.ndarray, scale: float) -> scipy.sparse.csc_matrix:
        """Returns ``scale`` times the sum (3 V, 3 V) of element Hessians, plus ``blocks`` (V, 3, 3) of single nodes.

        ``stacks`` has an array (3 corner, 3 corner, n) for each group of elements. Rows and columns of fixed nodes are
        those of the identity.
        """
        data = np.zeros(self.entry_count)
        for ones, stack in zip(self._hessian_maps, stacks, strict=True):
            data += ones @ stack.reshape(-1)
        data *= scale
        data[self._block_places] += blocks
        data *= self._kept
        data[self._fixed_diagonal] = 1.0
        return scipy.sparse.csc_matrix((data, self._rows, self._starts), shape=(self.size, self.size))


def _ones(target: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """The matrix (count, n) that adds entry i of a vector to ``target[i]``."""
    n = len(target)
    return scipy.sparse.csr_matrix((np.ones(n), (target, np.arange(n))), shape=(count, n))


class SingularMatrix(InputError):
    """The refusal of a matrix without an inverse. Whether a nearly singular one is refused is rounding's choice."""


class Factor:
    """A sparse symmetric matrix A, factored: P A P^T = L U with pivots on its diagonal and a permutation P."""

    def __init__(self, factor: SuperLU) -> None:
        self._factor = factor

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Returns the solution x (n,) of A x = ``rhs`` (n,)."""
        return self._factor.solve(rhs)

    def negative_pivots(self) -> int:
        """Returns the number of negative eigenvalues of A, by Sylvester's law of inertia."""
        return int((self._factor.U.diagonal() < 0.0).sum())


def superlu(matrix: scipy.sparse.csc_matrix) -> Factor:
    """Returns the factors of a symmetric ``matrix``.

    SuperLU runs in its symmetric mode, with an ordering of A^T + A and pivots on the diagonal, in half the time of its
    default. Raises ``InputError`` for numbers that are not finite, ``SingularMatrix`` for a pivot of zero.
    """
    if not np.isfinite(matrix.data).all():
        raise InputError(
            "simulation step",
            expected="finite forces",
            got="NaN or infinity in the system matrix",
            cure="Check the start shape for collapsed triangles, or take a smaller time step.",
        )
    try:
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise SingularMatrix(
            "simulation step",
            expected="a regular system matrix",
            got=str(error),
            cure="Fix some nodes or let the garment touch the body: nothing holds it.",
        ) from error
    return Factor(factor)


class ClothState(NamedTuple):
    """Positions ``x`` [m] and velocities ``v`` [m/s] (V, 3) of the nodes, float64."""

    x: Tensor
    v: Tensor


class Parameters(NamedTuple):
    """The tensors that a simulation is differentiated by, besides its state; float64.

    ``panels`` [m] (P, 2) are rest positions of the panel vertices, ``stretch`` [N/m] (4,) is (H00, H01, H11, H22),
    ``bending_j`` [J] () or (H,) one for each hinge, ``density_kg_m2`` (), ``force_n`` [N] (V, 3) given forces on the
    nodes.
    """

    panels: Tensor
    stretch: Tensor
    bending_j: Tensor
    density_kg_m2: Tensor
    force_n: Tensor

    @property
    def membrane(self) -> tuple[Tensor, ...]:
        """(H00, H11, H01, 2 H22) [N/m], each (): the stiffness along the panels' x and y as ``drape.cloth.membrane``
        takes it."""
        h00, h01, h11, h22 = self.stretch
        return h00, h11, h01, 2.0 * h22


class Rest(NamedTuple):
    """The constants of a cloth that follow from its rest panels: ``triangles``, ``hinge_weight`` (H,), the squared
    length of each hinge over the area of its two triangles, and ``node_area`` [m^2] (V,), a third of the triangles
    about each node."""

    triangles: RestTriangles
    hinge_weight: Tensor
    node_area: Tensor


class ClothModel:
    """The constants of a sewn mesh: the node of each panel vertex, the elements, and their static assembly.

    ``faces`` (F, 3) are nodes of the sewn mesh, ``panel_faces`` (F, 3) the same triangles as vertices of the panels; a
    node on a seam has several. Without ``panel_faces`` the cloth is one panel. ``fixed`` (n,) are numbers of nodes that
    do not move. ``rest_angle`` [rad] (H,), the angle of the hinges at rest, is zero, and may be set.
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
        """Returns the parameters of ``panels`` [m] (P, 2) of a ``material``, without given forces; none requires a
        gradient.

        Raises ``MeshError`` for another shape, numbers that are not finite, and triangles without area.
        """
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
        """Returns the state at ``positions`` [m] (V, 3) with ``velocities`` [m/s] (V, 3), by default zero.

        Raises ``InputError`` for another shape, numbers that are not finite, and a fixed node that moves.
        """
        x = np.asarray(positions, dtype=np.float64)
        v = np.zeros_like(x) if velocities is None else np.asarray(velocities, dtype=np.float64)
        for name, array in (("positions", x), ("velocities", v)):
            check_shape(name, array, (self.node_count, 3))
            check_finite(name, array)
        if v[self.fixed].any():
            raise InputError("velocities", expected="zero at fixed nodes", got="a moving one", cure="Free that node.")
        return ClothState(torch.tensor(x), torch.tensor(v))

    def rest(self, panels: Tensor) -> Rest:
        """Returns the constants of rest ``panels`` [m] (P, 2), differentiable by these."""
        a, b, c = _corners(panels, self._panel_index, 3)
        triangles = rest_triangles(b - a, c - a)
        lengths = torch.cat([(end - start).norm(dim=0) for start, end in ((a, b), (b, c), (c, a))])
        edge, area = lengths[self._hinge_edges].mean(dim=1), triangles.area[self._hinge_sides].sum(dim=1)
        zeros = torch.zeros(self.node_count, dtype=panels.dtype)
        node_area = zeros.index_add(0, self._face_index, (triangles.area / 3.0).repeat(3))
        return Rest(triangles, edge * edge / area, node_area)

    def triangles(self, vectors: Tensor) -> Tensor:
        """Returns ``vectors`` (V, 3) of the nodes at the triangles' corners: (corner, coordinate, F), that is (3, 3,
        F)."""
        return _corners(vectors, self._face_index, 3)

    def hinges(self, vectors: Tensor) -> Tensor:
        """Returns ``vectors`` (V, 3) of the nodes at the hinges' corners: (corner, coordinate, H), that is (4, 3, H).
        The first two corners are the ends of the hinge."""
        return _corners(vectors, self._hinge_index, 4)


def _checked_faces(faces: np.ndarray, panel_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both as integers. Raises ``MeshError`` if they do not match, are empty, or leave vertices loose."""
    checked = [meshes.check_faces(rows, int(np.max(rows, initial=-1)) + 1) for rows in (faces, panel_faces)]
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


def elastic_energy(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> Tensor:
    """Returns the elastic energy [J] () of the cloth with nodes at ``x`` [m] (V, 3)."""
    stretched = membrane.membrane_energy(model.triangles(x), rest.triangles, parameters.membrane)
    return stretched.sum() + bending.bending_energy(model.hinges(x), *_hinges(model, rest, parameters)).sum()


def elastic_forces(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> Tensor:
    """Returns elastic forces [N] (V, 3): minus the derivative of ``elastic_energy`` by ``x`` [m] (V, 3). They have no
    gradient."""
    return -torch.from_numpy(model.assembly.gradient(_numpy(_gradients(model, rest, parameters, x))))


def elastic_hessian(
    model: ClothModel,
    rest: Rest,
    parameters: Parameters,
    x: Tensor,
    *,
    definite: bool,
    scale: float = 1.0,
    blocks: np.ndarray | None = None,
) -> scipy.sparse.csc_matrix:
    """Returns ``scale`` times the second derivative [N/m] (3 V, 3 V) of ``elastic_energy`` by ``x`` [m] (V, 3), plus
    ``blocks`` (V, 3, 3) of single nodes.

    Rows and columns of fixed nodes are those of the identity. ``definite`` makes every element positive semidefinite:
    triangles keep the tensile stress only, hinges are as stiff as unbent ones.
    """
    stretched = membrane.membrane_hessian(model.triangles(x), rest.triangles, parameters.membrane, definite=definite)
    bent = bending.bending_hessian(model.hinges(x), *_hinges(model, rest, parameters), definite=definite)
    blocks = np.zeros((model.node_count, 3, 3)) if blocks is None else blocks
    return model.assembly.matrix(_numpy([stretched, bent]), blocks=blocks, scale=scale)


def elastic_work(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor, direction: Tensor) -> Tensor:
    """Returns the derivative () of ``elastic_energy`` along ``direction`` (V, 3), in [J] for a direction in [m];
    differentiable once more."""
    directions = model.triangles(direction), model.hinges(direction)
    gradients = _gradients(model, rest, parameters, x)
    return torch.stack([(slope * way).sum() for slope, way in zip(gradients, directions, strict=True)]).sum()


def elastic_bilinear(
    model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor, left: Tensor, right: Tensor
) -> Tensor:
    """Returns the number ``left``^T H ``right`` () for the definite ``elastic_hessian`` H at ``x`` [m] and node vectors
    (V, 3), without the matrix; differentiable once more."""
    stretched = membrane.membrane_bilinear(
        model.triangles(x), rest.triangles, parameters.membrane, model.triangles(left), model.triangles(right)
    )
    stiffness_j, _ = _hinges(model, rest, parameters)
    bent = bending.bending_bilinear(model.hinges(x), stiffness_j, model.hinges(left), model.hinges(right))
    return stretched.sum() + bent.sum()


def _gradients(model: ClothModel, rest: Rest, parameters: Parameters, x: Tensor) -> list[Tensor]:
    """Derivatives [N] of ``elastic_energy`` by the corners of triangles (3, 3, F) and hinges (4, 3, H)."""
    return [
        membrane.membrane_gradient(model.triangles(x), rest.triangles, parameters.membrane),
        bending.bending_gradient(model.hinges(x), *_hinges(model, rest, parameters)),
    ]


def _hinges(model: ClothModel, rest: Rest, parameters: Parameters) -> tuple[Tensor, Tensor]:
    """Stiffness [J] and angle at rest [rad] (H,) of the hinges."""
    return parameters.bending_j * rest.hinge_weight, model.rest_angle


def _numpy(stacks: list[Tensor]) -> list[np.ndarray]:
    return [stack.detach().numpy() for stack in stacks]
