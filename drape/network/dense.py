"""Layers of the network as the engine runs them: sums over the inputs of all rows of patches, and of one body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES, has_tiles
from drape.engine.packer import Recorded
from drape.network.tiled import tiles_of

OUTPUTS = 8  # outputs that are summed at once for a row of patches


@dataclass(frozen=True, eq=False)
class Layer(Recorded):
    """A dense layer with the bend x -> max(x, 0) + ``slope`` min(x, 0); slope 1 is no bend. ``bias`` (outputs,) and
    ``weight`` are filled up with zeros to whole groups of outputs.

    ``weight`` is flat. For patches it is (outputs / 8, inputs, 8), and ``tiles`` has the same weights for a processor
    with tiles, else nothing (``drape.network.tiled``). For a body it is (outputs / 16, inputs, 16), so that memory is
    read from end to end, without ``tiles``.
    """

    weight: np.ndarray
    bias: np.ndarray
    slope: float
    tiles: np.ndarray


def layer(weight: np.ndarray, bias: np.ndarray, slope: float = 1.0, *, tiles: bool = True) -> Layer:
    """Returns the layer for patches with ``weight`` (outputs, inputs) and ``bias`` (outputs,), in the dtype of
    ``weight``. With ``tiles`` it has tiles if the processor has and the dtype is float32."""
    tiled = tiles and weight.dtype == np.float32 and has_tiles()
    return _layer(weight, bias, slope, OUTPUTS, tiles_of(weight) if tiled else np.empty(0, np.uint32))


def body_layer(weight: np.ndarray, bias: np.ndarray | None = None, slope: float = 1.0) -> Layer:
    """Returns the layer for a body with ``weight`` (outputs, inputs) and ``bias`` (outputs,), zeros if left out."""
    bias = np.zeros(len(weight), weight.dtype) if bias is None else bias
    return _layer(weight, bias, slope, LANES, np.empty(0, np.uint32))


def _layer(weight: np.ndarray, bias: np.ndarray, slope: float, outputs: int, tiles: np.ndarray) -> Layer:
    """``weight`` as (n, inputs, ``outputs``), flat: ``outputs`` of one input side by side."""
    missing = -len(weight) % outputs
    filled = np.pad(weight, ((0, missing), (0, 0))).reshape(-1, outputs, weight.shape[1])
    return Layer(np.ascontiguousarray(filled.transpose(0, 2, 1)).reshape(-1), np.pad(bias, (0, missing)), slope, tiles)


class Rows(NamedTuple):
    """Numbers of patches as a layer reads or writes them: ``values`` is (blocks, ``count``, 16), flat, with ``count``
    numbers for each of sixteen patches. The layer begins at the row ``first`` of each block."""

    values: np.ndarray
    count: int
    first: int


def run_layer(dense: Layer, inputs: Rows, outputs: Rows, added: Rows | None = None) -> None:
    """Writes to ``outputs`` what the layer ``dense`` makes of ``inputs``; ``added``, if given, is added to the sums
    before the bend."""
    blocks = len(inputs.values) // (LANES * inputs.count)
    more = (np.empty(0, dense.weight.dtype), 0) if added is None else (added.values, added.count)
    call_with_scratch("layer", dense.weight.dtype, dense, *inputs, *more, *outputs, blocks)


def rows_of(values: np.ndarray) -> np.ndarray:
    """Returns ``values`` (K, ...) of K patches, n numbers each, as rows (blocks, n, 16). The last patch fills up the
    last block."""
    flat = values.reshape(len(values), -1)
    filled = np.concatenate([flat, np.repeat(flat[-1:], -len(flat) % LANES, axis=0)])
    return np.ascontiguousarray(filled.reshape(-1, LANES, flat.shape[1]).swapaxes(1, 2))
