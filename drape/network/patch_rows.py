"""The constants of a garment's patches as the engine reads them: sixteen patches a row.

Each array is flat. It has the rows of a block of sixteen patches one after the other; the last block is filled up with
its last patch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.contact.proximity import from_halves
from drape.contact.samples import CLUSTER_SIZE, REGION_SIZE
from drape.engine.library import LANES
from drape.engine.packer import Recorded
from drape.garment.consensus import MEMBERS
from drape.graph.packing import PackedGarment
from drape.network.dense import rows_of


@dataclass(frozen=True, eq=False)
class PatchRows(Recorded):
    """The constants of a garment's K patches as the engine reads them. Each array is (blocks, n, 16), flat: sixteen
    patches a block, the last one filled up with the last patch. In brackets stand the n numbers of one patch.

    ``first`` (n) is the summand of the decoder's first layer that depends on the patch alone. ``weights`` (24) are its
    skinning weights and ``heaviest`` the bone of the largest; ``rotation`` (9), ``centre`` (3) [m] and ``scale`` [m]
    are its frame at rest, ``slopes`` (3 x 10) [m] those of the centre by the body's shape. ``columns`` (56 x 9),
    ``fit`` (56 x 21), ``rest`` (63) and ``tangent`` (42) are those of ``StoredCharts``, ``unit`` (42) the products of
    its ``unit``; ``member`` (56) are its anchors. ``anchor``, not of patches but (A, 4), are the columns of each
    anchor. ``place`` (21) are the points that feel the body, ``sample`` (40) and ``bias`` (40) the skin samples of its
    own part and their logits. ``region`` has the logit of each region of other parts, ``other`` how much each sample
    belongs to another part, in 15ths.
    """

    first: np.ndarray
    weights: np.ndarray
    heaviest: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray
    scale: np.ndarray
    slopes: np.ndarray
    columns: np.ndarray
    fit: np.ndarray
    rest: np.ndarray
    anchor: np.ndarray
    member: np.ndarray
    tangent: np.ndarray
    unit: np.ndarray
    place: np.ndarray
    sample: np.ndarray
    bias: np.ndarray
    region: np.ndarray
    other: np.ndarray


def patch_rows(garment: PackedGarment, first: np.ndarray) -> PatchRows:
    """Returns the constants of the patches of ``garment`` as the engine reads them. ``first`` (K, n) is the summand of
    the decoder's first layer that depends on the patch alone."""
    stored, count = garment.stored, garment.patch_count
    block, lane = np.divmod(np.arange(count), LANES)
    # Where a member (patch, number) lies among all of them: block, number, lane.
    patch, number = np.divmod(garment.anchor_charts.reshape(len(garment.anchor_charts), -1).T.astype(np.int64), MEMBERS)
    anchor = (MEMBERS * block[patch] + number) * LANES + lane[patch]
    a, b, c = np.moveaxis(stored["strain_unit"], 1, 0)
    samples = CLUSTER_SIZE * stored["felt_cluster"][:, :, None] + np.arange(CLUSTER_SIZE)
    other = from_halves(stored["felt_other"].reshape(count, -1, REGION_SIZE // 2).astype(np.float32))
    return PatchRows(
        first=_rows(first),
        weights=_rows(stored["patch_weights"]),
        heaviest=_rows(garment.heaviest),
        rotation=_rows(stored["patch_rotation"]),
        centre=_rows(stored["patch_centre"][:, :3]),
        scale=_rows(stored["patch_scale"]),
        slopes=_rows(stored["patch_shapedirs"][:, :3]),
        columns=_rows(stored["anchor_columns"].swapaxes(1, 2)),
        fit=_rows(stored["anchor_fit"]),
        rest=_rows(stored["anchor_rest"]),
        anchor=np.ascontiguousarray(anchor, np.uint32),
        member=_rows(garment.member_anchor.astype(np.int32)),
        tangent=_rows(stored["strain_tangent"]),
        unit=_rows(np.stack([a * a, a * b, a * c, b * b, b * c, c * c], axis=1)),
        place=_rows(stored["felt_place"]),
        sample=_rows(samples.astype(np.int32)),
        bias=_rows(stored["felt_bias"]),
        region=_rows(stored["felt_region"].astype(np.float32)),
        other=_rows(other.astype(np.uint8)),
    )


def _rows(values: np.ndarray) -> np.ndarray:
    return rows_of(values).reshape(-1)
