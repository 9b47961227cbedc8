"""A model and a body in memory: plans of scenes, their constants and frames, for the service and for programs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from drape.body.model import BodyModel
from drape.contact.skin import keep_skins
from drape.inference.engine import Engine
from drape.stages import make_stages
from drape.stages.body_stages import BodyStages
from drape.stages.plan import Plan, make_plan
from drape.stages.scene import Scene
from drape.stages.stage import Make, Stage, StageSettings, StageSetup, call_here
from drape.stages.tiers import TierSettings, capped, chosen, read_tiers, spared, tier_of
from drape.wire.options import DrapeOptions

if TYPE_CHECKING:
    from drape.live.card_lanes import Lanes


class RuntimeSettings(StageSettings, TierSettings, Protocol):
    """The settings ``inertia``, ``tier`` and ``folds``, which hold where a caller leaves options of a drape open."""


class Runtime:
    """Drapes by the model of ``engine``, on ``body`` or on characters; ``worn`` are the stages of ``body``.

    ``make(function, *arguments)`` calls a function that takes long. ``lane`` draws frames on graphics cards, None
    without. Refuses (``ArtifactError``) a model of another body.
    """

    def __init__(
        self,
        engine: Engine,
        body: BodyModel,
        settings: RuntimeSettings,
        make: Make = call_here,
        lane: Lanes | None = None,
    ) -> None:
        engine.check_body(body)
        self.engine, self.body, self._settings, self._make = engine, body, settings, make
        self.tiers = read_tiers(engine.manifest.tiers)
        self.lane = lane
        self.worn = self.stages_on(body)

    def stages_on(self, body: BodyModel) -> BodyStages:
        """Returns new stages that drape on ``body``, without any garment."""
        keep_skins(body, self._make)
        setup = StageSetup(self.engine, body, self._settings, self._make, self.lane)
        return BodyStages(body, make_stages(setup), self._make)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Returns the stages of the standard body, in their order."""
        return self.worn.stages

    def on(self, scene: Scene) -> BodyStages:
        """Returns the stages of the body that wears ``scene``."""
        worn = scene.layers[0].worn
        return worn if isinstance(worn, BodyStages) else self.worn

    def plan(self, scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
        """Returns the plan for ``scene`` under ``options``, with the numbers of its tier filled in, on the body that
        wears ``scene``. With ``messages`` its frames become messages of the wire.

        Refuses (``InputError``) what the model cannot do.
        """
        filled = chosen(options, self.tiers, self._settings, self.engine.pass_count)
        return make_plan(self.on(scene).stages, scene, filled, messages=messages)

    def tier_of(self, plan: Plan) -> str:
        """Returns the name of the tier that has the numbers of ``plan``; "custom" if none has."""
        return tier_of(plan.options, self.tiers, self.engine.pass_count)

    @property
    def step_count(self) -> int:
        """Returns the number of plans that ``steps`` returns."""
        return 2 + sum(tier.folds > 0 for tier in self.tiers)

    def steps(self, plan: Plan) -> tuple[Plan, ...]:
        """Returns the plans to which a stream of ``plan`` can step down under load, the one that computes least first.

        From the third on they are the tiers with folds, each lowered to what ``plan`` computes. If the scene is a
        single garment, the second is the third without cloth contact (``tiers.spared``), and the first is the second
        without steps of folds (``Plan.carried``) if ``plan`` has such steps. Layers need the contact: for an outfit the
        first three are equal.
        """
        stages = self.on(plan.scene).stages
        held = [capped(plan.options, tier) for tier in self.tiers if tier.folds]
        alone = len(plan.scene.layers) == 1
        held.insert(0, spared(held[0]) if alone else held[0])
        steps = [
            plan
            if options == plan.options
            else replace(make_plan(stages, plan.scene, options, messages=plan.messages), stepped=True)
            for options in held
        ]
        carried = alone and bool(plan.options.advanced.folds)
        return (replace(steps[0], stepped=True, carried=True) if carried else steps[0], *steps)

    def add_missing(self, plan: Plan) -> None:
        """Adds to the stages the garments of ``plan`` that they do not know yet."""
        worn = self.on(plan.scene)
        for garment in worn.missing(plan.known):
            worn.add(garment, worn.feed(garment))

    def ready(self, plan: Plan) -> None:
        """Adds the missing garments of ``plan``, and makes all constants that its frames need."""
        self.add_missing(plan)
        for stage in plan.stages:
            stage.prepare(plan)
