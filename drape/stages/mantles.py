"""Mantles: cloth that covers arms lies as it does over arms that point so (``drape.garment.mantle_shapes``)."""

from __future__ import annotations

import numpy as np

from drape.garment.cache import Garment
from drape.garment.mantle_shapes import worn
from drape.garment.skin import BodyBinding
from drape.stages.batch import Batch, changed
from drape.stages.plan import Plan
from drape.stages.stage import KeptConstants, Stage, StageSetup


class Mantles(Stage):
    """The stage that shapes mantles, cloth that covers the arms and has no sleeves, by where the arms point. Its
    vertices take the place of the network's, which has learned nothing of such cloth."""

    name = "mantles"

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        self._bindings = KeptConstants[BodyBinding]()

    def wanted(self, plan: Plan) -> bool:
        has_mantle = any(entry.garment.arm_ways is not None for entry in plan.scene.layers)
        return has_mantle and plan.options.geometry == "vertices"

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices"})

    def remove(self, garment: Garment) -> None:
        self._bindings.forget(garment.digest)

    def run(self, batch: Batch) -> Batch:
        layers = list(batch.layers)
        for i, entry in enumerate(batch.plan.draped):
            if entry.garment.arm_ways is not None:
                layers[i] = changed(layers[i], vertices=self._laid(batch, entry.garment))
        return changed(batch, layers=tuple(layers))

    def _laid(self, batch: Batch, garment: Garment) -> np.ndarray:
        """The vertices [m] (F, V, 3) of a mantle relative to the roots, float32."""
        assert garment.arm_ways is not None
        count = garment.vertex_count
        binding = self._bindings.get((garment.digest,), lambda: self._delivered(garment))
        rest, ways = garment.vertices[:count].astype(np.float64), garment.arm_ways[:count]
        frames = [worn(rest, ways, binding, self.body, client.poses, client.betas) for client in batch.inputs]
        return np.concatenate(frames).astype(np.float32)

    def _delivered(self, garment: Garment) -> BodyBinding:
        """The binding of the vertices that leave this stage."""
        whole, count = garment.binding(self.body), garment.vertex_count
        return BodyBinding(whole.weights[:count], whole.shapedirs[:count])
