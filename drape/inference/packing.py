"""Drapes any mix of garments, clients and frames through the packed graph: ``Packer``.

A ``ScenePlan`` names the outputs. A batch is a list of items, each a garment and a body. On a CPU the engine
drapes item after item (``drape.inference.compiled``); on a GPU a graph drapes all of them, in a session that has only
the nodes of these outputs. Its inputs besides bodies are kept for each batch while memory allows, since streams repeat
their batches. An item has the same bits in any batch on a CPU (``tests/service/graphs``), so a batch may be run in
parts of any size.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.contact.samples import REGION_SIZE
from drape.errors import ArtifactError, InputError
from drape.garment.cache import Garment
from drape.graph.feeds import garment_feed
from drape.graph.packing import Composition, PackedBody, compose_garments, pack_garment
from drape.graph.push_feed import SkinShapes
from drape.inference.graph_names import JETS, PACKED, SKIN
from drape.inference.store import Store
from drape.network.bodies import NO_POSE, BodyFeed

if TYPE_CHECKING:
    from drape.inference.compiled import CompiledNetwork, GarmentRows
    from drape.inference.engine import Engine
    from drape.inference.onnx_runtime import Session, Value

Shape = Literal["vertices", "jets", "both"]
OUTPUTS_OF: dict[Shape, tuple[str, ...]] = {"vertices": ("vertices",), "jets": JETS, "both": ("vertices", *JETS)}
SHAPE_INDEX = ("body_shape",)  # the index input that graphs do without where all bodies have one shape
TILES_PER_CALL = 2048  # about 10 MB of columns: what a core's share of the last cache holds
TILES_PER_GPU_CALL = 65536
KEPT_BYTES = 32 << 20  # limit of the index tensors of batches that are kept
FABRICS_KEPT = 64  # how many garments in fabrics other than their own stay in store

Item = tuple[str, int]  # the key of a garment, and the row of its body among the bodies
T = TypeVar("T")


@dataclass(frozen=True)
class ScenePlan:
    """What ``Packer.run`` computes of each garment on a body: vertices, posed jets or both, as ``shape`` says, and with
    ``skin`` the posed skin samples of the body.

    ``passes``: how many of the network's corrections run, None for all.
    """

    shape: Shape = "vertices"
    skin: bool = False
    passes: int | None = None

    @cached_property
    def outputs(self) -> tuple[str, ...]:
        """Returns the names of the packed graph's outputs that the plan asks for."""
        return (*OUTPUTS_OF[self.shape], *((SKIN,) if self.skin else ()))


@dataclass(frozen=True, eq=False)
class Result:
    """What was computed of one garment on one body: float32 arrays by name, relative to the root joint. Which ones
    there are, ``ScenePlan`` says.

    "vertices" (V, 3) [m]; the posed jets "jet" (K, 45) [patch scales], "frame_rotation" (K, 3, 3) and "frame_centre"
    (K, 3) [m]; "skin" (R, 12, 8), the body's posed samples. ``finite`` is false where an output holds NaN or infinity.
    """

    arrays: dict[str, np.ndarray]
    finite: bool


@dataclass(frozen=True, eq=False)
class _Call:
    """A call of the graph for some items: its session, the inputs besides bodies, and where each item lies in the
    outputs."""

    session: Session
    feed: dict[str, Value]
    composition: Composition


