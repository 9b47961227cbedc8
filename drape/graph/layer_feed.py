"""Constants with which a garment worn over others is pushed out, as ``drape.contact`` and its graph take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drape.arrays import Array, namespace
from drape.arrays.tensors import Tensors, group, tensor
from drape.body.model import BodyModel
from drape.contact.cloth_samples import MEMBERS, ClothSamples, cloth_samples, hidden_samples, join_samples
from drape.contact.field import take
from drape.contact.projection import CLEARANCE_M, Pushed, PushFeed, push_in_parts
from drape.contact.samples import CLUSTER_SIZE, POSED_REGIONS, REGION_SIZE, Samples, table_of_columns, unit_cross
from drape.contact.skin import body_skin
from drape.errors import ArtifactError, InputError
from drape.garment.cache import Garment
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import pack_push

PART_CLUSTERS = POSED_REGIONS * REGION_SIZE // CLUSTER_SIZE
REGION_ROW = 8 * REGION_SIZE


@dataclass(frozen=True, eq=False)
class InnerGarment:
    """An inner garment as a collider: its delivered mesh at rest, ``vertices`` [m] (V, 3) and ``faces`` (F, 3), and the
    samples on it."""

    vertices: np.ndarray
    faces: np.ndarray
    samples: ClothSamples


@dataclass(frozen=True, eq=False)
class LayerFeed(Tensors):
    """The constants with which a garment is pushed out of the body and of the garments below it, the inner ones.

    Regions of samples are numbered through those of the body, then of each inner garment. ``region`` (P, 4) are those
    that cloth does not hide wholly, in P parts of four; the parts of ``push`` are these. ``cloth_member`` (Q, 12, 24)
    and ``cloth_rows`` (Q, 12, 24, 12) are ``ClothSamples.member`` and ``rows`` of all inner garments, their vertices
    numbered through all of them.
    """

    push: PushFeed = group(PushFeed, parts="all_parts")
    region: Array = tensor("region", "all_parts", POSED_REGIONS, dtype="int32", unit="region of samples")
    cloth_member: Array = tensor(
        "cloth_member", "cloth_parts", PART_CLUSTERS, MEMBERS, dtype="int32", unit="vertex of under"
    )
    cloth_rows: Array = tensor("cloth_rows", "cloth_parts", PART_CLUSTERS, MEMBERS, 3 * CLUSTER_SIZE)


def inner_garment(garment: Garment) -> InnerGarment:
    """Returns the delivered mesh of ``garment`` as a collider for the garments over it."""
    vertices, faces = garment.vertices[: garment.vertex_count].astype(np.float64), garment.faces.astype(np.int64)
    return InnerGarment(vertices, faces, cloth_samples(vertices, faces))


def pack_layer(
    feed: dict[str, np.ndarray], vertices: np.ndarray, skin: Samples, inner: Sequence[InnerGarment]
) -> LayerFeed:
    """Returns the constants of a garment over ``inner``, innermost first, on the body with the samples ``skin``.

    ``feed`` is its ``garment_feed`` and ``vertices`` [m] (V, 3) are its vertices at rest, as many as ``feed`` has.
    Raises ``ArtifactError`` for another number.
    """
    surfaces = [skin, *(item.samples for item in inner)]
    hidden = [np.zeros(surface.count, dtype=bool) for surface in surfaces]
    for layer, surface in enumerate(surfaces):
        for over in inner[layer:]:
            hidden[layer] |= hidden_samples(surface, over.vertices, over.faces)
    by_region = np.concatenate(hidden).reshape(-1, REGION_SIZE)
    region = np.flatnonzero(~by_region.all(axis=1))
    region = np.concatenate([region, np.repeat(region[-1:], -len(region) % POSED_REGIONS)])
    seen = join_samples(surfaces).of_regions(region)
    first = np.cumsum([0, *(len(item.vertices) for item in inner)])[:-1]
    member = np.concatenate([item.samples.member + start for item, start in zip(inner, first, strict=True)])
    rows = np.concatenate([item.samples.rows for item in inner])
    return LayerFeed(
        pack_push(feed, vertices, seen, hidden=by_region[region].reshape(-1)),
        region.reshape(-1, POSED_REGIONS).astype(np.int32),
        member.reshape(-1, PART_CLUSTERS, member.shape[1]).astype(np.int32),
        rows.reshape(-1, PART_CLUSTERS, *rows.shape[1:]),
    )


def layer_feed(outer: Garment, inner: Sequence[Garment], body: BodyModel) -> LayerFeed:
    """Returns the constants of the delivered mesh of ``outer`` over the garments ``inner``, innermost first, on
    ``body``.

    Raises ``ArtifactError`` for garments of another body, and ``InputError`` for no inner garment or one garment
    twice.
    """
    check_layers([*inner, outer])
    for garment in (*inner, outer):
        if garment.body_digest != body.digest:
            raise ArtifactError(
                f"garment {garment.name} body_digest",
                expected=f"{body.digest} ({body.name}), as of all layers",
                got=garment.body_digest,
                cure="Run the intake again for this body.",
            )
    below = [inner_garment(garment) for garment in inner]
    return pack_layer(garment_feed(outer), outer.vertices[: outer.vertex_count], body_skin(body), below)


def check_layers(garments: Sequence[Garment]) -> None:
    """Raises ``InputError`` for an outfit of fewer than two garments, and for one that has a garment twice."""
    if len(garments) < 2:
        raise InputError(
            "outfit", expected="two garments or more", got=str(len(garments)), cure="Name the inner ones first."
        )
    seen: dict[str, str] = {}
    for garment in garments:
        if garment.digest in seen:
            raise InputError(
                "outfit",
                expected="each garment once",
                got=f"{garment.name} twice",
                cure="Take a garment in under another size to wear two of it.",
            )
        seen[garment.digest] = garment.name


def push_over(
    vertices: Array, under: Array, skin: Array, feed: LayerFeed, clearance_m: Array | float = CLEARANCE_M
) -> Array:
    """Returns the vertices [m] (F, V, 3) of ``push_over_in_parts`` alone."""
    return push_over_in_parts(vertices, under, skin, feed, clearance_m).vertices


def push_over_in_parts(
    vertices: Array, under: Array, skin: Array, feed: LayerFeed, clearance_m: Array | float = CLEARANCE_M
) -> Pushed:
    """Returns ``vertices`` [m] (F, V, 3) pushed out of the bodies and of the garments below, up to ``clearance_m`` [m]
    over both, and the push as jets can show it.

    ``under`` [m] (F, U, 3) are the draped vertices of the garments below, ``skin`` (F, R, 12, 8) the bodies' samples
    (``drape.contact.skin.skin_table``), all in one frame.
    """
    xp = namespace(vertices)
    frames = vertices.shape[0]
    rows = xp.concat([xp.reshape(skin, (frames, -1, REGION_ROW)), cloth_table(under, feed)], axis=1)
    seen = take(rows, xp.reshape(feed.region, (-1,)), axis=1)
    return push_in_parts(vertices, xp.reshape(seen, (frames, -1, REGION_SIZE, 8)), feed.push, clearance_m)


def cloth_table(under: Array, feed: LayerFeed) -> Array:
    """Returns the samples on garments that are draped to ``under`` [m] (F, U, 3), as rows of ``sample_table`` by
    region, (F, 4 Q, 96)."""
    xp = namespace(under)
    frames, (parts, clusters, count) = under.shape[0], feed.cloth_member.shape
    taken = take(under, xp.reshape(feed.cloth_member, (-1,)), axis=1)
    taken = xp.matrix_transpose(xp.reshape(taken, (frames, parts, clusters, count, 3)))
    posed = taken @ feed.cloth_rows  # (F, Q, 12, 3, 12)
    point, first, second = (posed[..., k * CLUSTER_SIZE : (k + 1) * CLUSTER_SIZE] for k in range(3))
    return xp.reshape(table_of_columns(point, unit_cross(first, second)), (frames, POSED_REGIONS * parts, REGION_ROW))
