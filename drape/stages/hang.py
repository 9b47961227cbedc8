"""The drawn meshes, hung on the cloth that was draped in their place (``drape.garment.bound``)."""

from __future__ import annotations

from drape.stages.batch import Batch, changed
from drape.stages.plan import Plan
from drape.stages.stage import Stage


class Hang(Stage):
    """Draws garments whose file is no single layer of cloth."""

    name = "hang"

    def wanted(self, plan: Plan) -> bool:
        return plan.options.geometry == "vertices" and any(
            entry.garment.drawn is not None and seen
            for entry, seen in zip(plan.scene.layers, plan.visible, strict=True)
        )

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices"})

    def run(self, batch: Batch) -> Batch:
        layers = list(batch.layers)
        for i, (entry, seen) in enumerate(zip(batch.plan.scene.layers, batch.plan.visible, strict=True)):
            cloth = layers[i].vertices
            if seen and cloth is not None:
                layers[i] = changed(layers[i], vertices=entry.garment.drawn_vertices(cloth))
        return changed(batch, layers=tuple(layers))
