"""Batches filled up to sizes of a ladder, so that a device sees few sets of shapes whatever clients ask for.

The filling repeats the first patch, tile, block and body: it is computed and not read. An item's numbers do
not depend on what else is in its batch (``drape.graph.packing``), so they do not depend on this either.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from drape.graph.inputs import PARTS
from drape.graph.packed import Indices
from drape.graph.packing import Composition

SMALLEST = 8
# Axes of each index tensor along which it is filled: those whose length depends on the batch.
AXES = {
    spec.name: tuple(i for i, axis in enumerate(spec.shape) if isinstance(axis, str)) for spec in Indices.specs(PARTS)
}


def bucket_size(count: int) -> int:
    """The least of 8, 12, 16, 24, 32, 48, ... that is not below ``count``: at most half as much again."""
    size = SMALLEST
    while size < count:
        size = 3 * size // 2 if size & (size - 1) == 0 else 4 * size // 3
    return size


def filled(composition: Composition) -> Composition:
    """``composition`` with its patches, tiles, blocks and anchor blocks on the ladder."""
    arrays = {name: _filled(array, AXES[name]) for name, array in composition.arrays.items()}
    return Composition(arrays, composition.patches, composition.vertices)


def filled_rows(bodies: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Rows of ``bodies`` on the ladder."""
    return {name: _filled(rows, (0,)) for name, rows in bodies.items()}


def _filled(array: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    for axis in axes:
        missing = bucket_size(array.shape[axis]) - array.shape[axis]
        if missing:
            array = np.concatenate([array, np.repeat(array.take([0], axis=axis), missing, axis=axis)], axis=axis)
    return np.ascontiguousarray(array)
