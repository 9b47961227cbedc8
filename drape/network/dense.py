"""Layers of the network, compiled: sums over the inputs of all rows of patches, and of one body."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.kernels.compiled import kernel, part
from drape.kernels.lanes import LANES, most, number_at, put, row_at

OUTPUTS = 4  # of a row of patches that are summed at once; with four rows that are sixteen sums, all in registers


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
    whole = blocks - blocks % 4
    for block in range(0, whole, 4):
        _four_blocks(layer, inputs, added, outputs, block, count)
    if blocks - whole == 3:
        _three_blocks(layer, inputs, added, outputs, whole, count)
    elif blocks - whole == 2:
        _two_blocks(layer, inputs, added, outputs, whole, count)
    elif blocks - whole == 1:
        _one_block(layer, inputs, added, outputs, whole, count)


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
def _four_blocks(layer, inputs, added, outputs, block, count):
    weight, values = layer.weight, inputs.values
    x, y = _starts(inputs, block), _starts(inputs, block + 1)
    z, u = _starts(inputs, block + 2), _starts(inputs, block + 3)
    for n in range(0, len(layer.bias), OUTPUTS):
        a0, b0, c0, d0 = _begin(layer, added, block, n)
        a1, b1, c1, d1 = _begin(layer, added, block + 1, n)
        a2, b2, c2, d2 = _begin(layer, added, block + 2, n)
        a3, b3, c3, d3 = _begin(layer, added, block + 3, n)
        w = n * count
        for k in range(count):
            p, q = row_at(values, x + LANES * k), row_at(values, y + LANES * k)
            r, s = row_at(values, z + LANES * k), row_at(values, u + LANES * k)
            m = number_at(weight, w)
            a0, a1, a2, a3 = a0 + p * m, a1 + q * m, a2 + r * m, a3 + s * m
            m = number_at(weight, w + 1)
            b0, b1, b2, b3 = b0 + p * m, b1 + q * m, b2 + r * m, b3 + s * m
            m = number_at(weight, w + 2)
            c0, c1, c2, c3 = c0 + p * m, c1 + q * m, c2 + r * m, c3 + s * m
            m = number_at(weight, w + 3)
            d0, d1, d2, d3 = d0 + p * m, d1 + q * m, d2 + r * m, d3 + s * m
            w += OUTPUTS
        _finish(layer, outputs, block, n, (a0, b0, c0, d0))
        _finish(layer, outputs, block + 1, n, (a1, b1, c1, d1))
        _finish(layer, outputs, block + 2, n, (a2, b2, c2, d2))
        _finish(layer, outputs, block + 3, n, (a3, b3, c3, d3))


@kernel
def _three_blocks(layer, inputs, added, outputs, block, count):
    weight, values = layer.weight, inputs.values
    x, y = _starts(inputs, block), _starts(inputs, block + 1)
    z = _starts(inputs, block + 2)
    for n in range(0, len(layer.bias), OUTPUTS):
        a0, b0, c0, d0 = _begin(layer, added, block, n)
        a1, b1, c1, d1 = _begin(layer, added, block + 1, n)
        a2, b2, c2, d2 = _begin(layer, added, block + 2, n)
        w = n * count
        for k in range(count):
            p, q = row_at(values, x + LANES * k), row_at(values, y + LANES * k)
            r = row_at(values, z + LANES * k)
            m = number_at(weight, w)
            a0, a1, a2 = a0 + p * m, a1 + q * m, a2 + r * m
            m = number_at(weight, w + 1)
            b0, b1, b2 = b0 + p * m, b1 + q * m, b2 + r * m
            m = number_at(weight, w + 2)
            c0, c1, c2 = c0 + p * m, c1 + q * m, c2 + r * m
            m = number_at(weight, w + 3)
            d0, d1, d2 = d0 + p * m, d1 + q * m, d2 + r * m
            w += OUTPUTS
        _finish(layer, outputs, block, n, (a0, b0, c0, d0))
        _finish(layer, outputs, block + 1, n, (a1, b1, c1, d1))
        _finish(layer, outputs, block + 2, n, (a2, b2, c2, d2))


@kernel
def _two_blocks(layer, inputs, added, outputs, block, count):
    weight, values = layer.weight, inputs.values
    x, y = _starts(inputs, block), _starts(inputs, block + 1)
    for n in range(0, len(layer.bias), OUTPUTS):
        a0, b0, c0, d0 = _begin(layer, added, block, n)
        a1, b1, c1, d1 = _begin(layer, added, block + 1, n)
        w = n * count
        for k in range(count):
            p, q = row_at(values, x + LANES * k), row_at(values, y + LANES * k)
            m = number_at(weight, w)
            a0, a1 = a0 + p * m, a1 + q * m
            m = number_at(weight, w + 1)
            b0, b1 = b0 + p * m, b1 + q * m
            m = number_at(weight, w + 2)
            c0, c1 = c0 + p * m, c1 + q * m
            m = number_at(weight, w + 3)
            d0, d1 = d0 + p * m, d1 + q * m
            w += OUTPUTS
        _finish(layer, outputs, block, n, (a0, b0, c0, d0))
        _finish(layer, outputs, block + 1, n, (a1, b1, c1, d1))


@kernel
def _one_block(layer, inputs, added, outputs, block, count):
    weight, values = layer.weight, inputs.values
    x = _starts(inputs, block)
    for n in range(0, len(layer.bias), OUTPUTS):
        a0, b0, c0, d0 = _begin(layer, added, block, n)
        w = n * count
        for k in range(count):
            p = row_at(values, x + LANES * k)
            m = number_at(weight, w)
            a0 = a0 + p * m
            m = number_at(weight, w + 1)
            b0 = b0 + p * m
            m = number_at(weight, w + 2)
            c0 = c0 + p * m
            m = number_at(weight, w + 3)
            d0 = d0 + p * m
            w += OUTPUTS
        _finish(layer, outputs, block, n, (a0, b0, c0, d0))


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
