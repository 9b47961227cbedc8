"""Vertices leave the colliders of a scene (``drape.geometry.colliders``) where no folds run."""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call
from drape.engine.packer import Record
from drape.live.clock import Surroundings


def leave(x: np.ndarray, colliders: np.ndarray, clearance_m: float) -> None:
    """Moves the vertices ``x`` [m] (V, 3) in place out of ``colliders`` (M, 16), up to ``clearance_m`` [m] off them.
    The skin does not count."""
    around = Surroundings(np.zeros((0, 8), x.dtype), np.ascontiguousarray(colliders, np.float64))
    call("leave", x.dtype, x, len(x), Record("Surroundings", around), float(clearance_m))
