"""The arrays that the graphs take, from posed bodies and garments: one place for training, export and service.

``drape.graph.inputs`` declares each array. The graphs work relative to the root joint, so that
float32 stays precise wherever the body walks; ``BodyInputs.root`` (float64) is added to what comes out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.features import Kinematics, feature_count, static_features
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.contact.proximity import patch_skin
from drape.contact.push_tables import outward_directions
from drape.contact.skin import Skin, body_skin, shaped_skin
from drape.errors import MotionError
from drape.garment.cache import Atlas, Garment
from drape.garment.consensus import consensus, strain_places
from drape.geometry import jets
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.graph.inputs import BETA_COUNT, PARTS, AgreementTensors, BodyTensors, ChartTensors, PatchTensors


@dataclass(frozen=True)
class BodyInputs:
    """F posed bodies as graphs take them: ``arrays``, float32, the inputs by the names in ``BodyTensors``, and ``root``
    [m] (F, 3), float64, the position in the world that the graph's output of each frame counts from."""

    arrays: dict[str, np.ndarray]
    root: np.ndarray


def body_feed(
    body: BodyModel, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray | None = None, *, skin: bool = False
) -> BodyInputs:
    """Returns the ``BodyTensors`` of F bodies in ``poses`` (F, 24, 3) [rad] with root translations ``trans`` [m] (F,
    3).

    ``betas`` are one shape (S,) for all frames, or one for each (F, S). With ``skin`` the tensors also hold the skin
    samples. Raises ``MotionError`` for translations that are not finite, and ``BodyError`` where ``skin`` is wanted of
    a body with pose blend shapes.
    """
    poses = np.asarray(poses, dtype=np.float64)
    count = len(poses)
    rotations, translations = body.bones(poses, None, betas)
    trans = np.asarray(trans, dtype=np.float64)
    check_shape("trans", trans, (count, 3), error=MotionError)
    check_finite("trans", trans, error=MotionError)
    joints = np.broadcast_to(body.rest_joints(betas), (count, JOINT_COUNT, 3))
    # The root joint turns about itself, so without translation it stays at its rest place.
    relative = translations - joints[:, :1]
    shapes = np.broadcast_to(shape_numbers(body, betas), (count, BETA_COUNT))
    static = static_features(rotvec_to_matrix(poses), rotations).reshape(count, feature_count())
    tensors = BodyTensors(
        features=np.concatenate([static, shapes], axis=1),
        rotation=rotations,
        translation=relative,
        quaternion=matrix_to_quaternion(rotations),
        betas=shapes,
        joints=(rotations @ joints[..., None])[..., 0] + relative,
        skin=shaped_skin(body).table(rotations, relative, shapes) if skin else None,
    )
    return BodyInputs(_arrays(tensors.flat()), trans + joints[:, 0])


def shape_numbers(body: BodyModel, betas: np.ndarray | None) -> np.ndarray:
    """Returns ``betas`` (S,) or (F, S) as graphs take them, (10,) or (F, 10). Shape components that ``body`` does not
    have, or that are not given, are zero."""
    if betas is None:
        return np.zeros(BETA_COUNT)
    betas = np.asarray(betas, dtype=np.float64)
    checked = (body.check_betas(betas) if betas.ndim == 1 else betas)[..., :BETA_COUNT]
    return np.concatenate([checked, np.zeros((*checked.shape[:-1], BETA_COUNT - checked.shape[-1]))], axis=-1)


def kinematics(body: BodyModel, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray | None = None) -> Kinematics:
    """Returns pose features, joints [m] in the world and bone rotations of F frames, float64, for ``poses`` (F, 24, 3)
    [rad], root translations ``trans`` [m] (F, 3), and ``betas``, one shape (S,) or one for each frame (F, S)."""
    poses = np.asarray(poses, dtype=np.float64)
    rotations, translations = body.bones(poses, trans, betas)
    joints = (rotations @ body.rest_joints(betas)[..., None])[..., 0] + translations
    return Kinematics(static_features(rotvec_to_matrix(poses), rotations), joints, rotations)


