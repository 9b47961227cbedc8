"""The pace of folds once more: what a frame keeps, by how fast the network moves cloth and how stiff that is."""

from __future__ import annotations

import math

import numpy as np

MOMENTUM, FAST_MOMENTUM, STIFF_MOMENTUM = 0.9, 0.7, 0.5
SETTLING_MOMENTUM, LONG_ROUNDS = 0.98, 16
SLOW_M, FAST_M = 0.01, 0.02
STIFF_N_PER_M = 1000.0
SHAKEN, SHAKEN_M_S, FADE_S = 0.5, 0.1, 1.0


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


def momentum_of(calm: float, *, stiff: bool) -> float:
    """The share of the last step's way that comes before a step."""
    least = STIFF_MOMENTUM if stiff else FAST_MOMENTUM
    return least + calm * (MOMENTUM - least)
