"""Points in whole steps of their box, by the engine: ``drape.wire.messages.quantise``, to the bit."""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call
from drape.wire.messages import STEP_COUNT


def quantise(positions: np.ndarray, count: int = STEP_COUNT) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns finite ``positions`` [m] (V, 3) as steps (V, 3) uint16 from 0 to ``count`` in their box, the box's low
    corner (3,) and the size of a step (3,), float32 [m]."""
    steps, box = np.empty(positions.shape, np.uint16), np.empty((2, 3), np.float32)
    call("quantise", np.float32, np.ascontiguousarray(positions, np.float32), len(positions), float(count), steps, box)
    return steps, box[0], box[1]
