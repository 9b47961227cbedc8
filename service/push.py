"""Keeps drapes out of the body: the push-out's constants of bodies and garments, and the graph that uses them.

A model folder without the graph, or a body with pose blend shapes, takes the same formula in numpy, frame by frame.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.cloth.push.layers import cloth_samples
from drape.cloth.push.out import PushFeed, push_in_parts, push_out
from drape.cloth.push.samples import sample_table
from drape.cloth.push.skin import SkinOnBones, body_skin, skin_table
from drape.errors import NotFound
from drape.layer_packing import LayerFeed, Sheet, layer_arrays, pack_layer, push_over, push_over_in_parts
from drape.push_packing import feed_arrays, pack_push, pushed_jets
from drape.subnormals import flushed
from service.engine import PUSH, PUSH_OVER, SKIN, SKIN_CONSTANTS, Engine
from service.runtime import Session

if TYPE_CHECKING:
    import onnxruntime

    from service.runtime import Value

MOVED_M = 1e-4  # a vertex pushed less than this counts as left alone
OUTPUT = "pushed"
JET_OUTPUTS = (OUTPUT, "jet_push", "left")
KEPT_SHAPES = 64  # a megabyte each
KEPT_OUTFITS = 32  # some five megabytes per layer over others

Formula = Callable[[np.ndarray, slice, np.ndarray], np.ndarray]  # vertices, frame and table of samples to vertices


@dataclass(eq=False)
class _Stored:
    """A garment in store: its ``drape.feeds.garment_feed``, rest mesh and constants, and what lies over it needs."""

    feed: dict[str, np.ndarray]
    vertices: np.ndarray
    faces: np.ndarray
    push: PushFeed
    arrays: dict[str, onnxruntime.OrtValue]
    sheet: Sheet | None = None


@dataclass(frozen=True, eq=False)
class PosedJets:
    """A drape as its graph says it: ``jet`` (F, K, 27 or 45) [patch scales] in frames ``rotation`` (F, K, 3, 3)."""

    jet: np.ndarray
    rotation: np.ndarray


@dataclass(frozen=True, eq=False)
class PushedJets:
    """Jets (F, K, 45) that hold the push-out, and what they lack to it [m] (F,): the longest way of a vertex.

    ``vertices`` [m] (F, V, 3) are what ``push`` makes, with its ways [m] (F, V).
    """

    jet: np.ndarray
    left_m: np.ndarray
    vertices: np.ndarray
    way_m: np.ndarray


class Pusher:
    """Pushes garment vertices out of one body in any pose and shape; safe to call from one thread at a time."""

    def __init__(self, engine: Engine, body: BodyModel) -> None:
        self._engine, self._body = engine, body
        self._skin = body_skin(body)
        self._stored: dict[str, _Stored] = {}
        self._layers: OrderedDict[tuple[str, ...], tuple[LayerFeed, dict[str, onnxruntime.OrtValue]]] = OrderedDict()
        self._looking, self._making = threading.Lock(), threading.Lock()
        self._shapes: OrderedDict[bytes, SkinOnBones] = OrderedDict()
        self._opened: dict[tuple[str, tuple[str, ...], bool], Session] = {}
        self._push_in_graph = engine.pushes and body.posedirs is None
        self._over_in_graph = engine.pushes_over and body.posedirs is None
        for graph, there in ((PUSH, self._push_in_graph), (PUSH_OVER, self._over_in_graph)):
            if there:  # now, not in the first frame
                self._graph(graph, (OUTPUT,), given=engine.shares_skin)

    @property
    def in_graph(self) -> bool:
        """Whether the graph does it."""
        return self._push_in_graph

    @property
    def held_bytes(self) -> int:
        """Memory where the graphs compute: constants of the garments, and what sessions hold between calls."""
        constants = sum(value.tensor_size_in_bytes() for one in self._stored.values() for value in one.arrays.values())
        return constants + sum(session.bytes for session in self._opened.values())

    @property
    def buckets(self) -> int:
        """Sets of shapes that sessions hold memory for."""
        return sum(session.buckets for session in self._opened.values())

    def add(self, key: str, feed: dict[str, np.ndarray], vertices: np.ndarray, faces: np.ndarray) -> None:
        """Puts the garment ``key`` in store: its ``drape.feeds.garment_feed``, rest vertices [m] (V, 3) and faces."""
        push = pack_push(feed, vertices, self._skin)
        self._stored[key] = _Stored(feed, vertices, faces, push, self._values(feed_arrays(push)))

    def prepare(self, keys: Sequence[str]) -> None:
        """Makes the constants of every garment of an outfit over those before it, where they are missing.

        Takes a second per garment, and may be called from any thread.
        """
        for count in range(1, len(keys)):
            self._layer(tuple(keys[: count + 1]))

    def push(
        self,
        key: str,
        vertices: np.ndarray,
        poses: np.ndarray,
        betas: np.ndarray,
        clearance_m: float,
        *,
        skin: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """``vertices`` [m] (F, V, 3) relative to the root, out of the body; and the way [m] (F, V) of each.

        For ``poses`` (F, 24, 3) [rad] and one shape ``betas``; refuses (``NotFound``) a garment not in store. ``skin``
        (F, R, 12, 8): the samples of that body so posed, where the graph that draped has them.
        """
        stored = self._get(key)
        vertices = np.ascontiguousarray(vertices, dtype=np.float32)
        clearance = np.float32(clearance_m)
        if not self._push_in_graph:
            formula = partial(_by_formula, feed=stored.push, clearance=clearance)
            pushed = self._by_numpy(formula, vertices, poses, betas)
        else:
            arrays = stored.arrays | self._posed(poses, betas, skin)
            (pushed,) = self._by_graph(PUSH, arrays, vertices, clearance)
        return pushed, np.linalg.norm(pushed - vertices, axis=-1)

    def push_over(
        self,
        keys: Sequence[str],
        vertices: np.ndarray,
        under: np.ndarray,
        poses: np.ndarray,
        betas: np.ndarray,
        clearance_m: float,
        *,
        skin: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """``push`` for the last garment of ``keys``, out of the body and of the others, which lie at ``under``.

        ``under`` [m] (F, U, 3) holds the pushed vertices of the others, innermost first, relative to the root.
        """
        feed, arrays = self._layer(tuple(keys))
        vertices, under = (np.ascontiguousarray(x, dtype=np.float32) for x in (vertices, under))
        clearance = np.float32(clearance_m)
        if not self._over_in_graph:
            formula = partial(_over_by_formula, under=under, feed=feed, clearance=clearance)
            pushed = self._by_numpy(formula, vertices, poses, betas)
        else:
            arrays = arrays | {"under": under} | self._posed(poses, betas, skin)
            (pushed,) = self._by_graph(PUSH_OVER, arrays, vertices, clearance)
        return pushed, np.linalg.norm(pushed - vertices, axis=-1)

    @flushed()
    def push_jets(
        self,
        keys: Sequence[str],
        vertices: np.ndarray,
        under: np.ndarray | None,
        posed: PosedJets,
        poses: np.ndarray,
        betas: np.ndarray,
        clearance_m: float,
        *,
        skin: np.ndarray | None = None,
    ) -> PushedJets:
        """``push``, or ``push_over`` where ``keys`` are several, that also fits the push-out into the jets ``posed``
        of the drape's ``vertices``; ``under`` is None where one key is all."""
        stored = self._get(keys[-1])
        vertices, clearance = np.ascontiguousarray(vertices, dtype=np.float32), np.float32(clearance_m)
        layer = self._layer(tuple(keys)) if under is not None else None
        arrays = stored.arrays if layer is None else layer[1]
        if under is not None:
            under = np.ascontiguousarray(under, dtype=np.float32)
            arrays = arrays | {"under": under}
        graph = PUSH if under is None else PUSH_OVER
        if self._body.posedirs is None and self._engine.tells_jet_push(graph):
            arrays = arrays | self._posed(poses, betas, skin)
            found = self._by_graph(graph, arrays, vertices, clearance, outputs=JET_OUTPUTS)
        else:
            parts = []
            for frame in range(len(poses)):
                one = slice(frame, frame + 1)
                table = self._table(poses[one], betas)
                if layer is None or under is None:
                    parts.append(push_in_parts(vertices[one], table, stored.push, clearance))
                else:
                    parts.append(push_over_in_parts(vertices[one], under[one], table, layer[0], clearance))
            found = [
                np.concatenate([part.vertices for part in parts]),
                np.concatenate([part.coefficients for part in parts]),
                np.concatenate([part.left_m for part in parts]),
            ]
        moved, coefficients, left = found
        jet = pushed_jets(posed.jet, posed.rotation, stored.feed["patch_scale"], coefficients)
        return PushedJets(jet, left, moved, np.linalg.norm(moved - vertices, axis=-1))

    def _get(self, key: str) -> _Stored:
        if key not in self._stored:
            raise NotFound(
                "garment", expected=", ".join(self._stored) or "one in store", got=key, cure="Add the garment first."
            )
        return self._stored[key]

    def _layer(self, keys: tuple[str, ...]) -> tuple[LayerFeed, dict[str, onnxruntime.OrtValue]]:
        """Constants of the last of ``keys`` over the others; the latest used are kept."""
        *inner, outer = (self._get(key) for key in keys)
        kept = self._found(keys)
        if kept is not None:
            return kept
        with self._making:  # one at a time; who looks for others does not wait
            kept = self._found(keys)
            if kept is None:
                made = pack_layer(outer.feed, outer.vertices, self._skin, [_sheet(stored) for stored in inner])
                kept = made, self._values(layer_arrays(made))
                with self._looking:
                    self._layers[keys] = kept
                    if len(self._layers) > KEPT_OUTFITS:
                        self._layers.popitem(last=False)
        return kept

    def _found(self, keys: tuple[str, ...]) -> tuple[LayerFeed, dict[str, onnxruntime.OrtValue]] | None:
        with self._looking:
            kept = self._layers.get(keys)
            if kept is not None:
                self._layers.move_to_end(keys)
            return kept

    def _by_graph(
        self,
        graph: str,
        arrays: Mapping[str, Value],
        vertices: np.ndarray,
        clearance: np.float32,
        *,
        outputs: tuple[str, ...] = (OUTPUT,),
    ) -> list[np.ndarray]:
        """``outputs`` of ``graph`` for ``arrays``, which may hold the posed skin in place of what poses it."""
        session = self._graph(graph, outputs, given=SKIN in arrays)
        given = {**arrays, "vertices": vertices, "clearance": np.full(1, clearance)}
        return session.run(outputs, {name: given[name] for name in session.inputs}, still=SKIN_CONSTANTS)

    def _values(self, arrays: dict[str, np.ndarray]) -> dict[str, onnxruntime.OrtValue]:
        """Constants where the graphs compute, handed over once."""
        return {name: self._engine.value(array) for name, array in arrays.items()}

    def _graph(self, graph: str, outputs: tuple[str, ...], *, given: bool) -> Session:
        """The session of ``outputs`` of ``graph``, with the posed skin ``given`` or not, opened once."""
        label = graph, outputs, given
        if label not in self._opened:
            self._opened[label] = self._engine.open_cut(graph, outputs, given=(SKIN,) if given else ())
        return self._opened[label]

    def _posed(self, poses: np.ndarray, betas: np.ndarray, skin: np.ndarray | None) -> dict[str, np.ndarray]:
        """The posed ``skin`` as an input of the graphs, or else what they pose it by."""
        if skin is not None:
            # Of these two the graphs read only how many frames and parts there are.
            still = np.zeros((len(skin), JOINT_COUNT, 3), dtype=np.float32)
            bones = self._on_bones(np.zeros(self._body.shape_count)).bones
            return {SKIN: skin, "bone_translation": still, "skin_bones": bones}
        rotations, translations = self._bones(poses, betas)
        on_bones = self._on_bones(betas)
        bones = {"bone_rotation": rotations, "bone_translation": translations}
        return bones | {"skin_rows": on_bones.rows, "skin_bones": on_bones.bones}

    @flushed()
    def _by_numpy(self, formula: Formula, vertices: np.ndarray, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
        pushed = np.empty_like(vertices)
        for frame in range(len(poses)):
            one = slice(frame, frame + 1)
            pushed[one] = formula(vertices[one], one, self._table(poses[one], betas))
        return pushed

    def _table(self, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
        """Samples (F, R, 12, 8) float32 of the posed skin."""
        if self._body.posedirs is None:
            skin = self._on_bones(betas)
            return skin_table(skin.rows, skin.bones, *self._bones(poses, betas))
        posed = self._body.posed_vertices(poses, None, betas) - self._body.rest_joints(betas)[0]
        table = sample_table(*self._skin.posed(posed)).astype(np.float32)
        return table.reshape(len(poses), self._skin.region_count, -1, table.shape[-1])

    def _bones(self, poses: np.ndarray, betas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rotations, translations = self._body.bones(poses, None, betas)
        relative = translations - self._body.rest_joints(betas)[0]
        return np.ascontiguousarray(rotations, dtype=np.float32), np.ascontiguousarray(relative, dtype=np.float32)

    def _on_bones(self, betas: np.ndarray) -> SkinOnBones:
        key = np.asarray(betas, dtype=np.float64).tobytes()
        if key not in self._shapes:
            self._shapes[key] = self._skin.on_bones(self._body, betas)
            if len(self._shapes) > KEPT_SHAPES:
                self._shapes.popitem(last=False)
        self._shapes.move_to_end(key)
        return self._shapes[key]


def _sheet(stored: _Stored) -> Sheet:
    """The garment as others lie over it, made once."""
    if stored.sheet is None:
        stored.sheet = Sheet(stored.vertices, stored.faces, cloth_samples(stored.vertices, stored.faces))
    return stored.sheet


def _by_formula(
    vertices: np.ndarray, frame: slice, table: np.ndarray, *, feed: PushFeed, clearance: np.float32
) -> np.ndarray:
    return push_out(vertices, table, feed, clearance)


def _over_by_formula(
    vertices: np.ndarray,
    frame: slice,
    table: np.ndarray,
    *,
    under: np.ndarray,
    feed: LayerFeed,
    clearance: np.float32,
) -> np.ndarray:
    return push_over(vertices, under[frame], table, feed, clearance)
