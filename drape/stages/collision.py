"""The collision projection (the push-out): every garment out of the body and of the garments below it.

Folds end off the skin by themselves, from the planes that they know anyway; then there is nothing left to project.
``Pusher`` holds its constants. On a CPU the engine pushes (``drape.graph.push``), on a GPU two graphs do.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.contact.cloth_samples import cloth_samples
from drape.contact.projection import CLEARANCE_M, MOVED_M, PushFeed
from drape.contact.samples import Samples
from drape.contact.skin import Skin, body_skin
from drape.errors import NotFound
from drape.garment.cache import Garment
from drape.graph.layer_feed import InnerGarment, LayerFeed, pack_layer
from drape.graph.push import PushConstants, push_frames
from drape.graph.push_feed import pack_push, pushed_jets
from drape.inference.graph_names import PUSH, PUSH_OVER, PUSHES, SKIN
from drape.stages.batch import Batch, Jets, Layer, changed, concatenated
from drape.stages.plan import Plan
from drape.stages.stage import KeptConstants, Make, Stage, StageSetup, call_here
from drape.wire.options import DrapeOptions

if TYPE_CHECKING:
    from drape.inference.engine import Engine
    from drape.inference.onnx_runtime import OrtValue, Session, Value

    Constants = dict[str, OrtValue] | PushConstants

OUTPUT = "pushed"
JET_OUTPUTS = (OUTPUT, "jet_push", "left")
KEPT_OUTFITS = 32  # constants of a layer over others, some five megabytes each


class Collision(Stage):
    """The stage that pushes layers out of the body and of each other, the innermost first; in plans of jets it pushes
    the jets too."""

    name = "collision"

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        self.pusher = Pusher(self.engine, self.body, CLEARANCE_M, make=self.make)

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        return {"push_out": options.advanced.push_out is not False}

    def wanted(self, plan: Plan) -> bool:
        return plan.projected

    def joins_layers(self, plan: Plan) -> bool:
        return True

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices", SKIN})

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        vertices = garment.vertices[: garment.vertex_count]
        self.pusher.add(garment.digest, feed, vertices, garment.faces)

    def remove(self, garment: Garment) -> None:
        self.pusher.remove(garment.digest)

    def parts(self, plan: Plan) -> Sequence[Callable[[], object]]:
        return [partial(self.pusher.prepare, plan.keys, jets=plan.options.geometry == "jets")]

    @property
    def held_bytes(self) -> int:
        return self.pusher.held_bytes

    def run(self, batch: Batch) -> Batch:
        layers: list[Layer] = []
        ways, left = [], []
        for count, visible in enumerate(batch.plan.visible, start=1):
            under = concatenated([layer.vertices for layer in layers]) if layers else None
            before = batch.layers[count - 1].jets if visible else None
            parts = [self._pushed(batch, count, under, rows, before) for _, rows in batch.rows()]
            after = None if before is None else replace(before, jet=concatenated([part.jet for part in parts], axis=0))
            layers.append(Layer(concatenated([part.vertices for part in parts], axis=0), after))
            if visible:
                ways.append(concatenated([part.way_m for part in parts], axis=0))
            if after is not None:
                left.append(concatenated([part.left_m for part in parts], axis=0))
        way = concatenated(ways)
        share, furthest = (way > MOVED_M).mean(axis=1), way.max(axis=1)
        left_m = np.max(left, axis=0) if left else batch.quality.left_m
        quality = changed(batch.quality, pushed_share=share, push_max_m=furthest, left_m=left_m)
        return changed(batch, layers=tuple(layers), quality=quality)

    def _pushed(self, batch: Batch, count: int, under: np.ndarray | None, rows: slice, jets: Jets | None) -> Pushed:
        """The frames ``rows``, those of one body, of the layer ``count - 1`` and of its ``jets``, pushed."""
        layer = batch.layers[count - 1]
        assert layer.vertices is not None and batch.skin is not None
        posed = None if jets is None else Jets(jets.jet[rows], jets.rotation[rows], jets.centre[rows])
        below = None if under is None else under[rows]
        keys = batch.plan.keys[:count]
        return self.pusher.push(keys, layer.vertices[rows], batch.skin[rows], under=below, posed=posed)


@dataclass(eq=False)
class _Stored:
    """A garment in store: its ``garment_feed`` and rest mesh, its constants over the skin, and the garment
    ``as_inner``, the collider of layers over it."""

    feed: dict[str, np.ndarray]
    vertices: np.ndarray
    faces: np.ndarray
    constants: Constants | None = None
    as_inner: InnerGarment | None = None


@dataclass(frozen=True, eq=False)
class Pushed:
    """F frames of a pushed garment: ``vertices`` [m] (F, V, 3) and how far each was moved, ``way_m`` [m] (F, V).

    ``jet`` (F, K, 45) [patch scales] are the pushed jets, None where none were given. Vertices that are made of it are
    short of clear by ``left_m`` [m] (F,) at most, and may lie farther than that from ``vertices``.
    """

    vertices: np.ndarray
    way_m: np.ndarray
    jet: np.ndarray | None = None
    left_m: np.ndarray | None = None


class Pusher:
    """Pushes garments ``clearance_m`` [m] clear of a posed skin and of the garments below; one thread at a time.

    The skin is that of ``body`` in any pose and shape. ``make(function, *arguments)`` calls a function that takes long,
    such as one that makes constants.
    """

    def __init__(
        self, engine: Engine, body: BodyModel, clearance_m: float = CLEARANCE_M, *, make: Make = call_here
    ) -> None:
        self._engine, self._make = engine, make
        self._skin = body_skin(body)
        self._bones = make(_bones, self._skin, body)
        self._clearance = np.full(1, np.float32(clearance_m))
        self._stored: dict[str, _Stored] = {}
        self._making = threading.Lock()
        self._layers = KeptConstants["Constants"](lambda kept: len(kept) > KEPT_OUTFITS)
        for graph in PUSHES if engine.pushes else ():  # now, not in the first frame
            self._session(graph, jets=False)

    @property
    def held_bytes(self) -> int:
        """Returns the size of the garments' constants over the skin [bytes]."""
        return sum(_bytes(own.constants) for own in self._stored.values() if own.constants is not None)

    def add(self, key: str, feed: dict[str, np.ndarray], vertices: np.ndarray, faces: np.ndarray) -> None:
        """Stores the garment ``key``: ``feed``, its ``garment_feed``, rest ``vertices`` [m] (V, 3) and ``faces`` (T,
        3)."""
        self._stored[key] = _Stored(feed, vertices, faces)

    def remove(self, key: str) -> None:
        """Forgets the garment ``key``, and the constants of every outfit that it is part of."""
        self._stored.pop(key, None)
        self._layers.forget(key)

    def prepare(self, keys: Sequence[str], *, jets: bool = False) -> None:
        """Makes the missing constants of an outfit of the garments ``keys``, the innermost first, and opens the graphs
        that push it; with ``jets`` those that push jets too.

        It takes a second for each garment, and any thread may call it.
        """
        self._alone(self._get(keys[0]))
        for count in range(1, len(keys)):
            self._layer(tuple(keys[: count + 1]))
        for graph in PUSHES[: len(keys)] if self._engine.pushes else ():
            self._session(graph, jets=jets)

    def _session(self, graph: str, *, jets: bool) -> Session:
        return self._engine.open_cut(graph, JET_OUTPUTS if jets else (OUTPUT,), given=(SKIN,))

    def push(
        self,
        keys: Sequence[str],
        vertices: np.ndarray,
        skin: np.ndarray,
        *,
        under: np.ndarray | None = None,
        posed: Jets | None = None,
    ) -> Pushed:
        """Returns the last garment of ``keys`` pushed out of the posed body and of the garments before it, which lie
        below.

        Its ``vertices`` [m] (F, V, 3), the posed ``skin`` samples (F, R, 12, 8) and ``under`` [m] (F, U, 3), the pushed
        vertices of the garments below, are relative to the roots. ``posed`` are jets of the same vertices, which are
        then pushed too. Refuses (``NotFound``) a garment that is not in store.
        """
        stored = self._get(keys[-1])
        vertices = np.ascontiguousarray(vertices, dtype=np.float32)
        constants = self._alone(stored) if under is None else self._layer(tuple(keys))
        if isinstance(constants, PushConstants):
            clearance_m, jets = float(self._clearance[0]), posed is not None
            moved, way_m, *parts = push_frames(vertices, skin, constants, clearance_m, under=under, jets=jets)
        else:
            moved, *parts = self._by_graph(
                constants, vertices, skin, under, (OUTPUT,) if posed is None else JET_OUTPUTS
            )
            way_m = np.linalg.norm(moved - vertices, axis=-1)
        if posed is None:
            return Pushed(moved, way_m)
        coefficients, left_m = parts
        jet = pushed_jets(posed.jet, posed.rotation, stored.feed["patch_scale"], coefficients)
        return Pushed(moved, way_m, jet, left_m)

    def _by_graph(
        self,
        constants: dict[str, OrtValue],
        vertices: np.ndarray,
        skin: np.ndarray,
        under: np.ndarray | None,
        outputs: Sequence[str],
    ) -> list[np.ndarray]:
        """The ``outputs`` of the graph that pushes out of the body, and out of the vertices ``under`` where these
        are."""
        arrays: dict[str, Value] = {
            SKIN: skin,
            # Of these two the graphs read only how many frames and parts there are.
            "bone_translation": np.zeros((len(skin), JOINT_COUNT, 3), dtype=np.float32),
            "skin_bones": self._bones,
            "vertices": vertices,
            "clearance": self._clearance,
        }
        arrays |= constants
        if under is not None:
            arrays["under"] = np.ascontiguousarray(under, dtype=np.float32)
        session = self._session(PUSH if under is None else PUSH_OVER, jets=len(outputs) > 1)
        return session.run(outputs, {name: arrays[name] for name in session.inputs})

    def _get(self, key: str) -> _Stored:
        if key not in self._stored:
            raise NotFound(
                "garment", expected=", ".join(self._stored) or "one in store", got=key, cure="Add the garment first."
            )
        return self._stored[key]

    def _alone(self, stored: _Stored) -> Constants:
        """The constants of a garment over the skin, made once."""
        with self._making:
            if stored.constants is None:
                arrays = self._make(_garment_arrays, stored.feed, stored.vertices, self._skin)
                stored.constants = self._values(arrays, PushFeed)
            return stored.constants

    def _layer(self, keys: tuple[str, ...]) -> Constants:
        """The constants of the last garment of ``keys`` over the others."""
        *inner, outer = (self._get(key) for key in keys)

        def make() -> Constants:
            below = [self._as_inner(stored) for stored in inner]
            arrays = self._make(_arrays_over, outer.feed, outer.vertices, self._skin, below)
            return self._values(arrays, LayerFeed)

        return self._layers.get(keys, make)

    def _as_inner(self, stored: _Stored) -> InnerGarment:
        """The constants of a garment that others lie over, made once."""
        if stored.as_inner is None:
            samples = self._make(cloth_samples, stored.vertices, stored.faces)
            stored.as_inner = InnerGarment(stored.vertices, stored.faces, samples)
        return stored.as_inner

    def _values(self, arrays: dict[str, np.ndarray], kind: type[PushFeed | LayerFeed]) -> Constants:
        """The constants ``arrays`` of a ``kind`` for the engine, or on the device of the graphs."""
        if not self._engine.pushes:
            return PushConstants.of(kind.from_flat(arrays))
        return {name: self._engine.value(array) for name, array in arrays.items()}


def _bytes(constants: Constants) -> int:
    if isinstance(constants, PushConstants):
        return constants.bytes
    return sum(value.tensor_size_in_bytes() for value in constants.values())


def _bones(skin: Skin, body: BodyModel) -> np.ndarray:
    """``SkinOnBones.bones``, the same for all shapes and pose blend shapes of ``body``."""
    return skin.on_bones(replace(body, posedirs=None)).bones


def _garment_arrays(feed: dict[str, np.ndarray], vertices: np.ndarray, skin: Samples) -> dict[str, np.ndarray]:
    """The constants of a garment by the names of the graph's inputs."""
    return pack_push(feed, vertices, skin).flat()


def _arrays_over(
    feed: dict[str, np.ndarray], vertices: np.ndarray, skin: Samples, inner: Sequence[InnerGarment]
) -> dict[str, np.ndarray]:
    """The constants of a garment over others by the names of the graph's inputs."""
    return pack_layer(feed, vertices, skin, inner).flat()
