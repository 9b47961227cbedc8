"""Garments and bodies as the training loop takes them: random partitions, and batches of posed bodies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse
import torch
from torch import Tensor

from drape.body.features import static_features
from drape.body.model import BodyModel
from drape.cloth.energies import ClothMesh
from drape.garment.agreement import agreement, strain_places
from drape.garment.fitting import RestGarment, patch_fields
from drape.geometry import jets
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.graph.feeds import BETA_COUNT
from drape.push.proximity import PatchSkin, patch_skin
from drape.push.skin import Skin, shaped_skin
from drape.push.tables import outward_directions
from training.agreement import SparseAgreement
from training.collider import Collider
from training.model import BodyTensors, PatchTensors
from training.poses import pose_bodies, posed_joints
from training.sparse import SparsePair

COEFFICIENTS = 1 + 3 + jets.HEIGHT_COUNT  # rows of model.posed_coefficients


@dataclass(frozen=True, eq=False)
class Partition:
    """One partition of a garment on the device: patches, features, and the blend (V, 19 K) as a sparse matrix."""

    patches: PatchTensors
    features: Tensor
    blend: SparsePair
    chart_patch: Tensor
    chart_weight: Tensor
    chart_row: Tensor  # (V, 4, 19): [1, rest position in the patch frame, basis]
    agreement: SparseAgreement


@dataclass(frozen=True, eq=False)
class TrainingGarment:
    """A garment with its cloth constants and the partitions at hand, with their seeds."""

    name: str
    rest: RestGarment
    cloth: ClothMesh
    partitions: list[Partition]
    skin_weights: Tensor
    seeds: list[int] = field(default_factory=list)
    band: tuple[Tensor, Tensor] | None = None  # vertices (n,) and lengths [m] (n,) of drape.cloth.waistband


@dataclass(frozen=True, eq=False)
class BodyBatch:
    """Posed bodies for the network, and their collider for contact."""

    tensors: BodyTensors
    collider: np.ndarray  # (F, C, 3) root-relative [m]
    collider_normals: np.ndarray  # (F, C, 3)


def draw_partition(
    rest: RestGarment, skin: Skin, *, seed: int, span: tuple[float, float], device: torch.device
) -> Partition:
    """A random partition; its patch count over the rule's lies in ``span``, evenly in the logarithm."""
    share = float(np.exp(np.random.default_rng(seed).uniform(*np.log(span))))
    return partition_tensors(patch_fields(rest, share=share, seed=seed), skin, device=device)


def partition_tensors(fields: dict[str, np.ndarray], skin: Skin, *, device: torch.device) -> Partition:
    """The patch and chart fields of a garment as tensors; ``skin`` is that of the body it was made for."""
    uv = fields["chart_uv"].astype(np.float64)
    patch, weight = fields["chart_patch"], fields["chart_weight"].astype(np.float64)
    scale = fields["patch_scale"].astype(np.float64)
    local = (
        scale[patch][..., None] * jets.evaluate(fields["patch_jet"].astype(np.float64)[patch], uv)
        + fields["chart_residual"]
    )
    row = np.concatenate([np.ones((*uv.shape[:-1], 1)), local, jets.basis(uv, jets.HEIGHT_ORDER)], axis=-1)
    vertex_count, patch_count = len(patch), len(scale)
    columns = patch[..., None].astype(np.int64) * COEFFICIENTS + np.arange(COEFFICIENTS)
    rows = np.broadcast_to(np.arange(vertex_count)[:, None, None], columns.shape)
    blend = scipy.sparse.csr_matrix(
        ((weight[..., None] * row).ravel(), (rows.ravel(), columns.ravel())),
        shape=(vertex_count, patch_count * COEFFICIENTS),
    )
    blend.sum_duplicates()
    blend.eliminate_zeros()
    tables = agreement(patch, uv, weight, local, fields["patch_jet"], scale)
    shapedirs = np.zeros((patch_count, 3, BETA_COUNT), dtype=np.float32)
    shapedirs[..., : fields["patch_shapedirs"].shape[2]] = fields["patch_shapedirs"]

    centre = fields["patch_centre"].astype(np.float64)
    near = patch_skin(centre, outward_directions(centre, skin), skin)
    place = strain_places(fields["patch_jet"], scale)

    def tensor(array: np.ndarray) -> Tensor:
        kind = np.int64 if array.dtype.kind in "iu" else np.float32
        return torch.from_numpy(np.ascontiguousarray(array, dtype=kind)).to(device)

    return Partition(
        patches=PatchTensors(
            centre=tensor(fields["patch_centre"]),
            rotation=tensor(fields["patch_rotation"]),
            scale=tensor(fields["patch_scale"]),
            weights=tensor(fields["patch_weights"]),
            heaviest=tensor(np.argmax(fields["patch_weights"], axis=1)),
            shapedirs=tensor(shapedirs),
            place=tensor(place),
            skin=PatchSkin(
                tensor(near.own_cluster),
                tensor(near.own_bias),
                torch.from_numpy(near.other).to(device),
                tensor(near.region_bias),
            ),
        ),
        features=tensor(fields["patch_features"]),
        blend=SparsePair.from_scipy(blend, device=device),
        chart_patch=tensor(patch),
        chart_weight=tensor(weight),
        chart_row=tensor(row),
        agreement=SparseAgreement.of(tables, blend, device=device),
    )


class BodySource:
    """Turns poses and shapes into what network and contact need."""

    def __init__(self, body: BodyModel, *, device: torch.device) -> None:
        self.body = body
        self.device = device
        self._collider = Collider(body)
        self._skin = shaped_skin(body)

    def pose(self, poses: np.ndarray, betas: np.ndarray) -> BodyBatch:
        """A batch from poses (F, 24, 3) [rad] and shapes (F, S)."""
        count = len(poses)
        rotations, translations = pose_bodies(self.body, poses, betas)
        static = static_features(rotvec_to_matrix(poses), rotations).reshape(count, -1)
        shapes = np.zeros((count, BETA_COUNT))
        shapes[:, : betas.shape[1]] = betas[:, :BETA_COUNT]

        def tensor(array: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(self.device)

        tensors = BodyTensors(
            features=tensor(np.concatenate([static, shapes], axis=1)),
            rotation=tensor(rotations),
            translation=tensor(translations),
            quaternion=tensor(matrix_to_quaternion(rotations)),
            betas=tensor(shapes),
            joints=tensor(posed_joints(self.body, rotations, translations, betas)),
            skin=tensor(self._skin.table(rotations, translations, shapes)),
        )
        collider = self._collider.posed(rotations, translations, betas)
        return BodyBatch(tensors, collider, self._collider.normals(collider))
