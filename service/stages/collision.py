"""The collision projection (the push-out): every garment out of the body and of the garments below it.

Folds end off the skin by themselves, from the planes that they know anyway; then there is nothing left to project.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from drape.contact.projection import MOVED_M
from drape.garment.cache import Garment
from drape.wire.options import DrapeOptions
from service.graphs.push import PosedJets, Pushed, Pusher
from service.stages.batch import SKIN, Batch, Jets, Layer, Plan, Stage, StageSetup, joined


class Collision(Stage):
    """Pushes the layers, the innermost first, and in their jets where these are what is asked for."""

    name = "collision"

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        self.pusher = Pusher(self.engine, self.body, self.settings.clearance_m, make=self.make)

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        return {"push_out": self.settings.push_out if options.push_out is None else options.push_out}

    def wanted(self, plan: Plan) -> bool:
        return plan.projected

    def joins_layers(self, plan: Plan) -> bool:
        return True

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices", SKIN})

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        vertices = garment.vertices[: garment.vertex_count]
        self.pusher.add(garment.digest, feed, vertices, garment.faces)

    def remove(self, garment: Garment) -> None:
        self.pusher.remove(garment.digest)

    def prepare(self, plan: Plan) -> None:
        self.pusher.prepare(plan.keys, jets=plan.options.geometry == "jets")

    @property
    def held_bytes(self) -> int:
        return self.pusher.held_bytes

    def run(self, batch: Batch) -> Batch:
        layers: list[Layer] = []
        ways, left = [], []
        for count, seen in enumerate(batch.plan.visible, start=1):
            under = joined([layer.vertices for layer in layers]) if layers else None
            before = batch.layers[count - 1].jets if seen else None
            parts = [self._pushed(batch, count, under, rows, before) for _, rows in batch.rows()]
            held = None if before is None else replace(before, jet=joined([part.jet for part in parts], axis=0))
            layers.append(Layer(joined([part.vertices for part in parts], axis=0), held))
            if seen:
                ways.append(joined([part.way_m for part in parts], axis=0))
            if held is not None:
                left.append(joined([part.left_m for part in parts], axis=0))
        way = joined(ways)
        share, furthest = (way > MOVED_M).mean(axis=1), way.max(axis=1)
        left_m = np.max(left, axis=0) if left else batch.quality.left_m
        quality = replace(batch.quality, pushed_share=share, push_max_m=furthest, left_m=left_m)
        return replace(batch, layers=tuple(layers), quality=quality)

    def _pushed(self, batch: Batch, count: int, under: np.ndarray | None, rows: slice, jets: Jets | None) -> Pushed:
        """The frames ``rows`` of the layer ``count - 1``, one body's, and of its ``jets`` where they come: as many
        frames as it has alone."""
        layer = batch.layers[count - 1]
        assert layer.vertices is not None and batch.skin is not None
        posed = None if jets is None else PosedJets(jets.jet[rows], jets.rotation[rows])
        below = None if under is None else under[rows]
        keys = batch.plan.keys[:count]
        return self.pusher.push(keys, layer.vertices[rows], batch.skin[rows], under=below, posed=posed)
