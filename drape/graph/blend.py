"""Vertices of posed jets by the engine: the packed graph's vertex stage, at the rate at which columns are read.

On processors a batch of products of 3 x 18 by 18 x 32 takes an inference engine three times as long as reading them.
The arrangement is that of ``drape.graph.packing``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.packer import Recorded
from drape.graph.packing import PackedGarment


@dataclass(frozen=True, eq=False)
class PosedJets(Recorded):
    """The K posed patches of one frame: ``jet`` (K, 27 or 45), the coefficients in patch scales, and the patches'
    frames, ``rotation`` (K, 3, 3) and ``centre`` [m] (K, 3)."""

    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray


@dataclass(frozen=True, eq=False)
class Tiles(Recorded):
    """The constants by which a garment's V vertices are blended from its K posed patches, laid out as
    ``drape.graph.packing`` says.

    ``scale`` [m] (K,) is that of the patches, ``columns`` (Q, 18, 32) are the chart entries in Q tiles, and ``patch``
    (Q,) is the patch of each tile. The columns of each vertex's four charts are in ``charts`` (4, blocks, 64) uint16,
    or in ``wide_charts`` int32 where these are too many; the other one is empty.
    """

    scale: np.ndarray
    columns: np.ndarray
    patch: np.ndarray
    charts: np.ndarray
    wide_charts: np.ndarray

    @classmethod
    def of(cls, garment: PackedGarment) -> Tiles:
        """Returns scales, tiles and charts of ``garment``, by which its vertices are blended."""
        stored, charts, none = garment.stored, garment.vertex_charts, garment.vertex_charts[:0]
        narrow = charts.dtype == np.uint16
        return cls(
            stored["patch_scale"],
            stored["tile_positions"],
            garment.tile_patch,
            charts if narrow else none.astype(np.uint16),
            none.astype(np.int32) if narrow else charts,
        )


def blend(jets: PosedJets, tiles: Tiles, vertices: np.ndarray) -> None:
    """Writes the ``vertices`` [m] (V, 3) of the posed patches ``jets``, in the frame of their centres: weighted sums
    over charts. The same input gives the same bits."""
    call_with_scratch("vertices", vertices.dtype, jets, tiles, vertices, len(vertices))
