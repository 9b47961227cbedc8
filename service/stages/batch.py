"""The batch that stages hand on: a plan, posed inputs of several clients and frames, and results so far."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.wire.options import DrapeOptions
from service.stages.placing import Origin, Placed

if TYPE_CHECKING:
    from drape.cloth.fabric import Fabric
    from service.graphs.engine import Engine
    from service.settings import Settings
    from service.stages.scene import Entry, Scene

FINE = "fine"  # what a stage needs where it computes on the subdivided meshes
BODY = ""  # the owner of what is remembered of a body, where others are garments by their digest
SKIN = "skin"  # what a stage needs where it reads the posed samples of the skin
Memories = Mapping[tuple[str, str], Any]  # by stage and owner; values are never changed in place
Make = Callable[..., Any]  # calls a function with arguments: here, or in another process while there are streams


def call_here(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """``function(*arguments, **named)``."""
    return function(*arguments, **named)


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
    stages: tuple[Stage, ...] = ()
    needs: frozenset[str] = frozenset()
    stepped: bool = False
    carried: bool = False
    draped: tuple[Entry, ...] = ()
    fabrics: tuple[Fabric | None, ...] = field(default=(), compare=False)  # of options and scene

    @property
    def keys(self) -> tuple[str, ...]:
        """Digests of the garments, the innermost first."""
        return tuple(entry.garment.digest for entry in self.scene.layers)

    @property
    def lifted(self) -> bool:
        """Whether folds bring the cloth off the skin, and off the layers below: as far as they feel these."""
        return bool(self.options.folds) and (bool(self.options.cloth_contact) or len(self.scene.layers) == 1)

    @property
    def projected(self) -> bool:
        """Whether the collision projection brings the cloth out: where that is asked for and folds do not."""
        return bool(self.options.push_out) and not self.lifted

    @property
    def visible(self) -> tuple[bool, ...]:
        """Which layers of the scene come."""
        hidden = self.options.hidden or ()
        return tuple(entry.id not in hidden for entry in self.scene.layers)

    @property
    def shown(self) -> Scene:
        """The scene without its hidden layers: what an answer holds."""
        if self.options.hidden is None:
            return self.scene
        return self.scene.only([entry.id for entry in self.scene.layers if entry.id not in self.options.hidden])

    @property
    def draped_keys(self) -> tuple[str, ...]:
        """Digests of what the network drapes."""
        return tuple(entry.garment.digest for entry in self.draped)


@dataclass(frozen=True, eq=False)
class PoseInput:
    """Checked poses (F, 24, 3) [rad], translations (F, 3) [m] and the shape (S,) of one client's body.

    ``times_s`` (F,): its clock; ``memories``: what the stages keep of the frames before. ``sequence`` is the first
    frame's; ``dropped`` and ``arrived_s`` (monotonic, None where nobody waits) go into the header of its message.
    ``shown``: the message of the frame that the client shows, where it can be told that it still holds.
    """

    poses: np.ndarray
    trans: np.ndarray
    betas: np.ndarray
    times_s: np.ndarray
    memories: Memories = field(default_factory=dict)
    sequence: int = 0
    dropped: int = 0
    arrived_s: float | None = None
    shown: bytes | None = None

    def part(self, rows: slice, memories: Memories) -> PoseInput:
        """The frames ``rows``, after what ``memories`` hold."""
        return replace(
            self,
            poses=self.poses[rows],
            trans=self.trans[rows],
            times_s=self.times_s[rows],
            memories=memories,
            sequence=self.sequence + rows.start,
        )


@dataclass(frozen=True, eq=False)
class Jets:
    """Posed patches of F frames: ``jet`` (F, K, 45), ``rotation`` (F, K, 3, 3) and ``centre`` [m] (F, K, 3) float32."""

    jet: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray


@dataclass(frozen=True, eq=False)
class Layer:
    """All frames of one garment relative to the roots: vertices [m] (F, V, 3) float32 or jets or both, as needed."""

    vertices: np.ndarray | None = None
    jets: Jets | None = None


@dataclass(frozen=True, eq=False)
class Quality:
    """Figures of each frame (F,).

    ``pushed_share`` of the vertices were moved off the skin by the collision projection or by folds, the furthest by
    ``push_max_m`` [m]. A vertex made of the jets lacks at most ``left_m`` [m] of that. ``folds_resets`` layers began
    their folds anew. ``novelty`` says how unlike training the pose is; above 1 it is outside (``body.pose_support``).
    """

    pushed_share: np.ndarray
    push_max_m: np.ndarray
    left_m: np.ndarray
    folds_resets: np.ndarray
    novelty: np.ndarray

    @staticmethod
    def untouched(frames: int) -> Quality:
        return Quality(*(np.zeros(frames) for _ in fields(Quality)))


@dataclass(frozen=True, eq=False)
class Batch:
    """Frames of several clients under one plan, one input's after the other, and what the stages have made so far.

    ``memories`` of each input, after its frames; ``codes`` (F, C) of a moving body; ``skin`` (F, R, 12, 8) posed, where
    a stage needs it; ``layers`` of the garments; ``root`` [m] (F, 3) float64; ``messages`` of the frames.
    """

    plan: Plan
    inputs: tuple[PoseInput, ...]
    memories: tuple[Memories, ...]
    quality: Quality
    codes: np.ndarray | None = None
    skin: np.ndarray | None = None
    layers: tuple[Layer, ...] = ()
    root: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    messages: tuple[bytes, ...] = ()

    @staticmethod
    def of(plan: Plan, inputs: Sequence[PoseInput]) -> Batch:
        """The batch before its first stage."""
        frames = sum(len(one.poses) for one in inputs)
        return Batch(plan, tuple(inputs), tuple(one.memories for one in inputs), Quality.untouched(frames))

    @staticmethod
    def of_parts(clip: PoseInput, parts: Sequence[Batch]) -> Batch:
        """The batch of ``clip`` from those of its parts, one after the other."""
        if len(parts) == 1:
            return parts[0]
        layers = [_whole(together) for together in zip(*(part.layers for part in parts), strict=True)]
        return replace(
            parts[-1],
            inputs=(clip,),
            quality=_whole([part.quality for part in parts]),
            layers=tuple(layers),
            root=np.concatenate([part.root for part in parts]),
            messages=tuple(message for part in parts for message in part.messages),
        )

    def answer(self) -> Batch:
        """The batch without what only stages read; of hidden layers nothing is kept."""
        of = zip(self.layers, self.plan.visible, strict=bool(self.layers))  # none before the network
        return replace(self, codes=None, skin=None, layers=tuple(layer if seen else Layer() for layer, seen in of))

    def rows(self) -> Iterator[tuple[PoseInput, slice]]:
        """Each input with its rows of the frames."""
        start = 0
        for one in self.inputs:
            yield one, slice(start, start + len(one.poses))
            start += len(one.poses)

    def remembered(self, key: tuple[str, str]) -> list[Any]:
        """The memory of each input under ``key``, None where there is none."""
        return [memories.get(key) for memories in self.memories]

    def remember(self, key: tuple[str, str], values: Sequence[Any]) -> Batch:
        """The batch with ``values``, one of each input, in the memories under ``key``."""
        after = ({**memories, key: value} for memories, value in zip(self.memories, values, strict=True))
        return replace(self, memories=tuple(after))

    @property
    def shown(self) -> list[Layer]:
        """The layers that come."""
        return [layer for layer, seen in zip(self.layers, self.plan.visible, strict=True) if seen]

    @property
    def vertices(self) -> np.ndarray:
        """Vertices [m] (F, V, 3) relative to the root, one visible layer's after the other."""
        return joined([layer.vertices for layer in self.shown])

    @property
    def jets(self) -> Jets:
        """Posed patches, one visible layer's after the other."""
        jets = [layer.jets for layer in self.shown if layer.jets is not None]
        return Jets(*(joined([getattr(one, name) for one in jets]) for name in ("jet", "rotation", "centre")))

    def placed(self, origin: Origin) -> Placed:
        """The vertices as an answer says them, counted from ``origin``."""
        return Placed(self.world()) if origin == "world" else Placed(self.vertices, self.root)

    def world(self) -> np.ndarray:
        """World positions [m] (F, V, 3) float32."""
        return (self.vertices + self.root[:, None, :]).astype(np.float32)


