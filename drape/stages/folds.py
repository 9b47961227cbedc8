"""Folds: a few steps of the local solver on the network's drape, which go on from the folds of the frame before."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from drape.cloth.fabric import Fabric
from drape.contact.projection import CLEARANCE_M
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.wrapping import Wrapping
from drape.geometry.colliders import seen_from
from drape.live import two_level
from drape.live.ceiling import ceiling_over, lower, press
from drape.live.clock import Frame
from drape.live.fold_constants import LaidCloth
from drape.live.fold_step import FoldEffort, FoldMemory, FoldReport
from drape.live.raised_skin import heights_over, raise_skin
from drape.live.skin_walks import TouchedSamples
from drape.live.two_level import LiftMemory, Memory, OneLevel, TwoLevel, TwoLevelMemory
from drape.stages.batch import Batch, Layer, Quality, changed, stacked
from drape.stages.plan import FINE, SKIN, Plan
from drape.stages.stage import ClothStage, StageSetup
from drape.wire.options import DrapeOptions

SETTLE = 8  # the factor on the steps of a frame without a past, where clients name none
KEPT_BYTES = 256 << 20  # limit of the constants of garments in fabrics, 3 to 8 MB each; what is in use stays

Constants = OneLevel | TwoLevel


class Folds(ClothStage[Constants]):
    """The stage that takes steps of folds: they lower the energy of the cloth over the body, and go on from the folds
    of the frame before.

    With ``cloth_contact``, the default, a garment also keeps off itself and off the layers below. Without it each layer
    is folded by itself, and the push-out parts the layers. A garment that was delivered coarse folds on its subdivided
    mesh, and the delivered mesh is then wrapped around that. With ``coarse`` a coarse cloth takes the steps; with no
    steps the network's drape is only eased and lifted off the skin.
    """

    name = "folds"
    kept = (FoldMemory, TwoLevelMemory, LiftMemory, TouchedSamples)

    def __init__(self, setup: StageSetup) -> None:
        super().__init__(setup, lambda kept: sum(constants.nbytes for constants in kept) > KEPT_BYTES)
        self._wrappings: WeakKeyDictionary[Garment, Wrapping] = WeakKeyDictionary()

    def resolve(self, options: DrapeOptions) -> dict[str, Any]:
        folding = options.geometry == "vertices" or options.folds_by == "client"
        asked = options.advanced
        if not asked.folds and not (asked.coarse and folding):
            return {"folds": 0, "coarse": False, "safe_folds": None, "settle": None, "cloth_contact": None}
        return {
            "coarse": bool(asked.coarse),
            "folds": asked.folds or 0,
            "safe_folds": max(asked.folds, asked.safe_folds or 0) if asked.folds else None,
            "settle": SETTLE if asked.settle is None else asked.settle,
            "cloth_contact": asked.cloth_contact is not False,
        }

    def check(self, plan: Plan) -> None:
        if plan.options.folds_by == "client":
            check_client_folds(plan)
        elif plan.options.advanced.folds and plan.options.geometry == "jets":
            raise InputError(
                "advanced.folds",
                expected="0 with geometry jets, whose polynomials are smooth",
                got=str(plan.options.advanced.folds),
                cure="Ask for vertices, leave folds out, or let the client make them (folds_by).",
            )

    def wanted(self, plan: Plan) -> bool:
        return plan.folds and plan.options.folds_by == "server"

    def joins_layers(self, plan: Plan) -> bool:
        return bool(plan.options.advanced.cloth_contact)

    def presses_layers(self, plan: Plan) -> bool:
        return bool(plan.options.advanced.cloth_contact)

    def needs(self, plan: Plan) -> frozenset[str]:
        return frozenset({"vertices", SKIN, FINE})

    def depends_on(self, plan: Plan) -> object:
        return plan.fabrics, plan.options.advanced.coarse

    def parts(self, plan: Plan) -> Sequence[Callable[[], object]]:
        coarse, worn = plan.options.advanced.coarse, zip(plan.draped_keys, plan.fabrics, strict=True)
        layers = zip(plan.scene.layers, plan.draped_keys, read_layers(plan), strict=True)
        return [
            *(partial(self._wrapping, own.garment) for own, key, read in layers if read and own.garment.digest != key),
            *(partial(self.constants, key, fabric, coarse=coarse) for key, fabric in worn),
        ]

    def steps(self, batch: Batch) -> Iterator[Batch]:
        """Yields the batch after each layer, since a frame without a past takes tens of milliseconds for each."""
        plan = batch.plan
        effort, safe = self.efforts(plan)
        efforts = [safe if novelty > 1.0 else effort for novelty in batch.quality.novelty.tolist()]
        layers, figures, folded_layers = list(batch.layers), FoldFigures(len(batch.root)), []
        felt = feel_each_other(plan)
        assert batch.skin is not None
        ground = batch.skin.reshape(len(batch.skin), -1, batch.skin.shape[-1])
        ceilings = self._ceilings(batch, ground) if felt else [None] * len(layers)
        for i, (key, fabric, ceiling) in enumerate(zip(plan.draped_keys, plan.fabrics, ceilings, strict=True)):
            memories = batch.remembered((self.name, key))
            constants = self.constants(key, fabric, coarse=plan.options.advanced.coarse)
            layers[i], own, memories, reports = self._folded(batch, i, constants, efforts, memories, ground)
            figures.add(reports, len(constants.laid.sheet.vertex), visible=plan.visible[i])
            folded_layers.append(_FoldedLayer(constants.laid, own, ground))
            batch = batch.remember((self.name, key), memories)
            if ceiling is not None:
                layers[i] = folded_layers[i].below(layers[i], ceiling)
                ground = raise_skin(ground, folded_layers[i].heights(layers[i]))
            if i < len(layers) - 1:
                yield changed(batch, layers=tuple(layers), quality=figures.quality(batch.quality))
        folded, read = changed(batch, layers=tuple(layers)), read_layers(plan)
        if felt and any(read[:-1]):  # a layer that nobody reads need not lie below the others
            for i, ceiling in enumerate(self._ceilings(folded, folded_layers[0].ground)):
                if ceiling is not None and read[i]:
                    layers[i] = folded_layers[i].below(layers[i], ceiling)
        for i, (key, sent) in enumerate(zip(plan.draped_keys, plan.keys, strict=True)):
            if sent != key and read[i]:
                layers[i] = self.wrapped(layers[i], plan.scene.layers[i].garment)
        yield changed(batch, layers=tuple(layers), quality=figures.quality(batch.quality))

    def efforts(self, plan: Plan) -> tuple[FoldEffort, FoldEffort]:
        """Returns the effort of a frame under ``plan``, and that of a frame whose pose is novel."""
        options = plan.options.advanced
        assert options.folds is not None and options.settle is not None
        clearance_m = CLEARANCE_M if options.push_out else 0.0
        effort = FoldEffort(options.folds, options.settle, bool(options.cloth_contact), clearance_m)
        if plan.carried:
            effort = effort._replace(steps=0)
            return effort, effort
        return effort, effort._replace(steps=max(options.folds, options.safe_folds or 0))

    def _folded(
        self,
        batch: Batch,
        i: int,
        constants: Constants,
        efforts: Sequence[FoldEffort],
        memories: Sequence[Memory | None],
        ground: np.ndarray,
    ) -> tuple[Layer, np.ndarray, list[Memory | None], list[FoldReport]]:
        """Layer ``i`` with folds over the samples ``ground`` (F, S, 8) by the frames' ``efforts``; the sample (F, P)
        that each place of its cloth lies at, (F, 0) where layers do not feel each other; the memories of the inputs
        after it; and a report of each frame."""
        drape, felt = batch.layers[i].vertices, feel_each_other(batch.plan)
        assert drape is not None
        folded, own, reports, after = [], [], [], []
        for (client, rows), memory in zip(batch.rows(), memories, strict=True):
            for number, row in enumerate(range(rows.start, rows.stop)):
                solid = seen_from(batch.plan.colliders, batch.root[row])
                frame = Frame(drape[row], ground[row], float(client.times_s[number]), solid)
                vertices, memory, report = constants.fold(memory, frame, efforts[row])
                folded.append(vertices)
                own += [constants.own(memory)] if felt else []
                reports.append(report)
            after.append(memory)
        at = stacked(own) if felt else np.empty((len(drape), 0), np.int32)
        return changed(batch.layers[i], vertices=stacked(folded)), at, after, reports

    def _ceilings(self, batch: Batch, skin: np.ndarray) -> list[np.ndarray | None]:
        """The ceiling (F, S, 5) over the samples ``skin`` (F, S, 8) that the layers above each layer make; None for the
        outermost."""
        ceilings: list[np.ndarray | None] = [None]
        parts = zip(batch.layers, batch.plan.draped_keys, batch.plan.fabrics, strict=True)
        for layer, key, fabric in list(parts)[:0:-1]:
            assert layer.vertices is not None
            outer = self.constants(key, fabric, coarse=batch.plan.options.advanced.coarse).laid
            over = np.stack([ceiling_over(x, outer, below) for x, below in zip(layer.vertices, skin, strict=True)])
            ceilings.append(over if ceilings[-1] is None else lower(over, ceilings[-1]))
        return ceilings[::-1]

    def wrapped(self, layer: Layer, garment: Garment) -> Layer:
        """Returns ``layer``, whose vertices are those of the fine mesh of ``garment``, with those of the delivered mesh
        wrapped around them."""
        assert layer.vertices is not None
        wrapping = self._wrapping(garment)
        return changed(layer, vertices=np.stack([wrapping.wrap(cloth) for cloth in layer.vertices]))

    def _wrapping(self, garment: Garment) -> Wrapping:
        """The wrapping of the delivered mesh of ``garment``."""
        if garment not in self._wrappings:
            self._wrappings[garment] = Wrapping(garment)
        return self._wrappings[garment]

    def constants(self, key: str, fabric: Fabric | None, *, coarse: bool | None) -> Constants:
        """Returns the constants of the garment ``key`` made of ``fabric``, None for its own: on one level, or with
        ``coarse`` on two. They are made at the first call."""
        name = key, "" if fabric is None else fabric.digest, "coarse" if coarse else "fine"
        make = two_level.two_level if coarse else two_level.one_level
        return self._constants.get(name, lambda: self.make(make, self._garments[key], self.body, fabric))


def check_client_folds(plan: Plan) -> None:
    """Refuses (``InputError``) a plan whose folds no client can make.

    A client folds jets of one garment of cloth, without colliders, and on the mesh of the answer.
    """
    layers, fine = plan.scene.layers, plan.scene.fine.layers
    unmet = (
        (plan.options.geometry != "jets", "geometry jets", plan.options.geometry),
        (len(layers) != 1, "one garment", f"{len(layers)}"),
        (bool(plan.options.colliders), "no colliders", "some"),
        (bool(layers[0].garment.carriers), "cloth", "what bones carry"),
        (layers[0] is not fine[0], "resolution fine, as this garment folds on its finer mesh", plan.options.resolution),
    )
    for wrong, expected, got in unmet:
        if wrong:
            raise InputError("folds_by", expected=f"for client: {expected}", got=got, cure="Let the server fold.")


def feel_each_other(plan: Plan) -> bool:
    """Returns whether the layers of ``plan`` press on each other."""
    return bool(plan.options.advanced.cloth_contact) and len(plan.draped) > 1


def read_layers(plan: Plan) -> list[bool]:
    """Returns for each layer whether its delivered mesh is read: a hidden one's is read by the push-out alone."""
    return [visible or plan.projected for visible in plan.visible]


