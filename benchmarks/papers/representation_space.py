"""What a garment can be draped with: the map from a patch's numbers to vertices, for each form of patch.

All forms share patches, charts and blend; they differ in which polynomials a patch may change, whether it may turn, and
whether bones move its frame rigidly or skin the vertices afterwards.

Every free number of a patch is made equally stiff: a cubic term of the height and a shift of the whole patch differ in
stiffness by orders of magnitude, and L-BFGS needs only some hundred steps where the Hessian is near the identity. So
the numbers of a patch are scaled by a Cholesky factor of its block of an approximate Hessian: the Gram matrix of the
blended polynomials under the cloth's stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.garment.cache import Garment
from drape.garment.fitting import RestGarment, patch_fields
from drape.geometry import jets, meshes
from drape.geometry.rotations import rotvec_to_matrix
from training.sparse import SparsePair, product

LOCAL = 3 * jets.HEIGHT_COUNT  # room for polynomials of order 4 in all three directions
# Stiffness against the membrane's: along the cloth, and across it, where stress and contact hold it.
ALONG, ACROSS = 0.5, 0.15
# Shares of the contact stiffness: most vertices that could touch do not.
HELD_ALONG, HELD_ACROSS = 0.002, 0.3
RIDGE = 1e-6

Sparse = scipy.sparse.csr_matrix


class BlockScaling:
    """Every patch by itself: z (K n,) to numbers (K, n), from Hessian blocks (K, n, n)."""

    def __init__(self, hessian: np.ndarray) -> None:
        size = hessian.shape[2]
        diagonal = np.maximum(np.einsum("kii->ki", hessian), 1e-12)
        factor = np.linalg.cholesky(hessian + RIDGE * diagonal[:, None] * np.eye(size))
        self._onto = _tensor(np.linalg.inv(factor).transpose(0, 2, 1))  # hessian^-1 = onto onto^T
        self._back = _tensor(factor.transpose(0, 2, 1))
        self.size = hessian.shape[0] * size

    def numbers(self, z: Tensor) -> Tensor:
        """The numbers (K, n) of z (K n,)."""
        return (self._onto @ z.reshape(*self._onto.shape[:2], 1))[..., 0]

    def variables(self, numbers: Tensor) -> Tensor:
        """z (K n,) of the numbers (K, n)."""
        return (self._back @ numbers[..., None]).reshape(-1)


def stiffness(vertices: np.ndarray, cloth: ClothMesh, material: Material) -> tuple[Sparse, Sparse]:
    """Approximate Hessians (V, V) [N/m] of the energy in one coordinate, along the cloth and across it."""
    laplacian = cotangent_laplacian(vertices, cloth.faces)
    stretch = material.warp_n_per_m * laplacian
    bend = material.bending_j * (laplacian @ scipy.sparse.diags(1.0 / cloth.vertex_area) @ laplacian)
    held = scipy.sparse.diags(material.contact_j_m4 * cloth.vertex_area)
    return Sparse(ALONG * stretch + HELD_ALONG * held), Sparse(ACROSS * stretch + bend + HELD_ACROSS * held)


def cotangent_laplacian(vertices: np.ndarray, faces: np.ndarray) -> Sparse:
    """Positive semidefinite (V, V): ``f^T L f`` is the integral of |grad f|^2; obtuse corners count as right angles."""
    start, end, opposite = meshes.half_edges(np.asarray(faces)).T
    a, b = vertices[start] - vertices[opposite], vertices[end] - vertices[opposite]
    cotangent = np.sum(a * b, axis=1) / np.maximum(np.linalg.norm(np.cross(a, b), axis=1), 1e-15)
    graph = Sparse((0.5 * np.maximum(cotangent, 0.0), (start, end)), shape=(len(vertices),) * 2)
    graph = graph + graph.T
    return Sparse(scipy.sparse.diags(np.asarray(graph.sum(axis=1)).ravel()) - graph)


def gram_blocks(shapes: Sparse, along: Sparse, across: Sparse) -> np.ndarray:
    """Blocks (K, 45, 45) of ``shapes^T stiffness shapes`` (V, 15 K): twice ``along`` the patch, once ``across``."""
    count, columns = jets.HEIGHT_COUNT, shapes.tocsc()
    found = np.zeros(((len(columns.indptr) - 1) // count, LOCAL, LOCAL))
    for k, block in enumerate(found):
        own = columns[:, k * count : (k + 1) * count]
        rows = np.unique(own.indices)
        dense = own[rows].toarray()
        flat = dense.T @ (along[rows][:, rows] @ dense)
        block[:count, :count] = block[count : 2 * count, count : 2 * count] = flat
        block[2 * count :, 2 * count :] = dense.T @ (across[rows][:, rows] @ dense)
    return found


CPU = torch.device("cpu")
SIZE = jets.HEIGHT_COUNT


@dataclass(frozen=True)
class Representation:
    """A form of patch. ``plane_order``: of the in-plane polynomials, None for translation and scale alone;
    ``turns``: a free rotation; ``skinned``: patches move in the rest pose and the vertices are skinned after.
    """

    name: str
    plane_order: int | None
    turns: bool = False
    skinned: bool = False

    @property
    def number_count(self) -> int:
        """Free numbers per patch. The paper's shift along the normal is the height's constant, so it has 18, not 19."""
        plane = 3 if self.plane_order is None else 2 * jets.coefficient_count(self.plane_order)
        return plane + SIZE + 3 * self.turns


REPRESENTATIONS = {
    form.name: form
    for form in (
        Representation("paper", None, skinned=True),
        Representation("paper_turning", None, turns=True, skinned=True),
        Representation("skinned_2", 2, skinned=True),
        Representation("rigid_1", 1),
        Representation("rigid_2", 2),
        Representation("rigid_3", 3),
    )
}


@dataclass(frozen=True, eq=False)
class Charts:
    """The constants of one partition into K patches that all forms share.

    ``rotation`` (K, 3, 3), ``centre`` (K, 3) [m], ``bones`` (K, 24) of the rest frames, ``rest_jet`` (K, 27);
    ``patch``, ``weight`` (V, 4); ``gram`` (K, 45, 45) [J] the Hessian's blocks; ``blend`` (V, 18 K) the weighted mean
    of what the charts say of a vertex relative to their patches' centres, rest place first.
    """

    rotation: np.ndarray
    centre: np.ndarray
    bones: np.ndarray
    rest_jet: np.ndarray
    patch: np.ndarray
    weight: np.ndarray
    gram: np.ndarray
    blend: SparsePair

    @property
    def patch_count(self) -> int:
        return len(self.centre)


PARTITION = (
    "patch_rotation", "patch_centre", "patch_scale", "patch_jet", "patch_weights",
    "chart_patch", "chart_uv", "chart_weight", "chart_residual",
)  # fmt: skip


def repartitioned(garment: Garment, rest: RestGarment, count: int, *, seed: int = 0) -> Garment:
    """``garment`` with another partition of ``rest``, into ``count`` patches, as intake makes it."""
    return replace(garment, **patch_fields(rest, count=count, seed=seed))


def charts(garment: Garment, cloth: ClothMesh, material: Material) -> Charts:
    """The constants of the partition of ``garment``."""
    fields = {name: np.asarray(getattr(garment, name)) for name in PARTITION}
    fields = {key: v.astype(np.float64) if v.dtype.kind == "f" else v for key, v in fields.items()}
    patch, weight, uv = fields["chart_patch"].astype(np.int64), fields["chart_weight"], fields["chart_uv"]
    weight = weight / weight.sum(axis=1, keepdims=True)
    scale = fields["patch_scale"][patch][..., None]
    place = scale * jets.evaluate(fields["patch_jet"][patch], uv) + fields["chart_residual"]
    basis = scale * jets.basis(uv, jets.HEIGHT_ORDER)
    shapes, said = _sparse(patch, basis), _sparse(patch, np.concatenate([place, basis], axis=-1))
    entries, slots = weight.size, weight.shape[1]
    mean = Sparse((weight.ravel(), np.arange(entries), np.arange(0, entries + 1, slots)), shape=(len(patch), entries))
    along, across = stiffness(garment.vertices.astype(np.float64), cloth, material)
    return Charts(
        rotation=fields["patch_rotation"],
        centre=fields["patch_centre"],
        bones=fields["patch_weights"],
        rest_jet=fields["patch_jet"],
        patch=patch,
        weight=weight,
        gram=gram_blocks(Sparse(mean @ shapes), along, across),
        blend=SparsePair.from_scipy(Sparse(mean @ said), device=CPU),
    )


def _sparse(patch: np.ndarray, values: np.ndarray) -> Sparse:
    """(4 V, n K): row 4 v + slot holds ``values`` (V, 4, n) in the n columns of its ``patch`` (V, 4)."""
    width = values.shape[-1]
    columns = patch[..., None] * width + np.arange(width)
    bounds = np.arange(0, values.size + 1, width)
    return scipy.sparse.csr_matrix(
        (values.ravel(), columns.ravel(), bounds), shape=(patch.size, (int(patch.max()) + 1) * width)
    )


def embedding(form: Representation, rest_jet: np.ndarray) -> np.ndarray:
    """Coefficients (K, 45, n) in all three directions, [patch scales], of a form's n free numbers.

    A turn's columns are those of a small one; ``PatchSpace`` turns the patch by the full angle.
    """
    unit = np.eye(LOCAL)
    p, q, h = np.zeros((3, len(rest_jet), LOCAL))
    for found, start, part in zip((p, q, h), (0, SIZE, 2 * SIZE), jets.unpack(rest_jet), strict=True):
        found[:, start : start + part.shape[1]] = part
    order = form.plane_order
    plane_count = 1 if order is None else jets.coefficient_count(order)
    fixed = [unit[2 * SIZE + i] for i in range(SIZE)] + [unit[c * SIZE + i] for c in (0, 1) for i in range(plane_count)]
    columns = [np.broadcast_to(column, p.shape) for column in fixed]
    if order is None:
        columns.append(p + q)  # the scale; that of the height is among the height's coefficients
    if form.turns:
        # e x (p, q, h) for the three axes e: each part moves into the place of another.
        columns.append(np.roll(q, SIZE, axis=1) - np.roll(h, -SIZE, axis=1))
        columns.append(np.roll(h, -2 * SIZE, axis=1) - np.roll(p, 2 * SIZE, axis=1))
        columns.append(np.roll(p, SIZE, axis=1) - np.roll(q, -SIZE, axis=1))
    return np.stack(columns, axis=-1)


def block_scaling(form: Representation, found: Charts) -> BlockScaling:
    """The scaling of every patch by itself, the same in all frames."""
    columns = embedding(form, found.rest_jet)
    return BlockScaling(columns.transpose(0, 2, 1) @ found.gram @ columns)


class PatchSpace:
    """The drapes of one frame that a form can make: scaled variables z (K n,) to vertices.

    ``rotation`` (K, 3, 3), ``centre`` (K, 3) [m] are the frames that the patches move in; with ``skin`` =
    (matrices (V, 3, 3), translations (V, 3)) the vertices are skinned afterwards.
    """

    def __init__(
        self,
        form: Representation,
        found: Charts,
        rotation: np.ndarray,
        centre: np.ndarray,
        scaling: BlockScaling,
        *,
        skin: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> None:
        self.charts, self.scaling, self.size = found, scaling, scaling.size
        self._turns = 3 * form.turns
        self._columns = _tensor(embedding(form, found.rest_jet)[:, :, : form.number_count - self._turns])
        self._frame = _tensor(rotation)
        centres = _tensor(centre)[torch.from_numpy(found.patch)]  # (V, 4, 3)
        self._middle = (_tensor(found.weight)[..., None] * centres).sum(dim=1)
        self._skin = None if skin is None else (_tensor(skin[0]), _tensor(skin[1]))

    def positions(self, z: Tensor) -> Tensor:
        """Vertices [m] (V, 3) in the world."""
        numbers = self.scaling.numbers(z)
        jet_count = numbers.shape[1] - self._turns
        local = (self._columns @ numbers[:, :jet_count, None]).reshape(-1, 3, SIZE).mT
        turned = self._frame
        if self._turns:
            turned = turned @ rotvec_to_matrix(numbers[:, jet_count:])
        # World rows (18 K, 3): per patch the turned frame, then the coefficients in the world's directions.
        rows = torch.cat([turned.mT, local @ turned.mT], dim=1).reshape(-1, 3)
        rest = self._middle + product(self.charts.blend, rows)
        if self._skin is None:
            return rest
        matrices, translations = self._skin
        return (matrices @ rest[..., None])[..., 0] + translations


class VertexSpace:
    """Every vertex free: z (3 V,) to vertices near ``start`` [m] (V, 3), scaled by ``vertex_stiffness`` [N/m] (V,)."""

    def __init__(self, start: np.ndarray, vertex_stiffness: np.ndarray) -> None:
        self._start = _tensor(start)
        self._scale = _tensor(1.0 / np.sqrt(vertex_stiffness))[:, None]
        self.size = start.size

    def positions(self, z: Tensor) -> Tensor:
        """Vertices [m] (V, 3) in the world."""
        return self._start + self._scale * z.reshape(-1, 3)


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
