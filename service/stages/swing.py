"""Swing: cloth that hangs freely goes on where it went, by its own mass, on a coarse mesh."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.live.fold_step import Frame
from drape.live.swing_constants import constants
from drape.live.swing_step import Constants, Memory, swing, warm_up
from service.compute.fabrics import layer_fabrics
from service.graphs.engine import SKIN, Engine
from service.settings import Settings
from service.stages.batch import Batch, Plan, Stage

KEPT = 256  # garments in fabrics, a megabyte at most each; what is in use stays


class Swing(Stage):
    """Moves each layer's vertices by the swing of its nodes, times the knob; what lies near the skin stays."""

    name = "swing"
    kept = (Memory,)

    def __init__(self, engine: Engine, body: BodyModel, settings: Settings) -> None:
        super().__init__(engine, body, settings)
        self._garments: dict[str, Garment] = {}
        self._constants: dict[tuple[str, str], Constants | None] = {}
        self._looking, self._making = threading.Lock(), threading.Lock()
        warm_up()

    def check(self, plan: Plan) -> None:
        if plan.options.inertia == "mesh" and plan.options.geometry == "jets":
            raise InputError(
                "inertia",
                expected="network with geometry jets, whose polynomials have no nodes",
                got="mesh",
                cure="Ask for vertices, or leave inertia out.",
            )

    def wanted(self, plan: Plan) -> bool:
        return bool(plan.options.knob) and plan.options.inertia == "mesh"

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices", SKIN})

    def depends_on(self, plan: Plan) -> object:
        return layer_fabrics(plan.options, len(plan.keys))

    def rested(self, memory: Memory, time_s: float) -> Memory:
        return replace(memory, time_s=time_s)

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        self._garments[garment.digest] = garment

    def remove(self, garment: Garment) -> None:
        with self._looking:
            self._garments.pop(garment.digest, None)
            for name in [name for name in self._constants if name[0] == garment.digest]:
                del self._constants[name]

    def prepare(self, plan: Plan) -> None:
        for key, fabric in zip(plan.draped_keys, layer_fabrics(plan.options, len(plan.keys)), strict=True):
            self._of(key, fabric)

    def run(self, batch: Batch) -> Batch:
        *_, last = self.steps(batch)
        return last

    def steps(self, batch: Batch) -> Iterator[Batch]:
        """Layer after layer."""
        plan, layers = batch.plan, list(batch.layers)
        assert batch.skin is not None
        skin = batch.skin.reshape(len(batch.skin), -1, batch.skin.shape[-1])
        fabrics = layer_fabrics(plan.options, len(plan.keys))
        for i, (key, fabric) in enumerate(zip(plan.draped_keys, fabrics, strict=True)):
            made, drape = self._of(key, fabric), layers[i].vertices
            if made is not None and drape is not None:
                vertices, after = np.empty_like(drape), []
                for (one, rows), memory in zip(batch.rows(), batch.remembered((self.name, key)), strict=True):
                    for number, row in enumerate(range(rows.start, rows.stop)):
                        frame = Frame(drape[row], skin[row], float(one.times_s[number]))
                        vertices[row], memory = swing(
                            made, memory, frame, batch.root[row], share=float(plan.options.knob or 0.0)
                        )
                    after.append(memory)
                layers[i] = replace(layers[i], vertices=vertices)
                batch = batch.remember((self.name, key), after)
            yield replace(batch, layers=tuple(layers))

    def _of(self, key: str, fabric: Fabric | None) -> Constants | None:
        """The constants of the garment ``key`` made of ``fabric``, made once; the latest used are kept."""
        name = key, "" if fabric is None else fabric.digest
        found, kept = self._found(name)
        if found:
            return kept
        with self._making:  # one at a time; frames, whose constants are there, do not wait
            found, kept = self._found(name)
            if not found:
                kept = self.constants_process.call(constants, self._garments[key], self.body, fabric)
                with self._looking:
                    self._constants[name] = kept
                    while len(self._constants) > KEPT:
                        del self._constants[next(iter(self._constants))]
        return kept

    def _found(self, name: tuple[str, str]) -> tuple[bool, Constants | None]:
        """Whether there are constants of that ``name``, which may be none, and they."""
        with self._looking:
            if name not in self._constants:
                return False, None
            self._constants[name] = self._constants.pop(name)
            return True, self._constants[name]
