"""The arrays that the drape graph takes, from a posed body and a garment: one place for export, service and benchmarks.

The graph works relative to the root joint, so that float32 stays precise wherever the
body walks; ``BodyFeed.root`` (float64) is added to what comes out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.features import Kinematics, feature_count, static_features
from drape.body.model import BodyModel
from drape.errors import MotionError
from drape.garment.agreement import agreement, strain_places
from drape.garment.cache import Garment
from drape.geometry import jets
from drape.geometry.rotations import matrix_to_quaternion, rotvec_to_matrix
from drape.push.proximity import patch_skin
from drape.push.skin import body_skin, shaped_skin
from drape.push.tables import outward_directions

BETA_COUNT = 10


@dataclass(frozen=True)
class BodyFeed:
    """Graph inputs of F posed bodies, float32, and the root positions [m] (F, 3) in float64."""

    arrays: dict[str, np.ndarray]
    root: np.ndarray


def body_feed(
    body: BodyModel, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray | None = None, *, skin: bool = False
) -> BodyFeed:
    """Features and bones of ``poses`` (F, 24, 3) [rad] with root translations ``trans`` (F, 3) [m], shape ``betas``.

    Inputs named: ``body_features`` (F, 24 * 9 + 10), ``bone_rotation`` (F, 24, 3, 3),
    ``bone_translation`` (F, 24, 3), ``bone_quaternion`` (F, 24, 4), ``betas`` (F, 10), ``body_joints`` (F, 24, 3) [m];
    with ``skin`` also ``body_skin`` (F, R, 12, 8), its samples (``drape.push.skin``), of bodies that bones pose.
    """
    poses = np.asarray(poses, dtype=np.float64)
    rotations, translations = body.bones(poses, None, betas)
    trans = np.asarray(trans, dtype=np.float64)
    check_shape("trans", trans, (len(poses), 3), error=MotionError)
    check_finite("trans", trans, error=MotionError)
    root_rest = body.rest_joints(betas)[0]
    # The root joint turns about itself, so without translation it stays at its rest place.
    root = trans + root_rest
    relative = translations - root_rest
    shape = np.zeros(BETA_COUNT)
    if betas is not None:
        shape[: body.shape_count] = body.check_betas(betas)[:BETA_COUNT]
    shapes = np.broadcast_to(shape, (len(poses), BETA_COUNT))
    static = static_features(rotvec_to_matrix(poses), rotations).reshape(len(poses), feature_count())
    arrays = {
        "body_features": np.concatenate([static, shapes], axis=1),
        "bone_rotation": rotations,
        "bone_translation": relative,
        "bone_quaternion": matrix_to_quaternion(rotations),
        "betas": shapes,
        "body_joints": (rotations @ body.rest_joints(betas)[..., None])[..., 0] + relative,
    }
    if skin:
        arrays["body_skin"] = shaped_skin(body).table(rotations, relative, shapes)
    return BodyFeed({key: np.ascontiguousarray(value, dtype=np.float32) for key, value in arrays.items()}, root)


def kinematics(body: BodyModel, poses: np.ndarray, trans: np.ndarray, betas: np.ndarray | None = None) -> Kinematics:
    """Where the bodies of ``poses`` (F, 24, 3) [rad] with root translations ``trans`` (F, 3) [m] and shape ``betas``
    are: what ``motion_features`` compares."""
    poses = np.asarray(poses, dtype=np.float64)
    rotations, translations = body.bones(poses, trans, betas)
    joints = (rotations @ body.rest_joints(betas)[..., None])[..., 0] + translations
    return Kinematics(static_features(rotvec_to_matrix(poses), rotations), joints, rotations)


def garment_feed(garment: Garment, *, fine: bool = False, body: BodyModel | None = None) -> dict[str, np.ndarray]:
    """Constant graph inputs of a garment (its embedding excepted).

    Of the delivered vertices, or of all vertices of the subdivided mesh with ``fine``.
    Inputs named: ``patch_centre`` (K, 3), ``patch_rotation`` (K, 3, 3), ``patch_scale`` (K,),
    ``patch_weights`` (K, 24), ``patch_heaviest`` (K,) int64, ``patch_shapedirs`` (K, 3, 10),
    ``chart_patch`` (V, 4) int64, ``chart_weight`` (V, 4), ``chart_basis`` (V, 4, 15), ``chart_local`` (V, 4, 3),
    ``skin_weights`` (V, 24); and of ``drape.garment.agreement``: ``anchor_patch`` (A, 4) int64, ``anchor_row``
    (A, 4, 19) blend weights times [1, rest place, basis], ``patch_member`` (K, 56) int64 and ``patch_slot`` (K, 56),
    ``patch_fit`` (K, 21, 56), ``patch_rest`` (K, 21, 3), ``patch_tangent`` (K, 7, 3, 2), ``patch_orthonormal``
    (K, 7, 2, 2). A graph names those it takes; the paper's variant alone takes skin weights, and none of the last.

    With the ``body`` that the garment was made for also what its patches feel of it (``drape.push.proximity``):
    ``patch_place`` (K, 7, 3) [m], ``patch_cluster`` (K, 10) int64, ``patch_cluster_bias`` (K, 40), ``patch_other``
    (K, R, 12) uint8, ``patch_region_bias`` (K, R).
    """
    count = len(garment.vertices) if fine else garment.vertex_count
    shapedirs = np.zeros((garment.patch_count, 3, BETA_COUNT), dtype=np.float32)
    shapedirs[..., : garment.patch_shapedirs.shape[2]] = garment.patch_shapedirs
    arrays = {
        "patch_centre": garment.patch_centre,
        "patch_rotation": garment.patch_rotation,
        "patch_scale": garment.patch_scale,
        "patch_weights": garment.patch_weights,
        "patch_shapedirs": shapedirs,
        "chart_weight": garment.chart_weight[:count],
        "chart_basis": jets.basis(garment.chart_uv[:count].astype(np.float64), jets.HEIGHT_ORDER),
        "chart_local": garment.chart_local()[:count],
        "skin_weights": garment.skin_weights[:count],
    }
    feed: dict[str, np.ndarray] = {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in arrays.items()}
    feed["patch_heaviest"] = garment.heaviest_bone
    feed |= _agreement_feed(garment) | (_body_feed_of(garment, body) if body is not None else {})
    feed["chart_patch"] = np.ascontiguousarray(garment.chart_patch[:count], dtype=np.int64)
    return feed


def _body_feed_of(garment: Garment, body: BodyModel) -> dict[str, np.ndarray]:
    """What the patches of ``garment`` feel of ``body``."""
    skin = body_skin(body)
    centre = garment.patch_centre.astype(np.float64)
    lists = patch_skin(centre, outward_directions(centre, skin), skin)
    return {
        "patch_place": strain_places(garment.patch_jet, garment.patch_scale).astype(np.float32),
        "patch_cluster": lists.own_cluster.astype(np.int64),
        "patch_cluster_bias": lists.own_bias,
        "patch_other": lists.other,
        "patch_region_bias": lists.region_bias,
    }


def _agreement_feed(garment: Garment) -> dict[str, np.ndarray]:
    """Of the whole subdivided mesh: how charts agree does not depend on which vertices are delivered."""
    local = garment.chart_local()
    tables = agreement(
        garment.chart_patch, garment.chart_uv, garment.chart_weight, local, garment.patch_jet, garment.patch_scale
    )
    anchor = tables.anchor
    basis = jets.basis(garment.chart_uv[anchor].astype(np.float64), jets.HEIGHT_ORDER)
    row = np.concatenate([np.ones((*basis.shape[:2], 1)), local[anchor], basis], axis=-1)
    arrays = {
        "anchor_row": garment.chart_weight[anchor].astype(np.float64)[..., None] * row,
        "patch_fit": tables.fit,
        "patch_rest": tables.rest,
        "patch_tangent": tables.tangent,
        "patch_orthonormal": tables.orthonormal,
    }
    feed: dict[str, np.ndarray] = {key: np.ascontiguousarray(value, dtype=np.float32) for key, value in arrays.items()}
    feed["anchor_patch"] = np.ascontiguousarray(garment.chart_patch[anchor], dtype=np.int64)
    return feed | {"patch_member": tables.member, "patch_slot": tables.slot}