@dataclass(frozen=True, eq=False)
class _FoldedLayer:
    """A folded layer in F frames: its ``cloth``, and the sample ``own`` (F, P) of the ``ground`` (F, S, 8) that each
    place of the cloth lies at."""

    cloth: LaidCloth
    own: np.ndarray
    ground: np.ndarray

    def below(self, layer: Layer, ceiling: np.ndarray) -> Layer:
        """``layer``, pressed below the ``ceiling`` (F, S, 5)."""
        assert layer.vertices is not None
        frames = zip(layer.vertices, self.own, self.ground, ceiling, strict=True)
        return changed(layer, vertices=np.stack([press(x, self.cloth, *frame) for x, *frame in frames]))

    def heights(self, layer: Layer) -> np.ndarray:
        """The height [m] (F, S) of ``layer`` over each sample of the ground."""
        assert layer.vertices is not None
        frames = zip(layer.vertices, self.own, self.ground, strict=True)
        return np.stack([heights_over(x, self.cloth, *frame) for x, *frame in frames])


class FoldFigures:
    """Figures of each of F frames, added up over the layers: how many layers began their folds anew (``resets``), how
    many visible vertices were ``lifted`` off the skin and how far at most (``lifted_max_m`` [m]). ``vertices`` is the
    number of all visible vertices."""

    def __init__(self, frames: int) -> None:
        self.resets, self.lifted, self.lifted_max_m, self.vertices = [0.0] * frames, [0.0] * frames, [0.0] * frames, 0

    def add(self, reports: Sequence[FoldReport], vertices: int, *, visible: bool) -> None:
        """Adds a layer of so many ``vertices``, with its ``reports``, one for each frame. Of a hidden layer only the
        folds that began anew count."""
        self.vertices += vertices if visible else 0
        for row, report in enumerate(reports):
            self.resets[row] += report.reset
            if visible:
                self.lifted[row] += vertices * report.lifted_share
                self.lifted_max_m[row] = max(self.lifted_max_m[row], report.lifted_max_m)

    def quality(self, before: Quality) -> Quality:
        share = 1.0 / max(self.vertices, 1)
        return changed(
            before,
            folds_resets=np.array(self.resets),
            pushed_share=np.array([share * lifted for lifted in self.lifted]),
            push_max_m=np.array(self.lifted_max_m),
        )
