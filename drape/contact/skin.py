"""The body's skin as samples with smooth normals, which cloth is kept out of.

Samples are spread evenly over the skin, closer on thin limbs. The point and the two tangents of a sample are sums over
body vertices with fixed weights: they follow any pose and shape of the body exactly. On a linearly skinned body they
are sums over its bones as well, and one small product poses them all.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np

from drape.arrays import Array, namespace
from drape.arrays.tensors import Tensors, tensor
from drape.body.model import BodyModel
from drape.body.skeleton import BONE_ENDS, JOINT_COUNT, JOINT_NAMES
from drape.cloth.contact import OPENING_M
from drape.contact.field import take
from drape.contact.samples import (
    POSED_REGIONS,
    REGION_SIZE,
    Samples,
    at_rest,
    place,
    ring_operator,
    sample_table,
    table_of_columns,
    unit_cross,
)
from drape.errors import BodyError
from drape.geometry import closest

SPACING_LIMITS_M = (0.012, 0.020)
SPACING_PER_RADIUS = 0.55  # so a limb of any thickness has eleven samples around it, within the limits
HEAD_SPACING_M, FOOT_SPACING_M = 0.025, 0.014  # a heel and the edge of a sole turn within a centimetre or two
HEAD = JOINT_NAMES.index("head")
FEET = tuple(i for i, name in enumerate(JOINT_NAMES) if name.endswith(("ankle", "foot")))


class Skin(Samples):
    """The samples of a body's skin in T-pose."""

    def on_bones(self, body: BodyModel, betas: np.ndarray | None = None) -> SkinOnBones:
        """Returns the samples of ``body`` in the shape ``betas`` (S,) as weighted sums over bones.

        Raises ``BodyError`` for a body with pose blend shapes, which bones alone do not carry.
        """
        if body.posedirs is not None:
            raise BodyError(
                f"body {body.name}",
                expected="linear blend skinning only",
                got="pose blend shapes",
                cure="Pose the samples from the posed body vertices.",
            )
        rest = body.rest_vertices(betas)
        moments = [self.operator @ (body.weights * rest[:, axis : axis + 1]) for axis in range(3)]
        dense = np.stack([*moments, self.operator @ body.weights], axis=-1)  # (3 S, 24, 4)
        parts, size = self.region_count // POSED_REGIONS, POSED_REGIONS * REGION_SIZE
        regions = dense.reshape(3, parts, size, JOINT_COUNT, 4).transpose(1, 0, 2, 3, 4)
        weights = (self.operator @ body.weights).reshape(3, parts, size, JOINT_COUNT)
        used = np.abs(weights).max(axis=(0, 2)) > 0.0  # (P, 24), of the weights: the same for all shapes
        count = int(used.sum(axis=1).max())
        bones = np.argsort(~used, axis=1, kind="stable")[:, :count]
        kept = np.take_along_axis(regions, bones[:, None, None, :, None], axis=3)
        rows = np.ascontiguousarray(kept.reshape(parts, 3 * size, count, 4).transpose(0, 2, 3, 1))
        return SkinOnBones(rows.astype(np.float32), bones.astype(np.int32))


@dataclass(frozen=True, eq=False)
class SkinOnBones(Tensors):
    """The samples of a linearly skinned body of one shape as products with bone transforms, in P parts of 4 regions.

    The samples of part p are moved by its n ``bones`` (P, n) alone. ``rows`` (P, n, 4, 144) are their factors with the
    bone's rotation (first three) and translation (last one): for 48 points, 48 first and 48 second tangents.
    """

    rows: Array = tensor("skin_rows", "parts", "part_bones", 4, 3 * POSED_REGIONS * REGION_SIZE, unit="m or 1")
    bones: Array = tensor("skin_bones", "parts", "part_bones", dtype="int32", unit="bone index")


