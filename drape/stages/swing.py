"""Swing: cloth that hangs freely goes on where it went, by its own mass, on a coarse mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from drape.cloth.fabric import Fabric
from drape.errors import InputError
from drape.geometry.colliders import seen_from
from drape.live.clock import Frame
from drape.live.swing_constants import swing_constants
from drape.live.swing_step import SwingConstants, SwingMemory, swing
from drape.stages.batch import Batch, changed, stacked
from drape.stages.plan import SKIN, Plan
from drape.stages.stage import ClothStage, StageSetup

KEPT = 256  # constants of garments in fabrics, at most a megabyte each; what is in use stays


class Swing(ClothStage[SwingConstants | None]):
    """The stage that adds to each layer the swing of its nodes, a coarse mesh with mass (``drape.live.swing_step``),
    times the motion knob. Vertices near the skin stay where they are."""

    name = "swing"
    kept = (SwingMemory,)

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup, lambda kept: len(kept) > KEPT)

    def check(self, plan: Plan) -> None:
        here = plan.options.folds_by == "server"  # a client that folds also makes the swing
        if plan.options.advanced.inertia == "mesh" and plan.options.geometry == "jets" and here:
            raise InputError(
                "advanced.inertia",
                expected="network with geometry jets, whose polynomials have no nodes",
                got="mesh",
                cure="Ask for vertices, or leave inertia out.",
            )

    def wanted(self, plan: Plan) -> bool:
        here = plan.options.folds_by == "server"
        return bool(plan.options.knob) and plan.options.advanced.inertia == "mesh" and here

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices", SKIN})

    def depends_on(self, plan: Plan) -> object:
        return plan.fabrics

    def parts(self, plan: Plan) -> Sequence[Callable[[], object]]:
        worn = zip(plan.draped_keys, plan.fabrics, strict=True)
        return [partial(self.constants, key, fabric) for key, fabric in worn]

    def steps(self, batch: Batch) -> Iterator[Batch]:
        """Yields the batch after each layer."""
        plan, layers = batch.plan, list(batch.layers)
        assert batch.skin is not None
        skin = batch.skin.reshape(len(batch.skin), -1, batch.skin.shape[-1])
        for i, (key, fabric) in enumerate(zip(plan.draped_keys, plan.fabrics, strict=True)):
            constants, drape = self.constants(key, fabric), layers[i].vertices
            if constants is not None and drape is not None:
                swung, after = [], []
                for (client, rows), memory in zip(batch.rows(), batch.remembered((self.name, key)), strict=True):
                    for number, row in enumerate(range(rows.start, rows.stop)):
                        solid = seen_from(plan.colliders, batch.root[row])
                        frame, share = (
                            Frame(drape[row], skin[row], float(client.times_s[number]), solid),
                            plan.options.knob or 0.0,
                        )
                        vertices, memory = swing(constants, memory, frame, batch.root[row], share=share)
                        swung.append(vertices)
                    after.append(memory)
                layers[i] = changed(layers[i], vertices=stacked(swung))
                batch = batch.remember((self.name, key), after)
            yield changed(batch, layers=tuple(layers))

    def constants(self, key: str, fabric: Fabric | None) -> SwingConstants | None:
        """Returns the constants of the garment ``key`` made of ``fabric``, None for its own; None where nothing of it
        swings. They are made at the first call."""
        name = key, "" if fabric is None else fabric.digest
        return self._constants.get(name, lambda: self.make(swing_constants, self._garments[key], self.body, fabric))
