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
    """Posed patches of one frame: ``jet`` (K, 27 or 45), ``rotation`` (K, 3, 3) and ``centre`` [m] (K, 3)."""

    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray


@dataclass(frozen=True, eq=False)
class Tiles(Recorded):
    """The constants from which vertices are blended.

    They are the ``scale`` (K,) [m] of the patches, the ``columns`` (Q, 18, 32) of the tiles and the ``patch`` (Q,) of
    each, and the charts (4, >= V) of the vertices: ``charts`` of 16 bits or ``wide_charts`` of 32.
    """

    scale: np.ndarray
    columns: np.ndarray
    patch: np.ndarray
    charts: np.ndarray
    wide_charts: np.ndarray

    @classmethod
    def of(cls, garment: PackedGarment) -> Tiles:
        """Returns the tiles of ``garment``."""
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
    """Writes the ``vertices`` [m] (V, 3) of posed ``jets`` by ``tiles``: weighted sums over charts, relative to what
    the centres are relative to. The same input gives the same bits."""
    call_with_scratch("vertices", vertices.dtype, jets, tiles, vertices, len(vertices))
