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
    """The rows of the patches of a garment.

    ``first`` (its half of the first layer), ``weights`` (24) of the bones and the ``heaviest`` one, the frame at rest
    (``rotation`` 9, ``centre`` 3 [m], ``scale`` [m], and ``slopes`` 3 x 10 of the centre by the body's shape);
    ``columns`` (56, 9) and ``fit`` (56, 21) of the members, ``rest`` (63) of the fit; ``anchor`` (A, 4), the members
    that say where an anchor is, and ``member`` (56), the anchor of each; ``tangent`` (42) and ``unit`` (42), products
    of unit vectors, of the strain; ``place`` (21) where the body is felt, ``sample`` (40) of its own part and their
    ``bias``, the bias of each ``region`` of other parts and how much its samples are ``other`` parts, in 15ths.
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
    """The rows of ``garment``, whose half of the first layer is ``first`` (K, n)."""
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
