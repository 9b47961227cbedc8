"""Drapes by a model's readable graph, on a CPU: models of another kind than ``drape.engine`` computes.

``WholeGraph`` has the methods of ``drape.inference.packing.Packer``. All corrections run, and every output is computed.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.cloth.fabric import Fabric
from drape.errors import NotFound
from drape.garment.cache import Garment
from drape.geometry.rotations import quaternion_to_rotvec
from drape.graph.feeds import body_feed, garment_feed, skinning_feed
from drape.inference.graph_names import DRAPE, JETS, SKIN
from drape.inference.packing import FABRICS_KEPT, Item, Result, ScenePlan

OUTPUTS = ("vertices", *JETS)

if TYPE_CHECKING:
    from drape.inference.engine import Engine


class WholeGraph:
    """Drapes stored garments on bodies by the readable graph of ``engine``'s model; safe to call from any thread."""

    def __init__(self, engine: Engine, body: BodyModel) -> None:
        self._engine, self._body = engine, body
        self._lock = threading.Lock()
        self._garments: dict[str, Garment] = {}
        self._feeds: dict[str, dict[str, np.ndarray]] = {}
        self._worn: OrderedDict[str, str] = OrderedDict()  # the garment's key by its key in another fabric
        self._session = engine.open_cut(DRAPE, OUTPUTS)

    @property
    def held_bytes(self) -> int:
        """Returns the size of the garments' constants [bytes]."""
        feeds = [feed for key, feed in self._feeds.items() if key not in self._worn]
        return sum(array.nbytes for feed in feeds for array in feed.values())

    def add(self, key: str, garment: Garment, feed: dict[str, np.ndarray] | None = None) -> None:
        """Encodes ``garment`` in its own fabric and stores it under ``key``, as ``Packer.add`` does."""
        feed = garment_feed(garment, body=self._body) if feed is None else feed
        if "skin_weights" in self._session.inputs:
            feed = feed | skinning_feed(garment, self._body)
        made = dict(feed) | {"patch_embedding": self._engine.encode(garment)}
        with self._lock:
            self._undress(key)
            self._garments[key], self._feeds[key] = garment, made

    def dressed(self, key: str, fabric: Fabric) -> str:
        """Returns the key under which the garment ``key`` is stored in ``fabric``, as ``Packer.dressed`` does."""
        name = f"{key} of {fabric.digest}"
        garment = self._garment(key)
        if name not in self._feeds:
            embedding = self._engine.encode(garment, fabric)
            with self._lock:
                self._feeds[name] = self._feeds[key] | {"patch_embedding": embedding}
        with self._lock:
            self._worn[name] = key
            self._worn.move_to_end(name)
            while len(self._worn) > FABRICS_KEPT:
                del self._feeds[self._worn.popitem(last=False)[0]]
        return name

    def remove(self, key: str) -> None:
        """Forgets the garment ``key`` with all its fabrics; refuses (``NotFound``) one that is not in store."""
        self._garment(key)
        with self._lock:
            self._undress(key)
            del self._garments[key], self._feeds[key]

    def prepare(self, plan: ScenePlan, *, skin_given: bool, shapes: bool) -> None:
        """Does nothing: the one session is open already."""

    def run(self, plan: ScenePlan, bodies: Mapping[str, np.ndarray], items: Sequence[Item]) -> list[Result]:
        """Returns the results of ``items``, in their order, as ``Packer.run`` does."""
        poses = quaternion_to_rotvec(bodies["joint_quaternion"][:, :JOINT_COUNT].astype(np.float64))
        count = len(poses)
        felt = self._engine.feels_body and SKIN not in bodies
        betas = bodies["betas"][:, : self._body.shape_count].astype(np.float64)
        arrays = body_feed(self._body, poses, np.zeros((count, 3)), betas, skin=felt).arrays
        given = {"dynamic_code": bodies.get("dynamic_code"), "body_skin": bodies.get(SKIN)}
        arrays = {"dynamic_code": np.zeros((count, self._engine.code_size), np.float32)} | arrays
        arrays |= {name: array for name, array in given.items() if array is not None}
        results: dict[Item, Result] = {}
        for key in dict.fromkeys(key for key, _ in items):
            rows = [row for of, row in items if of == key]
            feed = {name: np.ascontiguousarray(array[rows]) for name, array in arrays.items()} | self._feed(key)
            found = self._session.run(OUTPUTS, {name: feed[name] for name in self._session.inputs})
            for place, row in enumerate(rows):
                answer = {name: array[place] for name, array in zip(OUTPUTS, found, strict=True)}
                finite = all(bool(np.isfinite(array).all()) for array in answer.values())
                if plan.skin:
                    answer[SKIN] = arrays["body_skin"][row]
                results[key, row] = Result({name: answer[name] for name in plan.outputs}, finite)
        return [results[item] for item in items]

    def _garment(self, key: str) -> Garment:
        if key not in self._garments:
            expected = ", ".join(self._garments) or "one in store"
            raise NotFound("garment", expected=expected, got=key, cure="Add the garment first.")
        return self._garments[key]

    def _feed(self, key: str) -> dict[str, np.ndarray]:
        if key not in self._feeds:
            self._garment(key)
        return self._feeds[key]

    def _undress(self, key: str) -> None:
        for name in [name for name, of in self._worn.items() if of == key]:
            del self._worn[name], self._feeds[name]
