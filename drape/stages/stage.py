"""Stages, the constants that they keep, and the memories that hold under another plan."""

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

BODY = ""  # the owner of memories of a body; the owner of others is a garment's digest
Make = Callable[..., Any]  # calls a function with arguments: at once, or in another process while there are streams
Constants = TypeVar("Constants")
Key = tuple[str, ...]  # digests of garments and of a fabric


def call_here(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Returns ``function(*arguments, **named)``, called in this thread."""
    return function(*arguments, **named)


class StageSettings(Protocol):
    """The service's setting for the option ``inertia``, which holds where a client leaves it open."""

    @property
    def inertia(self) -> Literal["network", "mesh"]: ...


@dataclass(frozen=True, eq=False)
class StageSetup:
    """The objects that all stages share. ``make(function, *arguments)`` calls a function that takes long. ``lane``
    draws frames on graphics cards, None without."""

    engine: Engine
    body: BodyModel
    settings: StageSettings
    make: Make = call_here
    lane: Lanes | None = None


class Stage(StageRules):
    """One step of the way of a frame, made once per service. ``drape.stages.STAGES`` has all in their order.

    A stage holds its constants of garments (``add``, ``parts``). Its memories of a stream or clip lie in the batch,
    under its name and the garment's digest or ``BODY``.
    """

    def __init__(self, setup: StageSetup) -> None:
        self.engine, self.body, self.settings, self.make = setup.engine, setup.body, setup.settings, setup.make

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        """Stores ``garment``, of which ``feed`` is ``garment_feed`` on this stage's body: arrays by name."""

    def remove(self, garment: Garment) -> None:
        """Forgets ``garment`` and its constants; no plan names it any more."""

    @property
    def held_bytes(self) -> int:
        """Returns the size of its garments' constants [bytes] on the device of the graphs."""
        return 0

    def run(self, batch: Batch) -> Batch:
        """Returns ``batch`` with the results of this stage."""
        raise NotImplementedError

    def steps(self, batch: Batch) -> Iterator[Batch]:
        """Yields ``batch`` after each part of ``run``; the last one is its result. Other frames may be computed between
        the parts."""
        yield self.run(batch)


class ClothStage(Stage, Generic[Constants]):
    """A stage that moves cloth and remembers where it was. The method ``at(time_s)`` of a memory returns the memory as
    it is at that time [s] if nothing moves until then. Constants belong to a garment in a fabric."""

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
    """Constants by their keys. While ``too_many`` is true of all that are kept, the one that was not used for longest
    is dropped; the last one stays.

    One thread makes the constants of a key, and others that want them wait for it.
    """

    def __init__(self, too_many: Callable[[Collection[Constants]], bool] = lambda kept: False) -> None:
        self._kept: OrderedDict[Key, Constants] = OrderedDict()
        self._too_many = too_many
        self._looking, self._making = threading.Lock(), WeakValueDictionary[Key, threading.Lock]()

    def get(self, key: Key, make: Callable[[], Constants]) -> Constants:
        """Returns the constants under ``key``, made by ``make()`` where they are missing."""
        entry = self._find(key)
        if entry is None:
            with self._looking:
                making = self._making.setdefault(key, threading.Lock())
            with making:
                entry = self._find(key)
                if entry is None:
                    go_on()
                    entry = (make(),)
                    self._keep(key, entry[0])
        return entry[0]

    def forget(self, digest: str) -> None:
        """Drops the constants of all keys that contain ``digest``."""
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

    def _keep(self, key: Key, constants: Constants) -> None:
        with self._looking:
            self._kept[key] = constants
            while len(self._kept) > 1 and self._too_many(self._kept.values()):
                self._kept.popitem(last=False)
