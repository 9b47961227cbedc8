"""The network's drape of every garment: poses and codes in, vertices or posed jets out.

Another stage says how far poses are from training (``drape.body.pose_distance``): folds do more for novel ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, lru_cache, partial
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from drape.contact.skin import posed_table
from drape.errors import ArtifactError, InputError
from drape.garment.cache import Garment
from drape.geometry import jets
from drape.graph.packing import pack_body
from drape.inference.compiled import GarmentRows
from drape.inference.graph_names import JETS, SKIN
from drape.inference.packing import Packer, Result, ScenePlan, Shape, check_finite
from drape.inference.whole_graph import WholeGraph
from drape.network.bodies import BodyFeed
from drape.network.frame import FrameGarment, FrameOutfit
from drape.network.novelty import kept_poses, novelty
from drape.stages.batch import Batch, Jets, Layer, changed, concatenated, stacked
from drape.stages.plan import Plan
from drape.stages.scene import check_known
from drape.stages.stage import Stage, StageSetup
from drape.wire.options import DrapeOptions

SHAPES: dict[frozenset[str], Shape] = {
    frozenset({"vertices"}): "vertices",
    frozenset({"jets"}): "jets",
    frozenset({"vertices", "jets"}): "both",
}
SHAPES_KEPT = 64  # body shapes whose constants stay, a kilobyte each


class Novelty(Stage):
    """The stage that gives every frame the novelty of its pose, if the model has the poses that it was trained on."""

    name = "novelty"

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        support = self.engine.pose_support
        self.kept_poses = None if support is None else kept_poses(support)

    def wanted(self, plan: Plan) -> bool:
        return self.kept_poses is not None

    def run(self, batch: Batch) -> Batch:
        assert self.kept_poses is not None
        scores = novelty(self.kept_poses, concatenated([client.poses for client in batch.inputs], axis=0))
        return changed(batch, quality=changed(batch.quality, novelty=scores))


class Network(Stage):
    """The stage that drapes all frames of all garments by the network, and no more of them than the plan needs.

    The network also poses the skin samples by bones; a body with pose blend shapes poses them itself.
    """

    name = "network"

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup)
        self.lane = setup.lane
        self.drawn_alike = WeakValueDictionary[
            tuple[Any, ...], FrameGarment | FrameOutfit
        ]()  # one object for all plans that draw alike
        self.packer = WholeGraph(self.engine, self.body) if self.engine.whole else Packer(self.engine, self.body)
        body = setup.body  # not ``self``: a stage in a ring stays until the collector comes, which is seldom
        self._shape = lru_cache(SHAPES_KEPT)(lambda betas: pack_body(body, np.frombuffer(betas, np.float64)))
        self._skin_in_graph = self.engine.feels_body and self.body.posedirs is None
        feed = self.packer.body_feed if isinstance(self.packer, Packer) else None
        shape = self._shape
        self._feed = lru_cache(SHAPES_KEPT)(lambda betas: feed and feed(shape(betas)))

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        return {"passes": self.engine.check_passes(options.advanced.passes)}

    def check(self, plan: Plan) -> None:
        model = self.engine.manifest
        check_known(plan.fabrics, known=self.engine.knows_fabrics, model=model.name)
        if plan.options.geometry == "jets" and model.network.get("variant") == "paper":
            raise InputError(
                "geometry",
                expected=f"vertices with model {model.name}",
                got="jets, which it has in the rest pose",
                cure="Leave it out.",
            )

    def add(self, garment: Garment, feed: dict[str, np.ndarray]) -> None:
        self.packer.add(garment.digest, garment, feed)

    def remove(self, garment: Garment) -> None:
        self.packer.remove(garment.digest)

    def parts(self, plan: Plan) -> Sequence[Callable[[], object]]:
        given = self.engine.feels_body and not self._skin_in_graph
        return [partial(self.packer.prepare, self._scene(plan), skin_given=given, shapes=plan.messages)]

    @property
    def held_bytes(self) -> int:
        return self.packer.held_bytes

    def records(self, plan: Plan) -> dict[str, Any]:
        """Returns the engine's records by name, by which a client computes the network for the one garment of ``plan``
        (``CompiledNetwork.records``).

        Refuses (``ArtifactError``) a model of a kind that the engine does not compute.
        """
        if self.engine.compiled is None:
            name, cure = self.engine.manifest.name, "Stream its vertices from a service."
            raise ArtifactError(name, expected="a network that the engine has", got="another kind", cure=cure)
        assert isinstance(self.packer, Packer)
        (key,) = self._dressed(plan)
        return self.packer.records(key, passes=plan.options.advanced.passes)

    @property
    def in_engine(self) -> bool:
        """Returns whether the engine computes the network and poses the skin samples."""
        return self.engine.compiled is not None and self._skin_in_graph

    @property
    def on_one_thread(self) -> bool:
        """Returns whether one thread drapes all frames."""
        return not isinstance(self.packer, Packer) or self.packer.one_thread

    def feed_of(self, betas: np.ndarray) -> tuple[BodyFeed, np.ndarray]:
        """Returns the body in the shape ``betas`` (S,) as the engine reads it, in no pose yet, and the place of its
        root joint at rest [m] (3,)."""
        key = np.asarray(betas, np.float64).tobytes()
        feed = self._feed(key)
        assert feed is not None
        return feed, self._shape(key).root

    def rows(self, plan: Plan) -> list[GarmentRows]:
        """Returns the constants of the garments that ``plan`` drapes, as the engine reads them."""
        assert isinstance(self.packer, Packer)
        return [self.packer.rows(key) for key in self._dressed(plan)]

    def run(self, batch: Batch) -> Batch:
        plan, needs = batch.plan, batch.plan.needs
        shapes = [self._shape(np.asarray(own.betas, np.float64).tobytes()) for own in batch.inputs]
        parts = [shape.rows(own.poses) for shape, own in zip(shapes, batch.inputs, strict=True)]
        bodies = {name: concatenated([part[name] for part in parts], axis=0) for name in parts[0]}
        root = concatenated([own.trans + shape.root for shape, own in zip(shapes, batch.inputs, strict=True)], axis=0)
        if batch.codes is not None:
            bodies["dynamic_code"] = batch.codes
        skin = None
        if not self._skin_in_graph and (self.engine.feels_body or SKIN in needs):
            skin = np.concatenate([posed_table(self.body, own.poses, own.betas) for own in batch.inputs])
        if skin is not None and self.engine.feels_body:
            bodies[SKIN] = skin
        scene = self._scene(plan)
        frames = len(root)
        items = [(key, frame) for key in self._dressed(plan) for frame in range(frames)]
        results = self.packer.run(scene, bodies, items)
        check_finite(self.engine, all(result.finite for result in results))
        if scene.skin:
            skin = _stacked(results[:frames], SKIN)
        layers = [_layer(results[i : i + frames], needs) for i in range(0, len(items), frames)]
        return changed(batch, root=root, skin=skin, layers=tuple(layers))

    def _dressed(self, plan: Plan) -> list[str]:
        """The keys of the garments of ``plan`` in the packer's store, in the fabrics that it names."""
        keys = zip(plan.draped_keys, plan.fabrics, strict=True)
        return [key if fabric is None else self.packer.dressed(key, fabric) for key, fabric in keys]

    def _scene(self, plan: Plan) -> ScenePlan:
        """The outputs of the packed graph that ``plan`` needs."""
        return _scene_plan(plan.needs, SKIN in plan.needs and self._skin_in_graph, plan.options.advanced.passes)


@cache
def _scene_plan(needs: frozenset[str], skin: bool, passes: int | None) -> ScenePlan:
    return ScenePlan(SHAPES[needs & {"vertices", "jets"}], skin=skin, passes=passes)


def _layer(results: list[Result], needs: frozenset[str]) -> Layer:
    vertices = _stacked(results, "vertices") if "vertices" in needs else None
    if "jets" not in needs:
        return Layer(vertices)
    jet, rotation, centre = (_stacked(results, name) for name in JETS)
    return Layer(vertices, Jets(jets.full(jet), rotation, centre))


def _stacked(results: list[Result], name: str) -> np.ndarray:
    """The array ``name`` of all frames."""
    return stacked([result.arrays[name] for result in results])
