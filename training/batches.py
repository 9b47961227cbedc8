"""Garments and bodies as the training loop takes them: random partitions, and batches of posed bodies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from drape.body.model import BodyModel
from drape.cloth.contact import DETAIL_JOINTS
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric import Fabric
from drape.contact.skin import Skin
from drape.garment.cache import Atlas
from drape.garment.fabric_features import fabric_features, patch_grain
from drape.garment.fitting import RestGarment, patch_fields
from drape.geometry import meshes
from drape.graph.feeds import atlas_feed, body_feed
from drape.graph.inputs import BodyTensors, PatchTensors
from training.chart_consensus import SparseConsensus, SparsePair, blend_matrix


@dataclass(frozen=True, eq=False)
class Partition:
    """One partition of a garment into K patches, as tensors on the device: the patches, their ``features`` (K, D), and
    the ``blend`` (V, 19 K), a sparse matrix from ``onefit.posed_coefficients`` to vertices.

    Each vertex has four charts: ``chart_patch`` (V, 4) are their patches, ``chart_weight`` (V, 4) their weights in the
    blend, and ``chart_row`` (V, 4, 19) what multiplies a patch's coefficients, [1, rest position in the patch frame,
    basis]. ``grain`` (K, 2) is that of ``drape.garment.fabric_features.patch_grain``.
    """

    patches: PatchTensors
    features: Tensor
    blend: SparsePair
    chart_patch: Tensor
    chart_weight: Tensor
    chart_row: Tensor  # (V, 4, 19): [1, rest position in the patch frame, basis]
    consensus: SparseConsensus
    grain: np.ndarray

    def encoder_inputs(self, fabric: Fabric | None) -> Tensor:
        """Returns the inputs (K, D) of the garment encoder for the partition in ``fabric``. ``fabric`` is None for a
        network that knows no fabrics."""
        if fabric is None:
            return self.features
        of_fabric = torch.from_numpy(fabric_features(fabric, self.grain)).to(self.features.device)
        return torch.cat([self.features, of_fabric], dim=1)


@dataclass(frozen=True, eq=False)
class TrainingGarment:
    """A garment at rest with the constants of its cloth, its ``partitions`` at hand, and the random ``seeds`` that each
    of these was drawn from.

    ``skin_weights`` (V, 24) are those of its vertices, ``warp`` (F, 3) is the unit direction of the warp on each
    triangle at rest. ``band`` has the vertices (n,) and lengths [m] (n,) of the waistband (``drape.cloth.waistband``),
    and is None for a garment without one.
    """

    name: str
    rest: RestGarment
    cloth: ClothMesh
    partitions: list[Partition]
    skin_weights: Tensor
    seeds: list[int] = field(default_factory=list)
    warp: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (F, 3) at rest
    band: tuple[Tensor, Tensor] | None = None  # vertices (n,) and lengths [m] (n,) of drape.cloth.waistband


@dataclass(frozen=True, eq=False)
class BodyBatch:
    """F posed bodies: the network's inputs ``tensors``, and the surface that cloth touches, its vertices ``collider``
    [m] (F, C, 3) relative to the root joint and their unit normals (F, C, 3)."""

    tensors: BodyTensors
    collider: np.ndarray
    collider_normals: np.ndarray


def draw_partition(
    rest: RestGarment, skin: Skin, *, seed: int, span: tuple[float, float], device: torch.device, warp: np.ndarray
) -> Partition:
    """Returns the partition of ``rest`` that ``seed`` draws. Its number of patches is a factor from ``span``, drawn
    evenly in the logarithm, times the number that intake takes.

    ``warp`` (F, 3) is the unit direction of the warp on each triangle at rest.
    """
    share = float(np.exp(np.random.default_rng(seed).uniform(*np.log(span))))
    atlas = Atlas(**patch_fields(rest, share=share, seed=seed))
    return partition_tensors(atlas, skin, device=device, grain=patch_grain(atlas, rest.vertices, rest.faces, warp))


def partition_tensors(atlas: Atlas, skin: Skin, *, device: torch.device, grain: np.ndarray | None = None) -> Partition:
    """Returns the patches and charts of ``atlas`` as tensors on ``device``; ``skin`` is that of the standard body.

    ``grain`` (K, 2) is zeros by default: warp and weft of a fabric then do not differ.
    """
    feed = atlas_feed(atlas, skin=skin)
    row = np.concatenate(
        [np.ones_like(feed["chart_local"][..., :1]), feed["chart_local"], feed["chart_basis"]], axis=-1
    )
    weighted = feed["chart_weight"][..., None] * row
    tensors = on_device(feed | {"row": row, "features": atlas.patch_features}, device)
    return Partition(
        patches=PatchTensors.from_flat(tensors),
        features=tensors["features"],
        blend=SparsePair.from_scipy(blend_matrix(feed["chart_patch"], weighted, atlas.patch_count), device=device),
        chart_patch=tensors["chart_patch"],
        chart_weight=tensors["chart_weight"],
        chart_row=tensors["row"],
        consensus=SparseConsensus.of(feed, device=device),
        grain=np.zeros((atlas.patch_count, 2)) if grain is None else grain,
    )


def on_device(arrays: Mapping[str, np.ndarray], device: torch.device) -> dict[str, Tensor]:
    """Returns ``arrays`` as tensors of the same types on ``device``."""
    return {name: torch.from_numpy(array).to(device) for name, array in arrays.items()}


class BodySource:
    """Poses ``body``: it makes batches of posed bodies on ``device``."""

    def __init__(self, body: BodyModel, *, device: torch.device) -> None:
        self.body = body
        self.device = device
        self._collider = BodySurface(body)

    def pose(self, poses: np.ndarray, betas: np.ndarray) -> BodyBatch:
        """Returns the bodies of shapes ``betas`` (F, S) in ``poses`` (F, 24, 3) [rad]."""
        feed = body_feed(self.body, poses, np.zeros((len(poses), 3)), betas, skin=True).arrays
        collider = self._collider.posed(feed["bone_rotation"], feed["bone_translation"], betas)
        tensors = BodyTensors.from_flat(on_device(feed, self.device))
        return BodyBatch(tensors, collider, self._collider.normals(collider))


class BodySurface:
    """The body's surface without head, hands and toes: C vertices, linearly skinned.

    Arrays within have coordinates first: products of few rows and many columns are nine times as fast as
    ``drape.geometry.skinning``.
    """

    def __init__(self, body: BodyModel) -> None:
        self.index, self.faces = _surface(body)
        count = len(self.index)
        self._rest = np.ascontiguousarray(body.v_template[self.index].T.astype(np.float32))  # (3, C)
        self._shapedirs = body.shapedirs[self.index].transpose(1, 0, 2).reshape(3 * count, -1).astype(np.float32)
        self._weights = np.ascontiguousarray(body.weights[self.index].T.astype(np.float32))  # (J, C)
        self._table = meshes.face_table(self.faces, count)

    def posed(self, rotations: np.ndarray, translations: np.ndarray, betas: np.ndarray) -> np.ndarray:
        """Returns the vertices [m] (F, C, 3), float32, of bodies of shapes ``betas`` (F, S), moved by the bones'
        ``rotations`` (F, J, 3, 3) and ``translations`` [m] (F, J, 3)."""
        stacked = np.concatenate([rotations, translations[..., None]], axis=-1).astype(np.float32)  # (F, J, 3, 4)
        out = np.empty((len(stacked), self._rest.shape[1], 3), dtype=np.float32)
        for frame, (bones, shape) in enumerate(zip(stacked, betas.astype(np.float32), strict=True)):
            blended = (bones.reshape(len(bones), 12).T @ self._weights).reshape(3, 4, -1)
            x, y, z = self._rest + (self._shapedirs @ shape).reshape(3, -1) if np.any(shape) else self._rest
            for axis, (by_x, by_y, by_z, moved) in enumerate(blended):
                out[frame, :, axis] = by_x * x + by_y * y + by_z * z + moved
        return out

    def normals(self, posed: np.ndarray) -> np.ndarray:
        """Returns the unit normals (F, C, 3) at the vertices ``posed`` [m] (F, C, 3): means over faces, by area."""
        return meshes.vertex_normals(posed, self.faces, table=self._table)


def _surface(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Body vertices (C,) that training collides with and their faces (T, 3): all but head, hands and toes."""
    plain = body.weights[:, DETAIL_JOINTS].sum(axis=1) <= 0.5
    return meshes.in_use(body.faces[plain[body.faces].all(axis=1)])
