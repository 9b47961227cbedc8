"""The stages of the service in this process, without its server: what a stream or a single frame computes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.clock import Clock
from service.stages.batch import Batch, Memories, PoseInput
from service.stages.plan import Plan
from service.stages.stage import run


class Stream:
    """Frames under one plan, one after the other; each goes on from what the stages remember of those before."""

    def __init__(self, plan: Plan, shape_count: int) -> None:
        self.plan, self.clock, self._betas = plan, Clock(), np.zeros(shape_count)
        self.memories: Memories = {}
        for stage in plan.stages:
            stage.prepare(plan)

    def frame(self, one: PoseInput) -> Batch:
        """The drape of ``one``, which is timed; the memories that it holds are replaced by the stream's."""
        one = replace(one, memories=self.memories)
        with self.clock:
            batch = run(self.plan, [one])
        self.memories = batch.memories[0]
        return batch

    def pose(self, pose: np.ndarray, time_s: float) -> Batch:
        """The drape of ``pose`` (24, 3) at ``time_s`` on the body of mean shape, its root in its place."""
        return self.frame(PoseInput(pose[None], np.zeros((1, 3)), self._betas, np.array([time_s])))

    def forget(self) -> None:
        """Leaves the next frame without a past."""
        self.memories = {}