class ShapedSkin:
    """The samples of ``body`` as ``SkinOnBones`` in any shape: the rows are linear in the shape components.

    Of the bones of each part the first ``counts`` (P,) move it; the others have rows of zeros.
    """

    def __init__(self, body: BodyModel) -> None:
        skin = body_skin(body)
        plain = skin.on_bones(body)
        units = np.eye(body.shape_count) if body.shapedirs.any() else ()  # a character has one shape
        changes = [skin.on_bones(body, unit).rows - plain.rows for unit in units]
        self.bones = plain.bones
        self.rows = np.stack([plain.rows, *changes])  # (1 + shapes, P, n, 4, 144)
        self.counts = self.rows.any(axis=(0, 3, 4)).sum(axis=1).astype(np.int32)

    def of(self, betas: np.ndarray) -> np.ndarray:
        """Returns ``SkinOnBones.rows`` of each of U shapes, (U, P, n, 4, 144) float32. ``betas`` (U, >= shapes) may
        have more numbers than the body has shapes."""
        return self.rows[0] + np.tensordot(betas[:, : len(self.rows) - 1].astype(np.float32), self.rows[1:], axes=1)

    def table(self, rotations: np.ndarray, translations: np.ndarray, betas: np.ndarray) -> np.ndarray:
        """Returns the samples of F posed bodies as ``skin_table`` (F, R, 12, 8) float32, for bone ``rotations`` (F, 24,
        3, 3), ``translations`` [m] (F, 24, 3) and shapes ``betas`` (F, >= shapes)."""
        rotations, translations = rotations.astype(np.float32), translations.astype(np.float32)
        shaped = np.asarray(betas.any(axis=1))
        plain = skin_table(self.rows[0], self.bones, rotations[~shaped], translations[~shaped])
        if not shaped.any():
            return plain
        # Rows of a shape are ten times what a frame needs, so they are computed only for bodies that have one.
        found = np.empty((len(shaped), *plain.shape[1:]), dtype=plain.dtype)
        found[~shaped] = plain
        found[shaped] = skin_table(self.of(betas[shaped]), self.bones, rotations[shaped], translations[shaped])
        return found


def skin_table(rows: Array, bones: Array, rotations: Array, translations: Array) -> Array:
    """Returns the rows of ``sample_table`` by region, (F, R, 12, 8), of bodies posed by bone ``rotations`` (F, 24, 3,
    3) and ``translations`` [m] (F, 24, 3), in the frame of these.

    ``rows`` and ``bones`` are those of ``SkinOnBones``; ``rows`` may have an axis of frames before its own.
    """
    xp = namespace(rows)
    stacked = xp.concat([rotations, translations[..., None]], axis=-1)  # (F, 24, 3, 4)
    parts, count = bones.shape
    by_axis = xp.reshape(xp.permute_dims(stacked, (0, 2, 1, 3)), (-1, JOINT_COUNT, 4))
    taken = take(by_axis, xp.reshape(bones, (-1,)), axis=1)
    # Three rows times many columns, because products of small matrices are fast in this shape.
    width, size = 4 * count, POSED_REGIONS * REGION_SIZE
    of_parts = xp.permute_dims(xp.reshape(taken, (-1, 3, parts, width)), (0, 2, 1, 3))
    posed = of_parts @ xp.reshape(rows, (-1, parts, width, 3 * size))
    # All samples of a kind lie side by side, so that the operations below run along three rows of thousands.
    kinds = xp.permute_dims(xp.reshape(posed, (-1, parts, 3, 3, size)), (0, 3, 2, 1, 4))
    point, first, second = (xp.reshape(kinds[:, k], (-1, 3, parts * size)) for k in range(3))
    table = table_of_columns(point, unit_cross(first, second))
    return xp.reshape(table, (-1, POSED_REGIONS * parts, REGION_SIZE, 8))


