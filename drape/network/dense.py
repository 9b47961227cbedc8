"""Layers of the network, compiled: sums over the inputs of all rows of patches, and of one body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, most, put, row_at

OUTPUTS = 4  # of a row of patches that are summed at once; with two rows that are eight sums, all in registers


class Layer(NamedTuple):
    """A layer of patches: ``weight`` (outputs / 4, inputs, 4) flat and ``bias`` (outputs,), of outputs filled up to a
    multiple of four with zeros. A negative sum is multiplied by the ``slope``: 1 where nothing bends."""

    weight: np.ndarray
    bias: np.ndarray
    slope: np.floating


def layer(weight: np.ndarray, bias: np.ndarray, slope: float = 1.0) -> Layer:
    """The layer of ``weight`` (outputs, inputs) and ``bias`` (outputs,), in the type of ``weight``."""
    missing = -len(weight) % OUTPUTS
    filled = np.pad(weight, ((0, missing), (0, 0)))
    tiles = filled.reshape(-1, OUTPUTS, weight.shape[1]).transpose(0, 2, 1)
    return Layer(np.ascontiguousarray(tiles).reshape(-1), np.pad(bias, (0, missing)), weight.dtype.type(slope))


class Rows(NamedTuple):
    """Numbers of patches, ``count`` for each: ``values`` flat, sixteen patches a row, the rows of a block of patches
    one after the other. A layer reads or writes them from row ``first`` of a block on."""

    values: np.ndarray
    count: int
    first: int


@kernel
def run_layer(layer, inputs, added, outputs):
    """Writes the ``layer`` of ``inputs``, plus ``added`` where that has numbers, to ``outputs``; all are ``Rows``."""
    count = len(layer.weight) // len(layer.bias)
    blocks = len(inputs.values) // (LANES * inputs.count)
    for block in range(0, blocks - 1, 2):
        _two_blocks(layer, inputs, added, outputs, block, count)
    if blocks % 2:
        _one_block(layer, inputs, added, outputs, blocks - 1, count)


@part
def _starts(rows, block):
    return LANES * (rows.count * block + rows.first)


@part
def _begin(layer, added, block, n):
    none = row_at(layer.weight, 0) * 0.0  # a layer has sixteen weights at least
    if len(added.values) == 0:
        return none + layer.bias[n], none + layer.bias[n + 1], none + layer.bias[n + 2], none + layer.bias[n + 3]
    place = _starts(added, block) + LANES * n
    return (
        row_at(added.values, place) + layer.bias[n],
        row_at(added.values, place + LANES) + layer.bias[n + 1],
        row_at(added.values, place + 2 * LANES) + layer.bias[n + 2],
        row_at(added.values, place + 3 * LANES) + layer.bias[n + 3],
    )


@part
def _finish(layer, outputs, block, n, sums):
    place = _starts(outputs, block) + LANES * n
    for i in range(OUTPUTS):
        put(outputs.values, place + LANES * i, most(sums[i], sums[i] * layer.slope))


@kernel
def _two_blocks(layer, inputs, added, outputs, block, count):
    x, y = _starts(inputs, block), _starts(inputs, block + 1)
    weight, values = layer.weight, inputs.values
    for n in range(0, len(layer.bias), OUTPUTS):
        a, b, c, d = _begin(layer, added, block, n)
        e, f, g, h = _begin(layer, added, block + 1, n)
        w = n * count
        for k in range(count):
            p, q = row_at(values, x + LANES * k), row_at(values, y + LANES * k)
            a, e = a + p * weight[w], e + q * weight[w]
            b, f = b + p * weight[w + 1], f + q * weight[w + 1]
            c, g = c + p * weight[w + 2], g + q * weight[w + 2]
            d, h = d + p * weight[w + 3], h + q * weight[w + 3]
            w += OUTPUTS
        _finish(layer, outputs, block, n, (a, b, c, d))
        _finish(layer, outputs, block + 1, n, (e, f, g, h))


@kernel
def _one_block(layer, inputs, added, outputs, block, count):
    x, weight, values = _starts(inputs, block), layer.weight, inputs.values
    for n in range(0, len(layer.bias), OUTPUTS):
        a, b, c, d = _begin(layer, added, block, n)
        w = n * count
        for k in range(count):
            p = row_at(values, x + LANES * k)
            a, b = a + p * weight[w], b + p * weight[w + 1]
            c, d = c + p * weight[w + 2], d + p * weight[w + 3]
            w += OUTPUTS
        _finish(layer, outputs, block, n, (a, b, c, d))


class BodyLayer(NamedTuple):
    """A layer of a body's code: ``weight`` (inputs, outputs), outputs filled up to a multiple of sixteen, ``bias``."""

    weight: np.ndarray
    bias: np.ndarray


def body_layer(weight: np.ndarray, bias: np.ndarray | None = None) -> BodyLayer:
    """The layer of ``weight`` (outputs, inputs) and ``bias`` (outputs,), none of zeros."""
    missing = -len(weight) % LANES
    bias = np.zeros(len(weight), weight.dtype) if bias is None else bias
    return BodyLayer(np.ascontiguousarray(np.pad(weight, ((0, missing), (0, 0))).T), np.pad(bias, (0, missing)))


@kernel
def run_body_layer(layer, inputs, slope, outputs):
    """Writes the ``layer`` of the numbers ``inputs`` of one body to ``outputs``, negative sums times ``slope``."""
    for n in range(0, len(layer.bias), LANES):
        total, other = row_at(layer.bias, n), row_at(layer.bias, n) * 0.0
        for k in range(0, len(layer.weight) - 1, 2):  # two sums, since each addition waits for the one before
            total = total + row_at(layer.weight[k], n) * inputs[k]
            other = other + row_at(layer.weight[k + 1], n) * inputs[k + 1]
        if len(layer.weight) % 2:
            total = total + row_at(layer.weight[len(layer.weight) - 1], n) * inputs[len(layer.weight) - 1]
        total = total + other
        put(outputs, n, most(total, total * slope))
