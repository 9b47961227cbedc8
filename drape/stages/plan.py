"""What frames take: the plan of a scene under its options, and how it is made."""

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
    kept: ClassVar[tuple[type, ...]] = ()  # the classes of what it remembers, which streams take to other processes

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        """Options that this stage reads, by name, with the values that hold where clients left them open.

        Refuses (``InputError``) what the model cannot do.
        """
        return {}

    def check(self, plan: Plan) -> None:
        """Refuses (``InputError``) a plan that this stage cannot follow."""

    def wanted(self, plan: Plan) -> bool:
        """Whether frames of ``plan`` take this stage."""
        return True

    def needs(self, plan: Plan) -> frozenset[str]:
        """The network's outputs that it reads: "vertices", "jets", "skin"; and "fine" for the subdivided meshes."""
        return frozenset()

    def joins_layers(self, plan: Plan) -> bool:
        """Whether a layer feels those below it here."""
        return False

    def presses_layers(self, plan: Plan) -> bool:
        """Whether a layer gives way here to those above it."""
        return False

    def depends_on(self, plan: Plan) -> object:
        """The part of the options that its memories hold for: they are forgotten where it changes."""
        return None

    def rested(self, memory: Any, time_s: float) -> Any:
        """Returns ``memory`` as it would be after another frame, at ``time_s`` [s], of a body and of cloth that stand
        still."""
        return memory

    def parts(self, plan: Plan) -> Sequence[Callable[[], object]]:
        """Returns calls that make what the frames of ``plan`` need and takes long: from any thread, in any order."""
        return ()

    def prepare(self, plan: Plan) -> None:
        """Makes all ``parts`` of what the frames of ``plan`` need."""
        for part in self.parts(plan):
            part()


@dataclass(frozen=True)
class Plan:
    """A scene and the options for it, nothing left open: frames of equal plans are computed together.

    ``scene`` holds what must be draped, among it hidden garments that visible ones feel; ``shown`` is what comes.
    ``fabrics``: what each layer of the scene is made of, None for the garment's own. ``stages``: those that the plan
    takes, in their order. ``needs``: what of "vertices", "jets" and "skin" these and the answer read; the network makes
    nothing else. ``draped``: what the network drapes, the scene's garments or, where a stage needs "fine", their
    subdivided meshes; that stage leaves the scene's. ``messages``: frames leave as messages of the wire. ``stepped``:
    the service is under load and computes less than was asked for. ``carried``: no step of folds runs; those of the
    frames before fade.
    """

    scene: Scene
    options: DrapeOptions
    messages: bool = False
    stages: tuple[StageRules, ...] = ()
    needs: frozenset[str] = frozenset()
    stepped: bool = False
    carried: bool = False
    draped: tuple[Entry, ...] = ()
    fabrics: tuple[Fabric | None, ...] = field(default=(), compare=False)  # of options and scene

    @cached_property
    def kept(self) -> dict[str, Any]:
        """A store for what is made once for all frames of this plan (``drape.stages.frame``); empty at first."""
        return {}

    @cached_property
    def keys(self) -> tuple[str, ...]:
        """Digests of the garments, the innermost first."""
        return tuple(entry.garment.digest for entry in self.scene.layers)

    @cached_property
    def known(self) -> tuple[Entry, ...]:
        """The garments whose constants its stages take: what the network drapes, and the scene's where the projection
        moves these."""
        return (*(self.scene.layers if self.projected else ()), *self.draped)

    @cached_property
    def folds(self) -> bool:
        """Whether steps of folds are taken, or cloth is at least eased and lifted as they would."""
        return bool(self.options.advanced.folds or self.options.advanced.coarse)

    @cached_property
    def lifted(self) -> bool:
        """Whether folds bring all cloth off the skin and off the layers below. They do for one garment, and for several
        if these feel each other (``cloth_contact``)."""
        return self.folds and (bool(self.options.advanced.cloth_contact) or len(self.scene.layers) == 1)

    @cached_property
    def projected(self) -> bool:
        """Whether the collision projection brings the cloth out: it is asked for, and folds do not do it."""
        return bool(self.options.advanced.push_out) and not self.lifted

    @cached_property
    def colliders(self) -> np.ndarray:
        """The colliders of the scene as rows (M, 16), in the world (``drape.geometry.colliders``)."""
        return collider_rows(self.options.colliders)

    @cached_property
    def visible(self) -> tuple[bool, ...]:
        """Whether each layer of the scene is in the answer; hidden ones are not."""
        hidden = self.options.hidden or ()
        return tuple(entry.id not in hidden for entry in self.scene.layers)

    @cached_property
    def shown(self) -> Scene:
        """The scene without its hidden layers: what an answer holds."""
        if self.options.hidden is None:
            return self.scene
        return self.scene.only([entry.id for entry in self.scene.layers if entry.id not in self.options.hidden])

    @cached_property
    def draped_keys(self) -> tuple[str, ...]:
        """Digests of what the network drapes."""
        return tuple(entry.garment.digest for entry in self.draped)


def make_plan(stages: Sequence[StageRules], scene: Scene, options: DrapeOptions, *, messages: bool = False) -> Plan:
    """The plan for ``scene`` under ``options``: their values, the stages that they take, and the needs of these.

    Refuses (``InputError``) what the model cannot do.
    """
    chosen = {name: value for stage in stages for name, value in stage.resolve(options).items()}
    scene = scene.fine if options.resolution == "fine" else scene
    own = {name: getattr(options, name) for name in DrapeOptions.model_fields}  # of a request, which has more
    known = DrapeOptions().model_copy(update=own).updated(**chosen)
    plan = Plan(scene, known, messages, fabrics=layer_fabrics(known, len(scene.layers)))
    for stage in stages:
        stage.check(plan)
    taken = tuple(stage for stage in stages if stage.wanted(plan))
    felt = any(stage.joins_layers(plan) for stage in taken)
    pressed = any(stage.presses_layers(plan) for stage in taken)
    rows, known = narrowed(scene, plan.options, felt=felt, pressed=pressed)
    if len(rows) < len(scene.layers):
        scene = scene.only([scene.layers[row].id for row in rows])
    plan = replace(plan, scene=scene, options=known, fabrics=tuple(plan.fabrics[row] for row in rows))
    needs = frozenset({plan.options.geometry}).union(*(stage.needs(plan) for stage in taken))
    draped = (scene.fine if FINE in needs else scene).layers
    return replace(plan, stages=taken, needs=needs, draped=draped)
