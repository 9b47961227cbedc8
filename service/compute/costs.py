"""What a frame of a scene costs on this machine, measured where a client first asks for a budget."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from drape.body.model import BodyModel
from service.stages import run
from service.stages.batch import Plan, PoseInput

FRAMES = 7  # of which the first has no past, and pays for what is made once
STEP_S = 1.0 / 30.0
TURN_RAD = 0.02  # a frame: cloth in slow motion, so that no stage takes its short way


class Probe:
    """Frames of a slowly turning body under one plan, timed one by one, so that streams are served in between."""

    def __init__(self, plan: Plan, body: BodyModel, *, frames: int = FRAMES) -> None:
        self._plan, self._frames, self._took_ms = plan, frames, []
        still = (np.zeros((1, 24, 3)), np.zeros((1, 3)), np.zeros(body.shape_count), np.zeros(1))
        self._next = PoseInput(*still)

    def step(self) -> None:
        """Computes the next frame."""
        start_s = time.perf_counter()
        memories = run(self._plan, [self._next]).memories[0]
        self._took_ms.append(1e3 * (time.perf_counter() - start_s))
        poses = self._next.poses.copy()
        poses[:, 16:18, 2] += TURN_RAD  # the shoulders
        self._next = replace(self._next, poses=poses, times_s=self._next.times_s + STEP_S, memories=memories)

    @property
    def done(self) -> bool:
        return len(self._took_ms) >= self._frames

    def frame_ms(self) -> float:
        """The median time [ms] of a frame after the first."""
        return float(np.median(self._took_ms[1:]))