def posed_table(body: BodyModel, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """Returns the rows of ``sample_table`` by region, (F, R, 12, 8) float32, of ``body`` in ``poses`` (F, 24, 3) [rad]
    and the shape ``betas`` (S,), relative to the root joint's rest place.

    It is computed from posed vertices, so it holds for bodies with pose blend shapes too.
    """
    skin = body_skin(body)
    posed = body.posed_vertices(poses, None, betas) - body.rest_joints(betas)[0]
    table = sample_table(*skin.posed(posed)).astype(np.float32)
    return table.reshape(len(poses), skin.region_count, -1, table.shape[-1])


Made = TypeVar("Made", "Skin", "ShapedSkin")
_KEPT: OrderedDict[tuple[str, str], Skin | ShapedSkin] = OrderedDict()
_ONE = threading.Lock()
MOST_KEPT = 4  # two of each body, 20 MB together


def body_skin(body: BodyModel) -> Skin:
    """Returns the samples of ``body``, kept between calls."""
    return _kept("skin", body, skin_samples)


def shaped_skin(body: BodyModel) -> ShapedSkin:
    """Returns the samples of ``body`` in any shape, kept between calls. Raises ``BodyError`` as ``Skin.on_bones``
    does."""
    return _kept("shaped", body, ShapedSkin)


def skins(body: BodyModel) -> tuple[Skin, ShapedSkin]:
    """Returns ``body_skin`` of ``body``, and ``shaped_skin`` of it without its pose blend shapes."""
    return body_skin(body), shaped_skin(replace(body, posedirs=None))


def keep_skins(body: BodyModel, make: Callable[..., Any]) -> None:
    """Keeps the ``skins`` of ``body`` for later calls, if they are not kept yet. ``make(skins, body)`` computes them,
    maybe in another process."""
    kinds = "skin", "shaped"
    if any((kind, body.digest) not in _KEPT for kind in kinds):
        for kind, skin in zip(kinds, make(skins, body), strict=True):
            _keep(kind, body, skin)


def _kept(kind: str, body: BodyModel, make: Callable[[BodyModel], Made]) -> Made:
    """``make(body)``, kept by the body's digest: a body that is read twice is the same."""
    found = _KEPT.get((kind, body.digest))
    return _keep(kind, body, make(body) if found is None else cast(Made, found))


def _keep(kind: str, body: BodyModel, skin: Made) -> Made:
    """``skin``, kept as the latest of ``MOST_KEPT``."""
    with _ONE:
        _KEPT[kind, body.digest] = skin
        _KEPT.move_to_end((kind, body.digest))
        if len(_KEPT) > MOST_KEPT:
            _KEPT.popitem(last=False)
    return skin


def skin_samples(body: BodyModel, *, seed: int = 0) -> Skin:
    """Returns the samples of ``body`` in T-pose; the same every time for one ``seed``. It takes half a second."""
    rest, faces = body.v_template, body.faces
    spacing = np.clip(SPACING_PER_RADIUS * limb_radius(body), *SPACING_LIMITS_M)
    spacing[body.weights[:, HEAD] > 0.5] = HEAD_SPACING_M
    foot = np.isin(body.weights.argmax(axis=1), FEET)
    spacing[foot] = np.minimum(spacing[foot], FOOT_SPACING_M)

    def free(point: np.ndarray, normal: np.ndarray, face: np.ndarray, weight: np.ndarray) -> np.ndarray:
        return _faces_open_space(body, point, normal, np.einsum("nk,nk->n", weight, body.weights[faces[face], HEAD]))

    placed = place(rest, faces, spacing, keep=free, seed=seed)
    made = at_rest(ring_operator(rest, faces, placed), rest, placed)
    return Skin(made.operator, made.point, made.normal, made.spacing_m)


def limb_radius(body: BodyModel) -> np.ndarray:
    """Returns the distance [m] (Vb,) of each vertex of the body's template from the axis of the bone that moves it
    most."""
    joints, rest = body.joints_template, body.v_template
    bone = body.weights.argmax(axis=1)
    radius = np.empty(len(rest))
    for joint, end in enumerate(BONE_ENDS):
        members = bone == joint
        start = joints[joint]
        axis = joints[end] - start if end >= 0 else np.zeros(3)
        offset = rest[members] - start
        along = np.clip(offset @ axis / max(float(axis @ axis), 1e-12), 0.0, 1.0)
        radius[members] = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    return radius


def _faces_open_space(body: BodyModel, point: np.ndarray, normal: np.ndarray, head: np.ndarray) -> np.ndarray:
    """False for samples inside the mouth and the eye sockets of the head."""
    free = np.ones(len(point), dtype=bool)
    members = np.flatnonzero(head > 0.5)
    probe = point[members] + OPENING_M * normal[members]
    free[members] = closest.signed_distance(probe, body.v_template, body.faces) > 0.5 * OPENING_M
    return free
