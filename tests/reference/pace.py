"""The pace of folds once more: what work a frame gets, by how fast the network moves cloth and how stiff that is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

MOMENTUM, FAST_MOMENTUM, STIFF_MOMENTUM = 0.9, 0.7, 0.5
SETTLING_MOMENTUM, LONG_ROUNDS = 0.98, 16
SLOW_M, FAST_M, FAST_SWEEPS, STIFF_SHARE = 0.01, 0.02, 2, 0.5
STIFF_N_PER_M = 1000.0
SHAKEN, SHAKEN_M_S, FADE_S = 0.5, 0.1, 1.0


class Pace(NamedTuple):
    """``steps`` of the whole cloth, a ``share`` of each, with ``momentum``, and ``sweeps`` over its vertices."""

    steps: int
    sweeps: int
    share: float
    momentum: float


def moved_m(before: np.ndarray, network: np.ndarray) -> float:
    """RMS way [m] of the network's vertices (V, 3)."""
    return float(np.sqrt(((network - before) ** 2).sum(axis=1).mean()))


def calmness(way_m: float) -> float:
    """1 where the network moves its vertices slowly, by ``way_m`` [m], 0 where fast."""
    return min(max((FAST_M - way_m) / (FAST_M - SLOW_M), 0.0), 1.0)


def grip_left(way_m: float, step_s: float) -> float:
    """The share of friction that holds where the network moves by ``way_m`` [m] in ``step_s`` [s]."""
    return 1.0 - (1.0 - SHAKEN) * min(way_m / (SHAKEN_M_S * step_s), 1.0)


def fading(steps: int, step_s: float) -> float:
    """The share of the residual that is left after ``step_s`` [s]."""
    return 1.0 if steps else math.exp(-step_s / FADE_S)


def _mixed(calm: float) -> float:
    return STIFF_MOMENTUM + calm * (MOMENTUM - STIFF_MOMENTUM)


def paced(steps: int, calm: float, *, stiff: bool) -> Pace:
    """The pace of an effort of ``steps``: fast motion has sweeps in the place of steps, but for cloth that is stiff."""
    half = max(steps // 2, 1)
    if stiff:
        sweeps = half if calm == 1.0 else steps + FAST_SWEEPS
        return Pace(steps, sweeps, STIFF_SHARE + calm * (1.0 - STIFF_SHARE), _mixed(calm))
    momentum = FAST_MOMENTUM + calm * (MOMENTUM - FAST_MOMENTUM)
    if calm == 0.0:
        return Pace(0, steps + FAST_SWEEPS, calm, momentum)
    return Pace(steps, half + (FAST_SWEEPS if calm < 1.0 else 0), calm, momentum)
