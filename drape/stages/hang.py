"""Drawn meshes that hang on the draped cloth (``drape.garment.bound``), and hats and shoes that bones carry."""

from __future__ import annotations

import numpy as np

from drape.garment.accessories import carried_rows
from drape.garment.cache import Garment
from drape.stages.batch import Batch, changed
from drape.stages.plan import Plan
from drape.stages.stage import KeptConstants, Stage, StageSetup


class Hang(Stage):
    """The stage that moves the meshes that are drawn in place of the draped cloth. Where a garment's file is no single
    layer of cloth, its mesh follows the cloth. Hats and shoes follow the body's bones."""

    name = "hang"

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        self._carried = KeptConstants[tuple[np.ndarray, np.ndarray]]()

    def wanted(self, plan: Plan) -> bool:
        return plan.options.geometry == "vertices" and any(
            (entry.garment.drawn is not None or entry.garment.carriers) and seen
            for entry, seen in zip(plan.scene.layers, plan.visible, strict=True)
        )

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices"})

    def run(self, batch: Batch) -> Batch:
        layers = list(batch.layers)
        for i, (entry, seen) in enumerate(zip(batch.plan.scene.layers, batch.plan.visible, strict=True)):
            cloth = layers[i].vertices
            if seen and cloth is not None and entry.garment.carriers:
                layers[i] = changed(layers[i], vertices=self._moved(batch, entry.garment))
            elif seen and cloth is not None:
                layers[i] = changed(layers[i], vertices=entry.garment.drawn_vertices(cloth))
        return changed(batch, layers=tuple(layers))

    def remove(self, garment: Garment) -> None:
        self._carried.forget(garment.digest)

    def _moved(self, batch: Batch, garment: Garment) -> np.ndarray:
        """The drawn vertices [m] (F, D, 3) of what bones carry, relative to the roots, float32."""
        at_rest, rows = self._carried.get((garment.digest,), lambda: self._carrying(garment))
        frames = []
        for client in batch.inputs:
            joints = self.body.rest_joints(client.betas)
            rotations, translations = self.body.bones(client.poses, None, client.betas)
            placed = at_rest + (joints - self.body.joints_template)[rows]
            frames.append(np.einsum("fvab,vb->fva", rotations[:, rows], placed) + translations[:, rows] - joints[0])
        return np.concatenate(frames).astype(np.float32)

    def _carrying(self, garment: Garment) -> tuple[np.ndarray, np.ndarray]:
        """Where the drawn vertices are at rest [m] (D, 3), and the bone (D,) that carries each."""
        at_rest = garment.drawn_at_rest().astype(np.float64)
        rows = carried_rows(at_rest, garment.surface.faces, self.body.joints_template, garment.carriers)
        return at_rest, rows