def joined(parts: Sequence[np.ndarray | None], axis: int = 1) -> np.ndarray:
    """``parts`` one after the other; one alone is itself."""
    arrays = [part for part in parts if part is not None]
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays, axis=axis)


def _whole(parts: Sequence[Any]) -> Any:
    """``parts`` of one kind, with arrays of frames, one after the other."""
    if parts[0] is None:
        return None
    if isinstance(parts[0], np.ndarray):
        return np.concatenate(parts)
    names = [item.name for item in fields(parts[0])]
    return type(parts[0])(**{name: _whole([getattr(part, name) for part in parts]) for name in names})


@dataclass(frozen=True, eq=False)
class StageSetup:
    """The parts of a service that all stages share; ``make`` calls a function that takes long."""

    engine: Engine
    body: BodyModel
    settings: Settings
    make: Make = call_here


class Stage:
    """One step of a frame's way, made once per service; ``service.stages.STAGES`` names them in order.

    A stage holds its constants of garments (``add``, ``prepare``). Its memories of a stream or clip lie in the batch,
    under its name and the garment's digest or ``BODY``.
    """

    name: ClassVar[str]
    kept: ClassVar[tuple[type, ...]] = ()  # the classes of what it remembers, which streams take to other processes

    def __init__(self, setup: StageSetup) -> None:
        self.engine, self.body, self.settings, self.make = setup.engine, setup.body, setup.settings, setup.make

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

    def depends_on(self, plan: Plan) -> object:
        """The part of the options that its memories hold for: they are forgotten where it changes."""
        return None

    def moved_m(self, plan: Plan, before: np.ndarray, after: np.ndarray) -> float:
        """A bound [m] on how far this stage moves cloth when the pose ``before`` (24, 3) [rad] becomes ``after``;
        infinite where it knows none."""
        return 0.0

    def rested(self, memory: Any, time_s: float) -> Any:
        """``memory`` as after another frame at ``time_s`` of a body and of cloth that do not move."""
        return memory

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        """Stores the constants of ``garment``, whose ``garment_feed`` is ``feed``."""

    def remove(self, garment: Garment) -> None:
        """Forgets the constants of ``garment``; no plan names it any more."""

    def prepare(self, plan: Plan) -> None:
        """Makes what the frames of ``plan`` need and takes long; called from any thread."""

    @property
    def held_bytes(self) -> int:
        """Memory of its constants where the graphs compute."""
        return 0

    def run(self, batch: Batch) -> Batch:
        """``batch`` with what this stage makes of it."""
        raise NotImplementedError

    def steps(self, batch: Batch) -> Iterator[Batch]:
        """``batch`` after each part of ``run``, between which other frames may be computed; the last is its result."""
        yield self.run(batch)


def carried(memories: Memories, before: Plan, after: Plan) -> Memories:
    """The ``memories`` that still hold when the plan ``before`` becomes ``after``.

    Their stage goes on, on the same options, and their body or garment is worn on.
    """
    old = {stage.name: stage.depends_on(before) for stage in before.stages}
    new = {stage.name: stage.depends_on(after) for stage in after.stages}
    owners = {BODY, *after.keys, *after.draped_keys}
    return {
        (stage, owner): memory
        for (stage, owner), memory in memories.items()
        if owner in owners and stage in old and stage in new and old[stage] == new[stage]
    }