def garment_feed(garment: Garment, *, fine: bool = False, body: BodyModel | None = None) -> dict[str, np.ndarray]:
    """Returns the constant graph inputs of ``garment`` by name, as ``atlas_feed`` does: of its delivered vertices, or
    with ``fine`` of all vertices of its fine mesh.

    ``body`` is the one that the garment was made for; if given, the skin near the patches is among the inputs.
    """
    count = len(garment.vertices) if fine else garment.vertex_count
    return atlas_feed(garment, count=count, skin=None if body is None else body_skin(body))


def skinning_feed(garment: Garment, body: BodyModel) -> dict[str, np.ndarray]:
    """Returns the input that the paper's variant of the network reads besides ``garment_feed``: ``skin_weights`` (V,
    24), the skinning weights of the delivered vertices."""
    return {"skin_weights": garment.skin_weights(body)[: garment.vertex_count]}


def atlas_feed(atlas: Atlas, *, count: int | None = None, skin: Skin | None = None) -> dict[str, np.ndarray]:
    """Returns the constant graph inputs of a garment's patches by name; its patches' codes, which the network computes,
    are not among them.

    They are ``PatchTensors``, ``ChartTensors`` of the first ``count`` vertices (all by default), and
    ``AgreementTensors``, besides ``patch_slot`` (K, 56) of ``Consensus``. With the ``skin`` of the body that the
    garment was made for, they also hold the skin near its patches. A graph takes some of them by name.
    """
    shapedirs = np.zeros((atlas.patch_count, 3, BETA_COUNT), dtype=np.float32)
    shapedirs[..., : atlas.patch_shapedirs.shape[2]] = atlas.patch_shapedirs
    local, centre = atlas.chart_local(), atlas.patch_centre.astype(np.float64)
    patches = PatchTensors(
        centre=atlas.patch_centre,
        rotation=atlas.patch_rotation,
        scale=atlas.patch_scale,
        weights=atlas.patch_weights,
        heaviest=atlas.heaviest_bone,
        shapedirs=shapedirs,
        place=None if skin is None else strain_places(atlas.patch_jet, atlas.patch_scale),
        skin=None if skin is None else patch_skin(centre, outward_directions(centre, skin), skin),
    )
    charts = ChartTensors(
        patch=atlas.chart_patch[:count],
        weight=atlas.chart_weight[:count],
        basis=jets.basis(atlas.chart_uv[:count].astype(np.float64), jets.HEIGHT_ORDER),
        local=local[:count],
    )
    return _arrays(patches.flat() | charts.flat() | _agreement(atlas, local))


def _agreement(atlas: Atlas, local: np.ndarray) -> dict[str, np.ndarray]:
    """``AgreementTensors`` of the whole subdivided mesh: they do not depend on which vertices are delivered."""
    tables = consensus(atlas.chart_patch, atlas.chart_uv, atlas.chart_weight, local, atlas.patch_jet, atlas.patch_scale)
    anchor = tables.anchor
    basis = jets.basis(atlas.chart_uv[anchor].astype(np.float64), jets.HEIGHT_ORDER)
    row = np.concatenate([np.ones((*basis.shape[:2], 1)), local[anchor], basis], axis=-1)
    tensors = AgreementTensors(
        anchor_patch=atlas.chart_patch[anchor],
        anchor_row=atlas.chart_weight[anchor].astype(np.float64)[..., None] * row,
        member=tables.member,
        fit=tables.fit,
        rest=tables.rest,
        tangent=tables.tangent,
        orthonormal=tables.orthonormal,
    )
    return tensors.flat() | {"patch_slot": tables.slot}


_GROUPS = (BodyTensors, PatchTensors, ChartTensors, AgreementTensors)
_KINDS = {spec.name: spec.dtype for kind in _GROUPS for spec in kind.specs(PARTS)}


def _arrays(found: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``found`` in one piece each, in the types that are declared."""
    return {name: np.ascontiguousarray(value, dtype=_KINDS.get(name, value.dtype)) for name, value in found.items()}
