"""What a stage is, the constants that it keeps, and which memories hold under another plan."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Literal, Protocol, TypeVar
from weakref import WeakValueDictionary

import numpy as np

from drape.body.model import BodyModel
from drape.garment.cache import Garment
from drape.stages.batch import Batch, Memories
from drape.stages.plan import Plan, StageRules
from drape.wanted import go_on

if TYPE_CHECKING:
    from drape.inference.engine import Engine
    from drape.live.card_lanes import Lanes

BODY = ""  # the owner of what is remembered of a body, where others are garments by their digest
Make = Callable[..., Any]  # calls a function with arguments: here, or in another process while there are streams
Constants = TypeVar("Constants")
Key = tuple[str, ...]  # digests of garments and of a fabric


def call_here(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Returns ``function(*arguments, **named)``, called at once, in this thread."""
    return function(*arguments, **named)


class StageSettings(Protocol):
    """The setting that stages read where an option is left open: ``inertia``."""

    @property
    def inertia(self) -> Literal["network", "mesh"]: ...


@dataclass(frozen=True, eq=False)
class StageSetup:
    """The objects that all stages share. ``make`` calls a function that takes long; a card's ``lane`` draws frames."""

    engine: Engine
    body: BodyModel
    settings: StageSettings
    make: Make = call_here
    lane: Lanes | None = None


class Stage(StageRules):
    """One step of a frame's way, made once per service; ``drape.stages.STAGES`` names them in order.

    A stage holds its constants of garments (``add``, ``parts``). Its memories of a stream or clip lie in the batch,
    under its name and the garment's digest or ``BODY``.
    """

    def __init__(self, setup: StageSetup) -> None:
        self.engine, self.body, self.settings, self.make = setup.engine, setup.body, setup.settings, setup.make

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        """Stores the constants of ``garment``, whose ``garment_feed`` is ``feed``."""

    def remove(self, garment: Garment) -> None:
        """Forgets the constants of ``garment``; no plan names it any more."""

    @property
    def held_bytes(self) -> int:
        """The memory [bytes] of its constants where the graphs compute."""
        return 0

    def run(self, batch: Batch) -> Batch:
        """Returns ``batch`` after this stage."""
        raise NotImplementedError

    def steps(self, batch: Batch) -> Iterator[Batch]:
        """Yields ``batch`` after each part of ``run``; the last one is its result. Other frames may be computed between
        the parts."""
        yield self.run(batch)


class ClothStage(Stage, Generic[Constants]):
    """A stage that moves the cloth of garments in fabrics, from a memory of where it was (``at``)."""

    def __init__(self, setup: StageSetup, too_many: Callable[[Collection[Constants]], bool]) -> None:
        super().__init__(setup)
        self._garments: dict[str, Garment] = {}
        self._constants = KeptConstants[Constants](too_many)

    def rested(self, memory: Any, time_s: float) -> Any:
        return memory.at(time_s)

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        self._garments[garment.digest] = garment

    def remove(self, garment: Garment) -> None:
        self._garments.pop(garment.digest, None)
        self._constants.forget(garment.digest)

    def run(self, batch: Batch) -> Batch:
        *_, last = self.steps(batch)
        return last


def carried(memories: Memories, before: Plan, after: Plan) -> Memories:
    """Returns those of ``memories`` that still hold when the plan ``before`` becomes ``after``.

    A memory holds if its stage runs in both plans, on the same options (``Stage.depends_on``), and its body or garment
    is worn in both.
    """
    old = {stage.name: stage.depends_on(before) for stage in before.stages}
    new = {stage.name: stage.depends_on(after) for stage in after.stages}
    owners = {BODY, *after.keys, *after.draped_keys}
    return {
        (stage, owner): memory
        for (stage, owner), memory in memories.items()
        if owner in owners and stage in old and stage in new and old[stage] == new[stage]
    }


class KeptConstants(Generic[Constants]):
    """Constants by their keys. Those that were not used for longest are dropped while there are ``too_many``.

    One thread makes those of a key, and others that want them wait for it.
    """

    def __init__(self, too_many: Callable[[Collection[Constants]], bool] = lambda kept: False) -> None:
        self._kept: OrderedDict[Key, Constants] = OrderedDict()
        self._too_many = too_many
        self._looking, self._making = threading.Lock(), WeakValueDictionary[Key, threading.Lock]()

    def get(self, key: Key, make: Callable[[], Constants]) -> Constants:
        """The constants under ``key``, made by ``make`` where they are missing."""
        found = self._find(key)
        if found is None:
            with self._looking:
                making = self._making.setdefault(key, threading.Lock())
            with making:
                found = self._find(key)
                if found is None:
                    go_on()
                    found = (make(),)
                    self._keep(key, found[0])
        return found[0]

    def forget(self, digest: str) -> None:
        """Drops all constants whose key has ``digest``."""
        with self._looking:
            for key in [key for key in self._kept if digest in key]:
                del self._kept[key]

    def __iter__(self) -> Iterator[Key]:
        return iter(tuple(self._kept))

    def _find(self, key: Key) -> tuple[Constants] | None:
        """The constants under ``key`` in a tuple, since they may be None themselves."""
        with self._looking:
            if key not in self._kept:
                return None
            self._kept.move_to_end(key)
            return (self._kept[key],)

    def _keep(self, key: Key, made: Constants) -> None:
        with self._looking:
            self._kept[key] = made
            while len(self._kept) > 1 and self._too_many(self._kept.values()):
                self._kept.popitem(last=False)
