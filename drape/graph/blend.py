"""Vertices of posed jets, compiled: what the packed graph's vertex stage does, at the rate at which columns are read.

On processors a batch of products of 3 x 18 by 18 x 32 takes an inference engine three times as long as reading them.
The arrangement is that of ``drape.graph.packing``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.arrays.subnormals import flushed
from drape.geometry import jets
from drape.graph.packed import CHARTS_PER_TILE, COLUMNS
from drape.graph.packing import PackedGarment
from drape.kernels.compiled import kernel

BASIS = jets.HEIGHT_COUNT


class Tiles(NamedTuple):
    """What vertices are made by: the ``scale`` (K, 4) of the patches, the ``columns`` (Q, 18, 32) of the tiles and the
    ``patch`` (Q,) of each, and the ``charts`` (4, >= V) of the vertices."""

    scale: np.ndarray
    columns: np.ndarray
    patch: np.ndarray
    charts: np.ndarray

    @classmethod
    def of(cls, garment: PackedGarment) -> Tiles:
        """Those of ``garment``."""
        stored, charts = garment.stored, garment.vertex_charts
        return cls(stored["patch_scale"], stored["tile_positions"], garment.tile_patch, charts.reshape(len(charts), -1))


def blended(garment: PackedGarment, jet: np.ndarray, rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Vertices [m] (V, 3) float32 of one frame of ``garment``: the weighted sums over its charts.

    ``jet`` (K, 27 or 45), ``rotation`` (K, 3, 3) and ``centre`` [m] (K, 3) are float32 as the packed graph gives them;
    vertices are relative to what ``centre`` is relative to. The same input gives the same bits.
    """
    vertices = np.empty((garment.vertex_count, 3), dtype=np.float32)
    with flushed():
        blend((jet, rotation, centre), Tiles.of(garment), vertices)
    return vertices


@kernel
def blend(posed_jets, tiles, vertices):
    """Writes the ``vertices`` (V, 3) of ``posed_jets``: jet, rotation (K, 3, 3) and centre; by ``tiles``."""
    jet, rotation, centre = posed_jets
    posed = np.empty((len(jet), 3, COLUMNS), np.float32)
    said = np.empty((3, len(tiles.columns), CHARTS_PER_TILE), np.float32)
    _pose(jet, rotation, centre, tiles.scale, posed)
    _say(posed, tiles.columns, tiles.patch, said)
    _add(said.reshape(3, -1), tiles.charts, vertices)


@kernel
def _pose(jet, rotation, centre, scale, posed):
    """``posed`` (K, 3, 18): the frames in metres, and their products with the three polynomials; the centre is added to
    these once, as the weights of a vertex sum to one."""
    plane = (jet.shape[1] - BASIS) // 2
    for k in range(len(jet)):
        for axis in range(3):
            for i in range(3):
                posed[k, axis, i] = rotation[k, axis, i] * scale[k, 0]
            p, q, h = posed[k, axis, 0], posed[k, axis, 1], posed[k, axis, 2]
            for i in range(BASIS):
                posed[k, axis, 3 + i] = h * jet[k, 2 * plane + i]
            for i in range(plane):
                posed[k, axis, 3 + i] += p * jet[k, i] + q * jet[k, plane + i]
            posed[k, axis, 3] += centre[k, axis]


@kernel
def _say(posed, tiles, tile_patch, said):
    """``said`` (3, Q, 32): products of the posed jets (K, 3, 18) of each tile's patch and its columns (Q, 18, 32)."""
    for tile in range(len(tiles)):
        jet, columns = posed[tile_patch[tile]], tiles[tile]
        for axis in range(3):
            for column in range(CHARTS_PER_TILE):
                total = np.float32(0.0)
                for i in range(COLUMNS):  # constants on both loops: it is unrolled, and columns side by side
                    total += jet[axis, i] * columns[i, column]
                said[axis, tile, column] = total


@kernel
def _add(said, charts, vertices):
    """``vertices`` (V, 3): sums of the columns of ``said`` (3, n) that ``charts`` (4, >= V) name."""
    for vertex in range(len(vertices)):
        for axis in range(3):
            row = said[axis]
            near, far = row[charts[0, vertex]] + row[charts[1, vertex]], row[charts[2, vertex]] + row[charts[3, vertex]]
            vertices[vertex, axis] = near + far


def warm_up() -> None:
    """Compiles the kernels, or reads them where they are stored, so that no frame waits for that."""
    one = np.zeros((1, 3, 3), dtype=np.float32)
    columns, patch = np.zeros((1, COLUMNS, CHARTS_PER_TILE), dtype=np.float32), np.zeros(1, dtype=np.int32)
    posed = np.zeros((1, jets.FULL_COUNT), dtype=np.float32), one, one[:, 0]
    for index in (np.uint16, np.int32):  # of a small garment and of a large one
        tiles = Tiles(one[:, 0, :1].copy(), columns, patch, np.zeros((4, 1), dtype=index))
        blend(posed, tiles, np.zeros((1, 3), dtype=np.float32))
