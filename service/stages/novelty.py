"""The novelty of each pose against those of training (``drape.body.pose_support``); folds do more for novel ones."""

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
