"""Layers of patches by tiles (``drape.kernels.tiles``): ``drape.network.dense`` once more, in 0.4 of its time.

Each number is split into two halves, x = high + low, and of the products of two numbers that of their low halves is
left out:

    w x ~ low high + high high + high low.

Each half is off by 2^-8 of what it stands for at most, so that 3 x 2^-16 of w x may be missing. Over a whole network
that moves vertices by less than a micrometre, as far as float32 rounds their places.
"""

from __future__ import annotations

import numpy as np

from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, most, put, row_at
from drape.kernels.tiles import (
    SHAPES,
    TILE,
    aligned,
    begin_tiles,
    end_tiles,
    put_split,
    room_for,
    split,
    tile_load,
    tile_product,
    tile_store,
    tile_zero,
)

INPUTS = 32  # of a tile
GROUP = 2 * LANES  # outputs that are summed at once, of two blocks of patches


def tiles_of(weight: np.ndarray) -> np.ndarray:
    """``weight`` (outputs, inputs) as tiles, flat uint32: of each ``GROUP`` of outputs and ``INPUTS``, both filled up
    with zeros, two tiles of what halves lack and two of the halves."""
    missing = [(0, -size % whole) for size, whole in zip(weight.shape, (GROUP, INPUTS), strict=True)]
    groups = np.pad(weight, missing).astype(np.float32)
    groups = groups.reshape(-1, 2, LANES, groups.shape[1] // INPUTS, INPUTS).transpose(0, 3, 1, 2, 4)
    high, low = split(groups)
    return aligned(np.stack([low, high], axis=2).reshape(-1))


@kernel
def run_tiles(layer, inputs, added, outputs):
    """Writes the ``layer`` of ``inputs``, plus ``added`` where that has numbers, to ``outputs``; all are ``Rows``."""
    count = len(layer.weight) // len(layer.bias)
    blocks, steps = len(inputs.values) // (LANES * inputs.count), (count + INPUTS - 1) // INPUTS
    given, sums = room_for(2 * TILE * steps * blocks, np.uint32), room_for(4 * TILE, np.float32)
    _split_inputs(inputs, count, steps, given)
    begin_tiles(SHAPES)
    for n in range(0, len(layer.bias), GROUP):
        weight = layer.tiles[4 * TILE * steps * (n // GROUP) :]
        for block in range(0, blocks - 1, 2):
            _sum_two(weight, given[2 * TILE * steps * block :], steps, sums)
            _finish(layer, added, outputs, block, n, sums, 0)
            _finish(layer, added, outputs, block + 1, n, sums, TILE)
        if blocks % 2:
            _sum_one(weight, given[2 * TILE * steps * (blocks - 1) :], steps, sums)
            _finish(layer, added, outputs, blocks - 1, n, sums, 0)
    end_tiles()


@kernel
def _split_inputs(inputs, count, steps, given):
    """Writes ``inputs`` to ``given``: of each block and each ``INPUTS``, filled up with zeros, a tile of the halves and
    one of what these lack."""
    values, none = inputs.values, row_at(inputs.values, 0) * 0.0
    low = given[TILE:]
    for block in range(len(values) // (LANES * inputs.count)):
        first = LANES * (inputs.count * block + inputs.first)
        for k in range(0, INPUTS * steps, 2):
            a, b = none, none
            if k < count:
                a = row_at(values, first + LANES * k)
            if k + 1 < count:
                b = row_at(values, first + LANES * (k + 1))
            place = 2 * TILE * (steps * block + k // INPUTS) + LANES * (k % INPUTS // 2)
            put_split(given, low, place, a, b)


@kernel
def _sum_two(weight, given, steps, sums):
    """Writes the sums of a group's outputs of two blocks to ``sums``: four tiles, outputs by outputs."""
    tile_zero(0)
    tile_zero(1)
    tile_zero(2)
    tile_zero(3)
    for k in range(steps):
        w, x = 4 * TILE * k, 2 * TILE * k
        y = x + 2 * TILE * steps
        tile_load(4, weight, w)
        tile_load(5, weight, w + TILE)
        tile_load(6, given, x)
        tile_load(7, given, y)
        _multiply_four()
        tile_load(4, weight, w + 2 * TILE)
        tile_load(5, weight, w + 3 * TILE)
        _multiply_four()
        tile_load(6, given, x + TILE)
        tile_load(7, given, y + TILE)
        _multiply_four()
    tile_store(0, sums, 0)
    tile_store(1, sums, TILE)
    tile_store(2, sums, 2 * TILE)
    tile_store(3, sums, 3 * TILE)


@part
def _multiply_four():
    tile_product(0, 4, 6)
    tile_product(1, 4, 7)
    tile_product(2, 5, 6)
    tile_product(3, 5, 7)


@kernel
def _sum_one(weight, given, steps, sums):
    """The same of one block, to the first and the third tile."""
    tile_zero(0)
    tile_zero(2)
    for k in range(steps):
        w, x = 4 * TILE * k, 2 * TILE * k
        tile_load(4, weight, w)
        tile_load(5, weight, w + TILE)
        tile_load(6, given, x)
        tile_product(0, 4, 6)
        tile_product(2, 5, 6)
        tile_load(4, weight, w + 2 * TILE)
        tile_load(5, weight, w + 3 * TILE)
        tile_product(0, 4, 6)
        tile_product(2, 5, 6)
        tile_load(6, given, x + TILE)
        tile_product(0, 4, 6)
        tile_product(2, 5, 6)
    tile_store(0, sums, 0)
    tile_store(2, sums, 2 * TILE)


@kernel
def _finish(layer, added, outputs, block, n, sums, first):
    """Writes the outputs from ``n`` on of a block, whose sums are the tiles at ``first`` and two behind it."""
    to = LANES * (outputs.count * block + outputs.first + n)
    more = LANES * (added.count * block + added.first + n)
    for m in range(min(GROUP, len(layer.bias) - n)):
        row = row_at(sums, first + 2 * TILE * (m // LANES) + LANES * (m % LANES)) + layer.bias[n + m]
        if len(added.values):
            row = row + row_at(added.values, more + LANES * m)
        put(outputs.values, to + LANES * m, most(row, row * layer.slope))
