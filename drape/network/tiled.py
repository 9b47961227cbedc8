"""Weights of layers for a processor's tiles (AMX, for numbers of 16 bits), as ``drape/engine/source/tiles.hpp`` reads
them."""

from __future__ import annotations

import numpy as np

from drape.engine.library import LANES

INPUTS = 32  # inputs of a tile
GROUP = 2 * LANES  # outputs that are summed at once for two blocks of patches
_LINE = 16  # numbers of 32 bits in a line of the cache


def tiles_of(weight: np.ndarray) -> np.ndarray:
    """Returns ``weight`` (outputs, inputs) as tiles, flat uint32, each number split in two of 16 bits (``split``).

    Each ``GROUP`` of outputs and ``INPUTS``, filled up with zeros, has four tiles: two of the remainders, then two of
    the leading numbers.
    """
    missing = [(0, -size % whole) for size, whole in zip(weight.shape, (GROUP, INPUTS), strict=True)]
    groups = np.pad(weight, missing).astype(np.float32)
    groups = groups.reshape(-1, 2, LANES, groups.shape[1] // INPUTS, INPUTS).transpose(0, 3, 1, 2, 4)
    high, low = split(groups)
    return _aligned(np.stack([low, high], axis=2).reshape(-1))


def split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns ``values`` (..., 2 n) float32 as sums of two numbers of 16 bits (bfloat16): the nearest one, and the one
    nearest to the remainder.

    Both are uint32 (..., n), two numbers in each; the first is in the lower half.
    """
    high = _upper(values)
    low = _upper(values - high.view(np.float32))
    return _pairs(high), _pairs(low)


def _upper(values: np.ndarray) -> np.ndarray:
    bits = np.ascontiguousarray(values, np.float32).view(np.uint32)
    return (bits + (0x7FFF + ((bits >> 16) & 1))) & np.uint32(0xFFFF0000)  # rounded to the nearest, ties to even


def _pairs(upper: np.ndarray) -> np.ndarray:
    return (upper[..., 0::2] >> 16) | upper[..., 1::2]


def _aligned(array: np.ndarray) -> np.ndarray:
    """A copy of the flat ``array`` that begins where tiles are read fastest: a row within one line of the cache."""
    room = np.empty(array.size + _LINE, array.dtype)
    start = -(room.ctypes.data // room.itemsize) % _LINE
    room[start : start + array.size] = array
    return room[start : start + array.size]
