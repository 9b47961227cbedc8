"""Colliders of the scene where no folds run: vertices leave them, and the push-out then keeps the skin hidden.

Swing and folds feel colliders by themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from drape.contact.projection import CLEARANCE_M
from drape.errors import InputError
from drape.geometry.colliders import seen_from
from drape.live.colliders import leave
from drape.stages.batch import Batch
from drape.stages.plan import Plan
from drape.stages.stage import Stage
from drape.wire.options import DrapeOptions


class Colliders(Stage):
    """The stage that moves vertices out of colliders, to the nearest place ``CLEARANCE_M`` off them."""

    name = "colliders"

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        return {"colliders": options.colliders or None}

    def check(self, plan: Plan) -> None:
        if plan.options.colliders and plan.options.geometry == "jets":
            raise InputError(
                "colliders",
                expected="none with geometry jets, whose polynomials do not lie on edges",
                got=str(len(plan.options.colliders)),
                cure="Ask for vertices, or leave colliders out.",
            )

    def wanted(self, plan: Plan) -> bool:
        return bool(plan.options.colliders) and not plan.options.advanced.folds

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices"})

    def run(self, batch: Batch) -> Batch:
        layers = []
        for layer in batch.layers:
            assert layer.vertices is not None
            vertices = np.array(layer.vertices, order="C")
            for x, root in zip(vertices, batch.root, strict=True):
                leave(x, seen_from(batch.plan.colliders, root), CLEARANCE_M)
            layers.append(replace(layer, vertices=vertices))
        return replace(batch, layers=tuple(layers))
