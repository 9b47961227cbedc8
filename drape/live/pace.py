"""The pace of folds: what work a frame gets, by how fast the network moves the cloth and how stiff that is."""

from __future__ import annotations

import math
from typing import NamedTuple

from drape.kernels.compiled import kernel

# The share of the last step's way that comes before a step: in slow motion, and in fast motion of soft and stiff cloth.
MOMENTUM, FAST_MOMENTUM, STIFF_MOMENTUM = 0.9, 0.7, 0.5
# That of a frame without a past with at least so many rounds: sixty rounds then come as far as five hundred with 0.9.
# Eight rounds would come less far.
SETTLING_MOMENTUM, LONG_ROUNDS = 0.98, 16
SLOW_M, FAST_M = 0.01, 0.02  # RMS way of the network's vertices a frame, between which motion becomes fast
FAST_SWEEPS = 2  # sweeps that fast motion adds
STIFF_SHARE = 0.5  # what fast motion leaves of a step of the whole in stiff cloth
# Mean membrane stiffness along warp and weft from which cloth counts as stiff: denim, satin, poplin, but no knit.
STIFF_N_PER_M = 1000.0
# Shaken cloth creeps: the share of friction that is left where the network moves by so much a second or more.
SHAKEN, SHAKEN_M_S = 0.5, 0.1
FADE_S = 1.0  # in which folds without steps come down to 1/e


@kernel
def calmness(way_m):
    """1 where the network moves its vertices slowly, by ``way_m`` [m] (``moved_m``), 0 where fast."""
    return min(max((FAST_M - way_m) / (FAST_M - SLOW_M), 0.0), 1.0)


@kernel
def grip_left(way_m, step_s):
    """The share of friction with the skin that holds where the network moves its vertices by ``way_m`` [m]
    (``moved_m``) in ``step_s`` [s]: 1 at rest, ``SHAKEN`` from ``SHAKEN_M_S`` on."""
    return 1.0 - (1.0 - SHAKEN) * min(way_m / (SHAKEN_M_S * step_s), 1.0)


@kernel
def fading(steps, step_s):
    """The share of the residual that is left after ``step_s`` [s]: 1 where there are ``steps``, less without."""
    return 1.0 if steps else math.exp(-step_s / FADE_S)


class Pace(NamedTuple):
    """``steps`` of the whole cloth, a ``share`` of each, with ``momentum``, and ``sweeps`` over its vertices."""

    steps: int
    sweeps: int
    share: float
    momentum: float


@kernel
def paced(steps, calm, stiff):
    """The pace of an effort of ``steps`` in motion that is ``calm`` (``calmness``), for cloth that is ``stiff`` or not.

    A step of the whole answers to where soft cloth was, and in fast motion that is out of date: steps fade out, and
    sweeps take their place. Stiff cloth crumples without steps: half of each stays, with less momentum, and sweeps for
    contact are added.
    """
    half = max(steps // 2, 1)
    if stiff:
        momentum = STIFF_MOMENTUM + calm * (MOMENTUM - STIFF_MOMENTUM)
        sweeps = half if calm == 1.0 else steps + FAST_SWEEPS
        return Pace(steps, sweeps, STIFF_SHARE + calm * (1.0 - STIFF_SHARE), momentum)
    momentum = FAST_MOMENTUM + calm * (MOMENTUM - FAST_MOMENTUM)
    if calm == 0.0:
        return Pace(0 * steps, steps + FAST_SWEEPS, calm, momentum)
    return Pace(steps, half + (FAST_SWEEPS if calm < 1.0 else 0), calm, momentum)
