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
    """The settings that stand in for options of a drape which a caller leaves open."""


class Runtime:
    """Drapes by the model that ``engine`` has opened, on ``body`` or on characters; ``make`` calls a function that
    takes long, and the ``lane`` of cards draws frames. Refuses (``ArtifactError``) a model of another body."""

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
        """The stages that drape on ``body``, which know no garment yet."""
        keep_skins(body, self._make)
        setup = StageSetup(self.engine, body, self._settings, self._make, self.lane)
        return BodyStages(body, make_stages(setup), self._make)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The stages of the standard body."""
        return self.worn.stages

    def on(self, scene: Scene) -> BodyStages:
        """Returns the stages of the body that wears ``scene``."""
        worn = scene.layers[0].worn
        return worn if isinstance(worn, BodyStages) else self.worn

    def plan(self, scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
        """Returns ``make_plan`` with the stages of the body that wears ``scene``, and the passes and folds of its
        tier.
        """
        asked = chosen(options, self.tiers, self._settings, self.engine.pass_count)
        return make_plan(self.on(scene).stages, scene, asked, messages=messages)

    def tier_of(self, plan: Plan) -> str:
        """The name of the tier that ``plan`` is, or "custom"."""
        return tier_of(plan.options, self.tiers, self.engine.pass_count)

    @property
    def step_count(self) -> int:
        """The number of plans that ``steps`` gives."""
        return 2 + sum(tier.folds > 0 for tier in self.tiers)

    def steps(self, plan: Plan) -> tuple[Plan, ...]:
        """Returns the plans that a stream of ``plan`` is held to while it steps down, the one that computes least
        first.

        The third and later ones are the tiers with folds, the least first, each cut down to what ``plan`` computes. The
        second is the least of these without what it can spare (``tiers.spared``), if the scene is a single garment,
        since layers need each other. The first is the second without steps of folds.
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
        """Gives the stages the garments that ``plan`` drapes and they do not know yet."""
        worn = self.on(plan.scene)
        for garment in worn.missing(plan.known):
            worn.add(garment, worn.feed(garment))

    def ready(self, plan: Plan) -> None:
        """Makes all that the frames of ``plan`` need."""
        self.add_missing(plan)
        for stage in plan.stages:
            stage.prepare(plan)
