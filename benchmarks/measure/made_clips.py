"""Clips that are made: a body with its arms down that turns on the spot, walks into a stop, steps up, or falls."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.scenes import Clip
from drape.body.model import BodyModel

SPIN, TURNS_PER_S = "spin", 1.0
FALL_M, GRAVITY_M_S2, LANDING_S = 1.0, 9.81, 0.12


def turned(time_s: np.ndarray, turns_per_s: float) -> np.ndarray:
    """The yaw [rad] (F,) of a body that turns ``turns_per_s`` from 1.25 s to 2.5 s, and stands before 0.5 and after
    2.8."""
    rate = np.interp(time_s, [0.5, 1.25, 2.5, 2.8], 2.0 * np.pi * turns_per_s * np.array([0.0, 1.0, 1.0, 0.0]))
    return _summed(rate, time_s)


def stopped(time_s: np.ndarray) -> np.ndarray:
    """The way [m] (F, 3) of a body that goes forward with 1.4 m/s and stops in 0.2 s."""
    rate = np.interp(time_s, [0.5, 1.0, 1.6, 1.8], [0.0, 1.4, 1.4, 0.0])
    return _summed(rate, time_s)[:, None] * np.array([0.0, 0.0, 1.0])


def stepped(time_s: np.ndarray) -> np.ndarray:
    """The way [m] (F, 3) of a body that steps up and forward by 0.3 m in 0.4 s."""
    done = np.clip((time_s - 0.5) / 0.4, 0.0, 1.0)
    return (0.3 * done**2 * (3.0 - 2.0 * done))[:, None] * np.array([0.0, 1.0, 1.0])


def fallen(time_s: np.ndarray) -> np.ndarray:
    """The way [m] (F, 3) of a body that falls by ``FALL_M`` freely and lands in ``LANDING_S``."""
    free_s = np.sqrt(2.0 * FALL_M / GRAVITY_M_S2)
    rate = np.interp(time_s, 0.5 + np.array([0.0, free_s, free_s + LANDING_S]), [0.0, -GRAVITY_M_S2 * free_s, 0.0])
    return _summed(rate, time_s)[:, None] * np.array([0.0, 1.0, 0.0])


WAYS: dict[str, Callable[[np.ndarray], np.ndarray]] = {"stop": stopped, "step": stepped, "fall": fallen}
MADE = (SPIN, *WAYS)


def made_clip(name: str, body: BodyModel, fps: float, seconds: float, turns_per_s: float = TURNS_PER_S) -> Clip:
    """The clip ``name`` of ``MADE``."""
    time_s = np.arange(round(seconds * fps)) / fps
    poses = np.zeros((len(time_s), 24, 3))
    poses[:, 16, 2], poses[:, 17, 2] = -1.1, 1.1
    if name == SPIN:
        poses[:, 0, 1] = (turned(time_s, turns_per_s) + np.pi) % (2.0 * np.pi) - np.pi
        return Clip.of(name, fps, poses, body)
    return Clip.of(name, fps, poses, body, trans=WAYS[name](time_s))


def _summed(rate: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s))])
