"""Tables of a garment for the push-out, computed once: blocks of vertices, and the skin that each hangs on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from drape.arrays import Array, check_finite, check_shape
from drape.arrays.tensors import Tensors, tensor
from drape.contact.blocks import blocks
from drape.contact.samples import CLUSTER_SIZE, POSED_REGIONS, REGION_SIZE, Samples, unit
from drape.errors import MeshError

BLOCK_SIZE = 16  # vertices that share a list of skin samples
GROUP_SIZE = 2  # blocks that query for other parts of the body together
OWN_CLUSTERS = 10  # clusters of skin samples under a block
OTHER_STEPS = 255

OUTWARD_WIDTH_M = 0.02
FRONT_M = (0.020, 0.035)  # a sample is another part where a block lies this far before its plane at rest
APART_M = (0.080, 0.110)  # and where a block is that far away at rest, the way through the limb not counted
THROUGH_M = 0.12  # the most that counts as the way through a limb
OTHER_SIDE = 15.0  # logits that a sample loses per unit by which it faces away from the cloth over it
REST_REACH_M = 0.035  # at equal distance skin nearer at rest is preferred: a logit per square of this
LIST_WIDTH_M = 0.014
NEVER = 1e-12


@dataclass(frozen=True, eq=False)
class PushTables(Tensors):
    """The constants of a garment's V vertices in G groups of two blocks of 16, over a skin of P parts of four regions
    of 12 samples.

    ``block_vertex`` (G, 32): the vertices in the slots of a group, repeated where it is not full; ``vertex_slot`` (V,):
    the slot of a vertex, counted through all groups. ``own_cluster`` (G, 2, 10): the clusters of skin samples under
    each block; ``own_bias`` (G, 2, 40): the attention logits of their samples, at most 0. ``other`` (G, P, 48) uint8:
    how much a sample belongs to another part of the body than the group, in 255ths; ``region_bias`` (G, P, 4): the
    logits of regions, near 0 where a sample does and far below where none does.
    """

    block_vertex: Array = tensor("push_block_vertex", "groups", GROUP_SIZE * BLOCK_SIZE, dtype="int32", unit="vertex")
    vertex_slot: Array = tensor("push_vertex_slot", "vertices", dtype="int32", unit="slot")
    own_cluster: Array = tensor(
        "push_own_cluster", "groups", GROUP_SIZE, OWN_CLUSTERS, dtype="int32", unit="cluster of samples"
    )
    own_bias: Array = tensor("push_own_bias", "groups", GROUP_SIZE, OWN_CLUSTERS * CLUSTER_SIZE)
    other: Array = tensor("push_other", "groups", "parts", POSED_REGIONS * REGION_SIZE, dtype="uint8", unit="1 / 255")
    region_bias: Array = tensor("push_region_bias", "groups", "parts", POSED_REGIONS)


def push_tables(vertices: np.ndarray, skin: Samples, *, hidden: np.ndarray | None = None) -> PushTables:
    """Returns the tables of a garment with ``vertices`` [m] (V, 3) at rest on the body in T-pose that has the samples
    ``skin``.

    ``hidden`` (S,) bool are samples under cloth, which push nothing. Raises ``MeshError`` for no vertices and for
    numbers that are not finite.
    """
    rest = np.asarray(vertices, dtype=np.float64)
    check_shape("vertices", rest, (None, 3), error=MeshError)
    check_finite("vertices", rest, error=MeshError)
    if len(rest) == 0:
        raise MeshError("vertices", expected="at least one", got="none", cure="Pass a mesh with vertices.")
    outward = outward_directions(rest, skin)
    members = blocks(rest, outward, BLOCK_SIZE)
    short = -len(members) % GROUP_SIZE
    members = np.concatenate([members, np.repeat(members[-1:], short, axis=0)])
    slot = np.empty(len(rest), dtype=np.int64)
    # Written backwards, so that the first slot of a vertex counts.
    slot[members.reshape(-1)[::-1]] = np.arange(members.size)[::-1]
    lists = skin_lists(rest[members].mean(axis=1), unit(outward[members].mean(axis=1)), skin, hidden=hidden)
    by_group = lists.other.reshape(-1, GROUP_SIZE, skin.count).mean(axis=1)
    by_region = by_group.reshape(len(by_group), -1, REGION_SIZE).max(axis=2)
    # Only their differences count; the largest is 0, as ``field.attend_columns`` needs it.
    own_bias = lists.own_bias - lists.own_bias.max(axis=1, keepdims=True)
    groups = len(by_group)
    return PushTables(
        block_vertex=members.reshape(groups, -1).astype(np.int32),
        vertex_slot=slot.astype(np.int32),
        own_cluster=lists.own_cluster.reshape(groups, GROUP_SIZE, -1).astype(np.int32),
        own_bias=own_bias.reshape(groups, GROUP_SIZE, -1).astype(np.float32),
        other=np.rint(OTHER_STEPS * by_group).astype(np.uint8).reshape(groups, -1, POSED_REGIONS * REGION_SIZE),
        region_bias=np.log(1e-6 + by_region).astype(np.float32).reshape(groups, -1, POSED_REGIONS),
    )


@dataclass(frozen=True, eq=False)
class SkinLists:
    """The skin near C places at rest: ``own_cluster`` (C, 10), the clusters of samples under each; ``own_bias`` (C,
    40), the attention logits of their samples; and ``other`` (C, S) in [0, 1], how much each of S samples belongs to
    another part of the body than the place."""

    own_cluster: np.ndarray
    own_bias: np.ndarray
    other: np.ndarray


def skin_lists(centre: np.ndarray, facing: np.ndarray, skin: Samples, *, hidden: np.ndarray | None = None) -> SkinLists:
    """Returns the skin near places at ``centre`` [m] (C, 3) with unit outward directions ``facing`` (C, 3), at rest on
    the body in T-pose with the samples ``skin``.

    ``hidden`` (S,) bool are samples under cloth: they belong to no part.
    """
    distance, before = _relation(centre, skin)
    other = other_part(distance, before)
    over = (facing @ skin.normal.T).astype(np.float32)
    own = 1.0 - other
    if hidden is not None:
        check_shape("hidden", hidden, (skin.count,), error=MeshError)
        own, other = np.where(hidden, 0.0, own), np.where(hidden, 0.0, other)
    bias = np.log(np.maximum(own, NEVER)) + OTHER_SIDE * np.minimum(0.0, over) - (distance / REST_REACH_M) ** 2
    cluster = _best_clusters(bias - (distance / LIST_WIDTH_M) ** 2)
    index = (CLUSTER_SIZE * cluster[:, :, None] + np.arange(CLUSTER_SIZE)).reshape(len(centre), -1)
    return SkinLists(cluster, np.take_along_axis(bias, index, axis=1), other)


def outward_directions(vertices: np.ndarray, skin: Samples) -> np.ndarray:
    """Returns for each of ``vertices`` [m] (V, 3) at rest the unit direction (V, 3) away from the body: the mean normal
    of the samples ``skin`` around the nearest one."""
    distance, near = KDTree(skin.point).query(vertices, k=min(16, skin.count))
    distance, near = distance.reshape(len(vertices), -1), near.reshape(len(vertices), -1)
    weight = np.exp(-(distance**2 - distance[:, :1] ** 2) / OUTWARD_WIDTH_M**2)
    return unit(np.einsum("vk,vkc->vc", weight, skin.normal[near]))


def other_part(distance: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Returns how much each sample belongs to another part of the body than the cloth lies on, in [0, 1], in the shape
    of ``distance``.

    ``distance`` [m] is that between cloth and sample at rest; ``before`` [m] is how far the cloth lies in front of the
    sample's tangent plane. Cloth lies close over its own skin. Where it lies far behind the plane, the sample is on the
    other side of the same limb: up to ``THROUGH_M`` of limb between the two does not count as a distance.
    """
    facing = np.clip((before - FRONT_M[0]) / (FRONT_M[1] - FRONT_M[0]), 0.0, 1.0)
    around = distance + np.clip(before, -THROUGH_M, 0.0)
    return np.maximum(facing, np.clip((around - APART_M[0]) / (APART_M[1] - APART_M[0]), 0.0, 1.0))


def _best_clusters(score: np.ndarray) -> np.ndarray:
    """Clusters (C, 10) whose best sample has the largest of ``score`` (C, S)."""
    best = score.reshape(len(score), -1, CLUSTER_SIZE).max(axis=2)
    return np.sort(np.argpartition(-best, OWN_CLUSTERS - 1, axis=1)[:, :OWN_CLUSTERS], axis=1)


def _relation(centre: np.ndarray, skin: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Distances [m] (C, S) from the samples at rest, and heights [m] over their planes; float32, as there are many."""
    squared = (centre**2).sum(axis=1)[:, None] + (skin.point**2).sum(axis=1) - 2.0 * centre @ skin.point.T
    before = centre @ skin.normal.T - (skin.point * skin.normal).sum(axis=1)
    return np.sqrt(np.maximum(squared, 0.0)).astype(np.float32), before.astype(np.float32)
