"""The plan of a scene under its options: what is draped, and the stages that its frames take."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from drape.stages.scene import Entry, Scene, layer_fabrics, narrowed
from drape.wire.colliders import collider_rows
from drape.wire.options import DrapeOptions

if TYPE_CHECKING:
    from drape.cloth.fabric import Fabric

FINE = "fine"  # what a stage needs where it computes on the subdivided meshes
SKIN = "skin"  # what a stage needs where it reads the posed samples of the skin


class StageRules:
    """The rules of a stage on plans and on its memories; ``drape.stages.stage.Stage`` adds what it does to frames."""

    name: ClassVar[str]
    kept: ClassVar[tuple[type, ...]] = ()  # the classes of its memories, which streams take to other processes

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        """Returns values for the options that this stage reads, by name, filled in where ``options`` leave them open.

        Refuses (``InputError``) what the model cannot do.
        """
        return {}

    def check(self, plan: Plan) -> None:
        """Refuses (``InputError``) a plan that this stage cannot follow."""

    def wanted(self, plan: Plan) -> bool:
        """Returns whether frames of ``plan`` take this stage."""
        return True

    def needs(self, plan: Plan) -> frozenset[str]:
        """Returns which of "vertices", "jets" and "skin" this stage reads, and "fine" if it needs the subdivided meshes
        draped."""
        return frozenset()

    def joins_layers(self, plan: Plan) -> bool:
        """Returns whether a layer feels the layers below it in this stage."""
        return False

    def presses_layers(self, plan: Plan) -> bool:
        """Returns whether a layer gives way to the layers above it in this stage."""
        return False

    def depends_on(self, plan: Plan) -> object:
        """Returns a value, made of ``plan``, that can be compared. Where it differs between two plans, this stage's
        memories are forgotten."""
        return None

    def rested(self, memory: Any, time_s: float) -> Any:
        """Returns ``memory`` as it is at ``time_s`` [s] if body and cloth have stood still since."""
        return memory

    def parts(self, plan: Plan) -> Sequence[Callable[[], object]]:
        """Returns functions without arguments that make the constants which frames of ``plan`` need. They take long;
        any thread may call them, in any order."""
        return ()

    def prepare(self, plan: Plan) -> None:
        """Makes all constants that frames of ``plan`` need: calls its ``parts``."""
        for part in self.parts(plan):
            part()


@dataclass(frozen=True)
class Plan:
    """A scene and the options for it, nothing left open: frames of equal plans are computed together.

    ``scene`` has the garments that must be draped, hidden ones included that visible ones feel. ``fabrics``: the fabric
    of each of its layers, None for the garment's own. ``stages``: those that frames take, in their order. ``needs``:
    which of "vertices", "jets" and "skin" the stages and the answer read; the network makes nothing else. ``draped``:
    the garments that the network drapes: the scene's, or their subdivided meshes where a stage needs "fine", which then
    returns to the scene's. ``messages``: frames become messages of the wire. ``stepped``: the service is under load and
    computes less than was asked for. ``carried``: no steps of folds run, and the folds of the frames before fade.
    ``worn``: how many garments were asked for, also those that need not be draped: where hidden ones are left out the
    stages stay the outfit's.
    """

    scene: Scene
    options: DrapeOptions
    messages: bool = False
    stages: tuple[StageRules, ...] = ()
    needs: frozenset[str] = frozenset()
    stepped: bool = False
    carried: bool = False
    draped: tuple[Entry, ...] = ()
    worn: int = 1
    fabrics: tuple[Fabric | None, ...] = field(default=(), compare=False)  # they follow from options and scene

    @cached_property
    def kept(self) -> dict[str, Any]:
        """Returns a store, empty at first, for what is made once for all frames of this plan
        (``drape.stages.frame``)."""
        return {}

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Returns the digests of the scene's garments, the innermost first."""
        return tuple(entry.garment.digest for entry in self.scene.layers)

    @cached_property
    def known(self) -> tuple[Entry, ...]:
        """Returns the garments whose constants the stages read: ``draped``, and the scene's where the collision
        projection runs."""
        return (*(self.scene.layers if self.projected else ()), *self.draped)

    @cached_property
    def folds(self) -> bool:
        """Returns whether the stage of folds runs: with steps, or for tiers without steps only to ease and lift
        cloth."""
        return bool(self.options.advanced.folds or self.options.advanced.coarse)

    @cached_property
    def lifted(self) -> bool:
        """Returns whether folds bring all cloth off the skin and off the layers below: those of one garment, and those
        of several that feel each other (``cloth_contact``)."""
        return self.folds and (bool(self.options.advanced.cloth_contact) or self.worn == 1)

    @cached_property
    def projected(self) -> bool:
        """Returns whether the collision projection runs: ``push_out`` asks for it, and folds do not lift the cloth."""
        return bool(self.options.advanced.push_out) and not self.lifted

    @cached_property
    def colliders(self) -> np.ndarray:
        """Returns the colliders as rows (M, 16) in the world (``drape.geometry.colliders``)."""
        return collider_rows(self.options.colliders)

    @cached_property
    def visible(self) -> tuple[bool, ...]:
        """Returns for each layer of the scene whether it is in the answer, which leaves hidden ones out."""
        hidden = self.options.hidden or ()
        return tuple(entry.id not in hidden for entry in self.scene.layers)

    @cached_property
    def shown(self) -> Scene:
        """Returns the scene without its hidden layers: the garments of the answer."""
        if self.options.hidden is None:
            return self.scene
        return self.scene.only([entry.id for entry in self.scene.layers if entry.id not in self.options.hidden])

    @cached_property
    def draped_keys(self) -> tuple[str, ...]:
        """Returns the digests of ``draped``, in their order."""
        return tuple(entry.garment.digest for entry in self.draped)


def make_plan(stages: Sequence[StageRules], scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
    """Returns the plan for ``scene`` under ``options``, whose open values are filled in, with those of ``stages`` that
    it takes.

    Refuses (``InputError``) options that the model or a stage cannot follow.
    """
    chosen = {name: value for stage in stages for name, value in stage.resolve(options).items()}
    scene = scene.fine if options.resolution == "fine" else scene
    own = {name: getattr(options, name) for name in DrapeOptions.model_fields}  # requests have more fields
    known = DrapeOptions().model_copy(update=own).updated(**chosen)
    worn = len(scene.layers)
    plan = Plan(scene, known, messages, worn=worn, fabrics=layer_fabrics(known, worn))
    for stage in stages:
        stage.check(plan)
    wanted = tuple(stage for stage in stages if stage.wanted(plan))
    felt = any(stage.joins_layers(plan) for stage in wanted)
    pressed = any(stage.presses_layers(plan) for stage in wanted)
    rows, known = narrowed(scene, plan.options, felt=felt, pressed=pressed)
    if len(rows) < worn:
        scene = scene.only([scene.layers[row].id for row in rows])
    plan = replace(plan, scene=scene, options=known, fabrics=tuple(plan.fabrics[row] for row in rows))
    needs = frozenset({plan.options.geometry}).union(*(stage.needs(plan) for stage in wanted))
    draped = (scene.fine if FINE in needs else scene).layers
    return replace(plan, stages=wanted, needs=needs, draped=draped)