class Packer:
    """Drapes stored garments on bodies by the model of ``engine``; safe to call from any thread.

    Calls of a graph take index tensors (``Indices``), which are kept for later calls up to ``kept_bytes``.
    ``tiles_per_call``: how many tiles of garments one call takes, by default as many as suit the device.
    """

    def __init__(
        self, engine: Engine, body: BodyModel, *, kept_bytes: int = KEPT_BYTES, tiles_per_call: int | None = None
    ) -> None:
        self._engine, self._body = engine, body
        self._lock = threading.RLock()  # of the store and of what is kept, not held while the graph runs
        # Of bodies with pose blend shapes the graph reads only how many parts and bones there are.
        self._skins = SkinShapes(replace(body, posedirs=None)) if engine.feels_body else None
        self._store = Store()
        self._kept: OrderedDict[tuple[Any, ...], _Call] = OrderedDict()  # by items, plan and kind of bodies
        self._kept_bytes, self._limit = 0, kept_bytes
        self._worn: OrderedDict[str, None] = OrderedDict()  # garments in other fabrics than their own, latest last
        self._tiles_per_call = tiles_per_call or (TILES_PER_CALL if engine.on_cpu else TILES_PER_GPU_CALL)
        self._values: dict[str, Any] = {}
        self._rows: dict[str, GarmentRows] = {}  # by key, where the network is compiled
        several = engine.compiled is not None and engine.threads > 1
        self._threads = ThreadPoolExecutor(engine.threads, "drape-items") if several else None

    @property
    def store(self) -> Store:
        """Returns the store of the garments' constants, which only this class may change."""
        return self._store

    @property
    def held_bytes(self) -> int:
        """Returns the size of the garments' constants [bytes]."""
        return self._store.bytes

    @property
    def kept_bytes(self) -> int:
        """Returns the size [bytes] of the index tensors that are kept for later calls."""
        return self._kept_bytes

    def add(self, key: str, garment: Garment, feed: dict[str, np.ndarray] | None = None) -> None:
        """Encodes ``garment`` in its own fabric and stores it under ``key``.

        ``feed`` is its ``garment_feed`` on this packer's body, which is computed if it is None.
        """
        if feed is None:
            feed = garment_feed(garment, body=self._body if self._engine.feels_body else None)
        packed = pack_garment(feed, self._engine.encode(garment))  # frames wait for the lock, and not for this
        with self._lock:
            self._store.add(key, garment, packed)
            self._rows.pop(key, None)
            self._forget()

    def dressed(self, key: str, fabric: Fabric) -> str:
        """Returns the key under which the garment ``key`` is stored in ``fabric``.

        The first call stores it so, in ten milliseconds. The ``FABRICS_KEPT`` latest used of these stay in store.
        Refuses (``NotFound``) a garment that is not in store.
        """
        name = f"{key} of {fabric.digest}"
        with self._lock:
            garment = None if name in self._store else self._store.garment(key)
        first = None if garment is None else self._engine.encode(garment, fabric)
        with self._lock:
            if first is not None and name not in self._store:  # another thread may have been faster
                for old in list(self._worn)[: len(self._worn) + 1 - FABRICS_KEPT]:
                    del self._worn[old]
                    if old in self._store:
                        self._store.remove(old)
                self._store.dress(key, name, first)
                self._forget()
            self._worn[name] = None
            self._worn.move_to_end(name)
            return name

    def remove(self, key: str) -> None:
        """Forgets the garment ``key`` with all its fabrics; refuses (``NotFound``) one that is not in store."""
        with self._lock:
            self._store.remove(key)
            self._forget()

    def prepare(self, plan: ScenePlan, *, skin_given: bool, shapes: bool) -> None:
        """Opens the sessions that frames of ``plan`` run: for bodies of one shape, and with ``shapes`` also of several.

        ``skin_given``: whether the posed skin comes with the bodies. A session takes a fifth of a second.
        """
        one_shape = self._skins is not None
        if self._engine.compiled:
            return
        for kind in sorted({one_shape, one_shape and not shapes}):
            self._session(plan, one_shape=kind, skin_given=skin_given)

    def run(self, plan: ScenePlan, bodies: dict[str, np.ndarray], items: Sequence[Item]) -> list[Result]:
        """Returns the results of ``items``, in their order. An item is the key of a garment and a row of ``bodies``,
        which are ``PackedBody.rows`` of B bodies.

        ``bodies`` may also hold "dynamic_code" (B, C) for a dynamic model, whose bodies are at rest without it, and
        "skin" (B, R, 12, 8), posed samples that replace those that the bones carry. Refuses (``NotFound``) a garment
        that is not in store, and (``InputError``) a row that ``bodies`` do not have.
        """
        count = min(len(rows) for rows in bodies.values())
        if self._engine.dynamic:
            bodies = {"dynamic_code": np.zeros((count, self._engine.code_size), np.float32)} | bodies
        for _, row in items:
            if not 0 <= row < count:
                raise InputError(
                    "body row", expected=f"a row in [0, {count})", got=str(row), cure="Give each item its body's row."
                )
        if self._engine.compiled is not None:
            return self._run_compiled(self._engine.compiled, plan, bodies, items)
        results: list[Result] = []
        for part in self._parts(items):
            rows = {row: i for i, row in enumerate(dict.fromkeys(row for _, row in part))}
            local = {name: np.ascontiguousarray(values[list(rows)]) for name, values in bodies.items()}
            results += self._run_part(plan, local, tuple((key, rows[row]) for key, row in part))
        return results

    def records(self, key: str, *, passes: int | None) -> dict[str, Any]:
        """Returns ``CompiledNetwork.records`` of the garment ``key``."""
        network = self._engine.compiled
        assert network is not None
        return network.records(self.rows(key), passes)

    @property
    def one_thread(self) -> bool:
        """Returns whether one thread drapes all items."""
        return self._threads is None

    def rows(self, key: str) -> GarmentRows:
        """Returns the constants of the garment ``key`` as the engine reads them; only for a ``compiled`` network."""
        assert self._engine.compiled is not None
        with self._lock:
            if key not in self._rows:
                self._rows[key] = self._engine.compiled.rows(self._store.packed(key))
            return self._rows[key]

    def body_feed(self, shape: PackedBody) -> BodyFeed:
        """Returns a body in its ``shape`` as the engine reads it, in no pose yet."""
        assert self._skins is not None
        with self._lock:
            skins = self._skins.feed(shape.betas[None])
        still = np.zeros(self._engine.code_size if self._engine.dynamic else 0, np.float32)
        parts, bones = skins["skin_rows"][0], skins["skin_bones"]
        return BodyFeed(NO_POSE, shape.joint_rest, shape.betas, still, parts, bones, self._skins.counts)

    def _parts(self, items: Sequence[Item]) -> list[list[Item]]:
        """``items`` split so that each part fits a call; a part has at least one item."""
        if len(items) == 1:
            return [list(items)]
        parts: list[list[Item]] = []
        tiles = self._tiles_per_call
        for item in items:
            size = self._store.packed(item[0]).tile_count
            if tiles + size > self._tiles_per_call:
                parts.append([])
                tiles = 0
            parts[-1].append(item)
            tiles += size
        return parts

    def _run_part(self, plan: ScenePlan, bodies: dict[str, np.ndarray], items: tuple[Item, ...]) -> list[Result]:
        skin_given, one_shape = SKIN in bodies, False
        if self._skins is not None:
            bodies = self._with_skins(bodies)
            one_shape = len(bodies["skin_rows"]) == 1
        call = self._call(plan, items, one_shape=one_shape, skin_given=skin_given)
        given = call.feed | bodies
        feed = {name: given[name] for name in call.session.inputs}
        found = call.session.run(plan.outputs, feed)
        answers = _apart(plan.outputs, found, call.composition, [row for _, row in items])
        return [Result(arrays, _finite(arrays)) for arrays in answers]

    def _with_skins(self, bodies: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """``bodies`` with the skins of their shapes."""
        assert self._skins is not None
        with self._lock:
            return bodies | self._skins.feed(bodies["betas"])

    def _run_compiled(
        self, network: CompiledNetwork, plan: ScenePlan, bodies: dict[str, np.ndarray], items: Sequence[Item]
    ) -> list[Result]:
        """``run`` without a graph: body after body, garment after garment, in as many threads as there are."""
        assert self._skins is not None
        bodies, outputs = self._with_skins(bodies), plan.outputs
        counts, rows = self._skins.counts, list(dict.fromkeys(row for _, row in items))
        garments = {key: self.rows(key) for key, _ in items}

        def drape(item: Item) -> Result:
            body = posed[item[1]]
            arrays, finite = network.drape(garments[item[0]], body, plan.passes, vertices="vertices" in outputs)
            if plan.skin:
                arrays[SKIN] = body.skin.reshape(-1, REGION_SIZE, 8)
            return Result({name: arrays[name] for name in outputs}, finite)

        posed = dict(zip(rows, self._each(lambda row: network.body(bodies, row, counts), rows), strict=True))
        return self._each(drape, items)

    def _each(self, function: Callable[[Any], T], values: Sequence[Any]) -> list[T]:
        """``function`` of each of ``values``, in order."""
        if self._threads is None or len(values) < 2:
            return [function(value) for value in values]
        return list(self._threads.map(function, values))

    def _call(self, plan: ScenePlan, items: tuple[Item, ...], *, one_shape: bool, skin_given: bool) -> _Call:
        """The call for ``items``, the latest used of them kept as far as memory allows."""
        key = items, plan, one_shape, skin_given
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        session = self._session(plan, one_shape=one_shape, skin_given=skin_given)
        with self._lock:
            call = self._made(session, items)
            if key not in self._kept:  # another thread may have been faster
                self._kept_bytes += call.composition.bytes
            self._kept[key] = call
            while self._kept_bytes > self._limit:
                _, dropped = self._kept.popitem(last=False)
                self._kept_bytes -= dropped.composition.bytes
        return call

    def _made(self, session: Session, items: Sequence[Item]) -> _Call:
        composition = compose_garments([(self._store.packed(key), self._store.place(key), row) for key, row in items])
        stored = self._store.arrays()
        names = stored.keys() & set(session.inputs)
        feed: dict[str, Value] = {name: self._constant(name, stored[name]) for name in names}
        feed |= {name: self._engine.value(array) for name, array in composition.arrays.items()}
        return _Call(session, feed, composition)

    def _session(self, plan: ScenePlan, *, one_shape: bool, skin_given: bool) -> Session:
        """The session for ``plan``, for bodies of ``one_shape`` or several."""
        direct, given = (SHAPE_INDEX if one_shape else ()), ((SKIN,) if skin_given else ())
        return self._engine.open_cut(PACKED, plan.outputs, direct=direct, passes=plan.passes, given=given)

    def _constant(self, name: str, array: np.ndarray) -> Any:
        """A stored array where the graph computes, handed over once."""
        if name not in self._values:
            self._values[name] = self._engine.value(array)
        return self._values[name]

    def _forget(self) -> None:
        self._kept.clear()
        self._values.clear()
        self._rows = {key: rows for key, rows in self._rows.items() if key in self._store}
        self._kept_bytes = 0


def _apart(
    names: Sequence[str], outputs: Sequence[np.ndarray], composition: Composition, rows: Sequence[int]
) -> list[dict[str, np.ndarray]]:
    """Each item's own rows of the packed ``outputs``, by ``names``."""
    whole = {
        name: values.reshape(-1, 3) if name == "vertices" else values
        for name, values in zip(names, outputs, strict=True)
    }
    results = []
    for vertices, patches, row in zip(composition.vertices, composition.patches, rows, strict=True):
        places = {"vertices": vertices, SKIN: row} | dict.fromkeys(JETS, patches)
        results.append({name: values[places[name]] for name, values in whole.items()})
    return results


def _finite(arrays: dict[str, np.ndarray]) -> bool:
    """Whether the network's answer in the outputs of an item is finite."""
    checked = [arrays[name] for name in ("vertices", *JETS) if name in arrays]
    return all(bool(np.isfinite(array).all()) for array in checked)


def check_finite(engine: Engine, finite: bool) -> None:
    """Refuses (``ArtifactError``) an answer of the network that is not ``finite``."""
    if not finite:
        raise ArtifactError(
            f"{engine.manifest.name} vertices",
            expected="finite numbers",
            got="NaN or infinity",
            cure="Use another model; this one fails on the pose.",
        )
