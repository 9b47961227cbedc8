"""Layers of the network, compiled: sums over the inputs of all rows of patches, and of one body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, most, number_at, put, row_at
from drape.kernels.tiles import has_tiles
from drape.network.tiled import run_tiles, tiles_of

OUTPUTS = 8  # of a row of patches that are summed at once; with three rows that are 24 sums, all in registers


class Layer(NamedTuple):
    """A layer of patches: ``weight`` (outputs / 8, inputs, 8) flat and ``bias`` (outputs,), of outputs filled up to a
    multiple of eight with zeros. A negative sum is multiplied by the ``slope``: 1 where nothing bends. ``tiles``: the
    same weights for a processor that has tiles, else none (``drape.network.tiled``)."""

    weight: np.ndarray
    bias: np.ndarray
    slope: np.floating
    tiles: np.ndarray


def layer(weight: np.ndarray, bias: np.ndarray, slope: float = 1.0) -> Layer:
    """The layer of ``weight`` (outputs, inputs) and ``bias`` (outputs,), in the type of ``weight``."""
    missing = -len(weight) % OUTPUTS
    columns = _columns(np.pad(weight, ((0, missing), (0, 0))), OUTPUTS)
    tiles = tiles_of(weight) if has_tiles() and weight.dtype == np.float32 else np.empty(0, np.uint32)
    return Layer(columns, np.pad(bias, (0, missing)), weight.dtype.type(slope), tiles)


class Rows(NamedTuple):
    """Numbers of patches, ``count`` for each: ``values`` flat, sixteen patches a row, the rows of a block of patches
    one after the other. A layer reads or writes them from row ``first`` of a block on."""

    values: np.ndarray
    count: int
    first: int


@kernel
def run_layer(layer, inputs, added, outputs):
    """Writes the ``layer`` of ``inputs``, plus ``added`` where that has numbers, to ``outputs``; all are ``Rows``."""
    if len(layer.tiles):
        run_tiles(layer, inputs, added, outputs)
        return
    count = len(layer.weight) // len(layer.bias)
    blocks = len(inputs.values) // (LANES * inputs.count)
    # The last four go two by two: three and one would read an input for fewer products.
    threes = blocks - (4 if blocks % 3 == 1 and blocks > 3 else blocks % 3)
    for block in range(0, threes, 3):
        _three_blocks(layer, inputs, added, outputs, block, count)
    for block in range(threes, blocks - 1, 2):
        _two_blocks(layer, inputs, added, outputs, block, count)
    if blocks == 1:
        _one_block(layer, inputs, added, outputs, 0, count)


@part
def _starts(rows, block):
    return LANES * (rows.count * block + rows.first)


@part
def _begin(layer, added, block, n):
    """The biases of the eight outputs from ``n`` on of a block, plus what is ``added``."""
    row, bias = row_at(layer.weight, 0) * 0.0, layer.bias  # a layer has sixteen weights at least
    a, b, c, d = row + bias[n], row + bias[n + 1], row + bias[n + 2], row + bias[n + 3]
    e, f, g, h = row + bias[n + 4], row + bias[n + 5], row + bias[n + 6], row + bias[n + 7]
    if len(added.values) == 0:
        return a, b, c, d, e, f, g, h
    rows, place = added.values, _starts(added, block) + LANES * n
    return (
        row_at(rows, place) + a,
        row_at(rows, place + LANES) + b,
        row_at(rows, place + 2 * LANES) + c,
        row_at(rows, place + 3 * LANES) + d,
        row_at(rows, place + 4 * LANES) + e,
        row_at(rows, place + 5 * LANES) + f,
        row_at(rows, place + 6 * LANES) + g,
        row_at(rows, place + 7 * LANES) + h,
    )


@part
def _plus(sums, row, weight, w):
    """Eight ``sums`` with the products of a ``row`` of inputs and the weights from ``w`` on."""
    return (
        sums[0] + row * number_at(weight, w),
        sums[1] + row * number_at(weight, w + 1),
        sums[2] + row * number_at(weight, w + 2),
        sums[3] + row * number_at(weight, w + 3),
        sums[4] + row * number_at(weight, w + 4),
        sums[5] + row * number_at(weight, w + 5),
        sums[6] + row * number_at(weight, w + 6),
        sums[7] + row * number_at(weight, w + 7),
    )


@part
def _finish(layer, outputs, block, n, sums):
    place = _starts(outputs, block) + LANES * n
    for i in range(OUTPUTS):
        put(outputs.values, place + LANES * i, most(sums[i], sums[i] * layer.slope))


@kernel
def _three_blocks(layer, inputs, added, outputs, block, count):
    weight, values = layer.weight, inputs.values
    x, y, z = _starts(inputs, block), _starts(inputs, block + 1), _starts(inputs, block + 2)
    for n in range(0, len(layer.bias), OUTPUTS):
        a, b = _begin(layer, added, block, n), _begin(layer, added, block + 1, n)
        c = _begin(layer, added, block + 2, n)
        for k in range(count):
            w = n * count + OUTPUTS * k
            a = _plus(a, row_at(values, x + LANES * k), weight, w)
            b = _plus(b, row_at(values, y + LANES * k), weight, w)
            c = _plus(c, row_at(values, z + LANES * k), weight, w)
        _finish(layer, outputs, block, n, a)
        _finish(layer, outputs, block + 1, n, b)
        _finish(layer, outputs, block + 2, n, c)


@kernel
def _two_blocks(layer, inputs, added, outputs, block, count):
    weight, values = layer.weight, inputs.values
    x, y = _starts(inputs, block), _starts(inputs, block + 1)
    for n in range(0, len(layer.bias), OUTPUTS):
        a, b = _begin(layer, added, block, n), _begin(layer, added, block + 1, n)
        for k in range(count):
            w = n * count + OUTPUTS * k
            a = _plus(a, row_at(values, x + LANES * k), weight, w)
            b = _plus(b, row_at(values, y + LANES * k), weight, w)
        _finish(layer, outputs, block, n, a)
        _finish(layer, outputs, block + 1, n, b)


@kernel
def _one_block(layer, inputs, added, outputs, block, count):
    weight, values, x = layer.weight, inputs.values, _starts(inputs, block)
    for n in range(0, len(layer.bias), OUTPUTS):
        a = _begin(layer, added, block, n)
        for k in range(count):
            a = _plus(a, row_at(values, x + LANES * k), weight, n * count + OUTPUTS * k)
        _finish(layer, outputs, block, n, a)


class BodyLayer(NamedTuple):
    """A layer of a body's code: ``weight`` (outputs / 16, inputs, 16) flat, so that memory is read from end to end, and
    ``bias`` (outputs,), of outputs filled up to a multiple of sixteen with zeros."""

    weight: np.ndarray
    bias: np.ndarray


def body_layer(weight: np.ndarray, bias: np.ndarray | None = None) -> BodyLayer:
    """The layer of ``weight`` (outputs, inputs) and ``bias`` (outputs,), none of zeros."""
    missing = -len(weight) % LANES
    bias = np.zeros(len(weight), weight.dtype) if bias is None else bias
    return BodyLayer(_columns(np.pad(weight, ((0, missing), (0, 0))), LANES), np.pad(bias, (0, missing)))


def _columns(weight: np.ndarray, outputs: int) -> np.ndarray:
    """``weight`` (outputs, inputs) as (n, inputs, ``outputs``), flat: ``outputs`` of one input side by side."""
    return np.ascontiguousarray(weight.reshape(-1, outputs, weight.shape[1]).transpose(0, 2, 1)).reshape(-1)


@kernel
def run_body_layer(layer, inputs, slope, outputs):
    """Writes the ``layer`` of the numbers ``inputs`` of one body to ``outputs``, negative sums times ``slope``."""
    count = len(layer.weight) // len(layer.bias)
    for n in range(0, len(layer.bias), LANES):
        first = n * count
        total, other = row_at(layer.bias, n), row_at(layer.bias, n) * 0.0
        for k in range(0, count - 1, 2):  # two sums, since each addition waits for the one before
            place = first + LANES * k
            total = total + row_at(layer.weight, place) * number_at(inputs, k)
            other = other + row_at(layer.weight, place + LANES) * number_at(inputs, k + 1)
        if count % 2:
            total = total + row_at(layer.weight, first + LANES * (count - 1)) * number_at(inputs, count - 1)
        total = total + other
        put(outputs, n, most(total, total * slope))
