"""A garment or an outfit that is worn, the fabric of each layer, and the layers that must be draped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from drape.body.model import BodyModel
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.errors import InputError, TooLarge
from drape.garment.cache import Garment
from drape.garment.fine import fine_garment
from drape.wire.layout import JetLayout, pack_layout
from drape.wire.options import DrapeOptions, FabricChoice

PATCH_LIMIT = 65536  # what a chart of a LAYOUT can name
Source = Literal["shipped", "user"]


@dataclass(frozen=True)
class About:
    """The facts of a garment that its owner changes: a title, None for the name it came with, and being published."""

    title: str | None = None
    published: bool = False


UNCHANGED = About()


class BodyInService(Protocol):
    """A body and what drapes on it: ``drape.stages.body_stages.BodyStages``."""

    @property
    def body(self) -> BodyModel: ...


@dataclass(frozen=True, eq=False)
class Entry:
    """A garment in service. ``owner`` is the key that uploaded it, if keys were asked for; ``worn``
    the body that it was cut for and its stages, where that is not the standard one."""

    id: str
    garment: Garment
    source: Source
    path: Path | None = None
    owner: str | None = None
    about: About = UNCHANGED
    worn: BodyInService | None = None

    @property
    def published(self) -> bool:
        """Whether every key may see it."""
        return self.about.published

    @property
    def name(self) -> str:
        """The title that its owner gave it, or the name it came with."""
        return self.about.title or self.garment.name

    def seen_by(self, viewer: str | None) -> bool:
        """Whether the key ``viewer`` (None: whoever has none) may know of it."""
        return self.owner is None or self.published or self.owner == viewer

    @property
    def layers(self) -> tuple[Entry, ...]:
        """The layers of the scene: this garment alone. An outfit has several."""
        return (self,)

    def only(self, ids: Sequence[str]) -> Entry:
        """Returns the garment itself: ``ids`` leave nothing out of a scene of one garment."""
        return self

    @cached_property
    def fine(self) -> Entry:
        """The entry with the subdivided mesh as its delivered one; itself if nothing was subdivided."""
        garment = fine_garment(self.garment)
        return self if garment is self.garment else replace(self, garment=garment)

    @property
    def vertex_count(self) -> int:
        """The number of vertices that are drawn."""
        return self.garment.surface.vertex_count

    @property
    def patch_count(self) -> int:
        return self.garment.patch_count

    @cached_property
    def jet_layout(self) -> bytes:
        """The LAYOUT message (``drape.wire.layout``): what a client needs to make vertices of its jets."""
        garment = self.garment
        rows = np.arange(garment.vertex_count) if garment.drawn is None else garment.drawn.heaviest
        if garment.patch_count > PATCH_LIMIT:
            raise TooLarge(
                f"garment {garment.name} patches",
                expected=f"at most {PATCH_LIMIT} for jets",
                got=str(garment.patch_count),
                cure="Ask for vertices.",
            )
        return pack_layout(
            JetLayout(
                garment.patch_rotation,
                garment.patch_centre,
                garment.patch_scale,
                garment.drawn_at_rest(),
                garment.chart_patch[rows],
                garment.chart_weight[rows],
                garment.chart_uv[rows],
            )
        )


@dataclass(frozen=True)
class Outfit:
    """Garments worn over each other, the innermost first."""

    layers: tuple[Entry, ...]

    def only(self, ids: Sequence[str]) -> Outfit:
        """Returns the outfit with only its layers of ``ids``. It stays an outfit if one is left, so that the answer
        names the garment."""
        return Outfit(tuple(entry for entry in self.layers if entry.id in ids))

    @property
    def fine(self) -> Outfit:
        """The outfit with the subdivided mesh of every layer."""
        return Outfit(tuple(entry.fine for entry in self.layers))

    @property
    def vertex_count(self) -> int:
        """The number of vertices of all layers together."""
        return sum(entry.vertex_count for entry in self.layers)

    @property
    def patch_count(self) -> int:
        """The number of patches of all layers together."""
        return sum(entry.patch_count for entry in self.layers)


Scene = Entry | Outfit


def layer_list(scene: Scene, *, patches: bool = False) -> list[dict[str, str | int]]:
    """Returns what an answer says of each layer, in the order of its vertices: ``id``, ``vertices`` and, if asked for,
    ``patches``."""
    layers: list[dict[str, str | int]] = [{"id": entry.id, "vertices": entry.vertex_count} for entry in scene.layers]
    for layer, entry in zip(layers, scene.layers, strict=True):
        if patches:
            layer["patches"] = entry.patch_count
    return layers


def layer_fabrics(options: DrapeOptions, layers: int) -> tuple[Fabric | None, ...]:
    """Returns the fabric of each of ``layers`` garments, None where it is the garment's own.

    Refuses (``InputError``, ``NotFound``) an unknown fabric, and a list of another length.
    """
    chosen = options.fabric
    if not isinstance(chosen, tuple):
        return (_fabric(chosen),) * layers
    if len(chosen) != layers:
        raise InputError(
            "fabric",
            expected=f"one for all, or {layers}: one for each garment",
            got=str(len(chosen)),
            cure="Put null where a garment keeps its own.",
        )
    return tuple(_fabric(one) for one in chosen)


def _fabric(chosen: FabricChoice | None) -> Fabric | None:
    if chosen is None:
        return None
    return fabric(chosen if isinstance(chosen, str) else chosen.model_dump())


def check_known(fabrics: Sequence[Fabric | None], *, known: bool, model: str) -> None:
    """Refuses (``InputError``) any fabric where the ``model`` has one cloth only."""
    if not known and any(one is not None for one in fabrics):
        raise InputError(
            "fabric", expected=f"none: model {model} was trained on one cloth", got="a fabric", cure="Leave it out."
        )


def narrowed(scene: Scene, options: DrapeOptions, *, felt: bool, pressed: bool) -> tuple[list[int], DrapeOptions]:
    """Returns the numbers of the layers of ``scene`` that must be draped, and ``options`` for these.

    A hidden layer must be draped where a visible one lies over it, if layers are ``felt`` by those above; and where a
    visible one lies below it, if layers are ``pressed`` by those above. Refuses (``InputError``) hidden garments that
    are not worn, and an outfit that is hidden as a whole.
    """
    worn = [layer.id for layer in scene.layers]
    if options.hidden is None:
        return list(range(len(worn))), options
    unknown = [name for name in options.hidden if name not in worn]
    if unknown:
        cure = "Hide garments of this request only."
        raise InputError("hidden", expected=f"some of: {', '.join(worn)}", got=unknown[0], cure=cure)
    visible = [i for i, name in enumerate(worn) if name not in options.hidden]
    if not visible:
        raise InputError("hidden", expected="one visible garment or more", got="none", cure="Leave one out of hidden.")
    first, last = visible[0] if pressed else len(worn), visible[-1] if felt else 0
    kept = [i for i in range(len(worn)) if i in visible or i < last or i > first]
    narrow: dict[str, Any] = {"hidden": tuple(worn[i] for i in kept if i not in visible) or None}
    if isinstance(options.fabric, tuple):
        narrow["fabric"] = tuple(options.fabric[i] for i in kept)
    return kept, options.model_copy(update=narrow)
