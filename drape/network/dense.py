"""Layers of the network as the engine runs them: sums over the inputs of all rows of patches, and of one body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES, has_tiles
from drape.engine.packer import Recorded
from drape.network.tiled import tiles_of

OUTPUTS = 8  # of a row of patches that are summed at once


@dataclass(frozen=True, eq=False)
class Layer(Recorded):
    """A layer: flat ``weight`` and ``bias`` (outputs,), filled up with zeros. A negative sum is multiplied by the
    ``slope``: 1 where nothing bends.

    Of patches ``weight`` is (outputs / 8, inputs, 8); ``tiles`` are the same weights for a processor that has tiles,
    else none (``drape.network.tiled``). Of a body it is (outputs / 16, inputs, 16), so that memory is read from end to
    end, and there are no ``tiles``.
    """

    weight: np.ndarray
    bias: np.ndarray
    slope: float
    tiles: np.ndarray


def layer(weight: np.ndarray, bias: np.ndarray, slope: float = 1.0, *, tiles: bool = True) -> Layer:
    """The layer of patches of ``weight`` (outputs, inputs) and ``bias`` (outputs,), in the type of ``weight``: by
    ``tiles`` where the processor has them."""
    tiled = tiles and weight.dtype == np.float32 and has_tiles()
    return _layer(weight, bias, slope, OUTPUTS, tiles_of(weight) if tiled else np.empty(0, np.uint32))


def body_layer(weight: np.ndarray, bias: np.ndarray | None = None, slope: float = 1.0) -> Layer:
    """The layer of a body of ``weight`` (outputs, inputs) and ``bias`` (outputs,), none of zeros."""
    bias = np.zeros(len(weight), weight.dtype) if bias is None else bias
    return _layer(weight, bias, slope, LANES, np.empty(0, np.uint32))


def _layer(weight: np.ndarray, bias: np.ndarray, slope: float, outputs: int, tiles: np.ndarray) -> Layer:
    """``weight`` as (n, inputs, ``outputs``), flat: ``outputs`` of one input side by side."""
    missing = -len(weight) % outputs
    filled = np.pad(weight, ((0, missing), (0, 0))).reshape(-1, outputs, weight.shape[1])
    return Layer(np.ascontiguousarray(filled.transpose(0, 2, 1)).reshape(-1), np.pad(bias, (0, missing)), slope, tiles)


class Rows(NamedTuple):
    """Numbers of patches, ``count`` for each: ``values`` flat, sixteen patches a row, the rows of a block of patches
    one after the other. A layer reads or writes them from row ``first`` of a block on."""

    values: np.ndarray
    count: int
    first: int


def run_layer(made: Layer, inputs: Rows, outputs: Rows, added: Rows | None = None) -> None:
    """Applies the layer ``made`` to ``inputs``, adds ``added`` if given, and writes the sums to ``outputs``."""
    blocks = len(inputs.values) // (LANES * inputs.count)
    more = (np.empty(0, made.weight.dtype), 0) if added is None else (added.values, added.count)
    call_with_scratch("layer", made.weight.dtype, made, *inputs, *more, *outputs, blocks)


def rows_of(values: np.ndarray) -> np.ndarray:
    """Returns ``values`` (K, ...) of K patches as rows (blocks, n, 16). The last patch fills up the last block."""
    flat = values.reshape(len(values), -1)
    filled = np.concatenate([flat, np.repeat(flat[-1:], -len(flat) % LANES, axis=0)])
    return np.ascontiguousarray(filled.reshape(-1, LANES, flat.shape[1]).swapaxes(1, 2))
