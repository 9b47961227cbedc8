"""How unlike those of training every pose is (``drape.body.pose_support``); others do more for such frames."""

from __future__ import annotations

from dataclasses import replace

from service.stages.batch import Batch, Plan, Stage, joined


class Novelty(Stage):
    """Scores the poses of all inputs in one go, where the model says which it was trained on."""

    name = "novelty"

    def wanted(self, plan: Plan) -> bool:
        return self.engine.pose_support is not None

    def run(self, batch: Batch) -> Batch:
        assert self.engine.pose_support is not None
        found = self.engine.pose_support.novelty(joined([one.poses for one in batch.inputs], axis=0))
        return replace(batch, quality=replace(batch.quality, novelty=found))
