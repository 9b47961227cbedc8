"""Vertices leave the colliders of a scene (``drape.geometry.colliders``) where no folds run."""

from __future__ import annotations

import numpy as np

from drape.engine.calls import call
from drape.engine.packer import Record
from drape.live.clock import Surroundings


def leave(x: np.ndarray, colliders: np.ndarray, clearance_m: float) -> None:
    """Moves the vertices ``x`` [m] (V, 3) in place: those nearer than ``clearance_m`` [m] to one of ``colliders`` go to
    this distance from it.

    A row of ``colliders`` (M, 16) is a rounded box: centre [m] (3), three unit axes (9), half sizes [m] (3) and radius
    [m], in the frame of ``x`` (``drape.geometry.colliders``). The body is not looked at.
    """
    around = Surroundings(np.zeros((0, 8), x.dtype), np.ascontiguousarray(colliders, np.float64))
    call("leave", x.dtype, x, len(x), Record("Surroundings", around), float(clearance_m))
