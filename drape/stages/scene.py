"""Scenes: a garment or an outfit, the fabric of each layer, and the layers that must be draped."""

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
    """What an owner may change of a garment: its ``title``, None for the name it came with, and whether every API key
    may see it (``published``)."""

    title: str | None = None
    published: bool = False


UNCHANGED = About()


class BodyInService(Protocol):
    """A body and the stages that drape on it, as ``drape.stages.body_stages.BodyStages`` has them."""

    @property
    def body(self) -> BodyModel: ...


@dataclass(frozen=True, eq=False)
class Entry:
    """A garment in service, which is also a scene of one layer.

    ``path`` is its file, None for a shipped garment and outside the service. ``owner`` is the name of the API key that
    uploaded it, None for a shipped garment and for one that was uploaded without a key. ``worn`` is the body that it
    was cut for, None for the standard one.
    """

    id: str
    garment: Garment
    source: Source
    path: Path | None = None
    owner: str | None = None
    about: About = UNCHANGED
    worn: BodyInService | None = None

    @property
    def published(self) -> bool:
        """Returns whether every API key may see the garment."""
        return self.about.published

    @property
    def name(self) -> str:
        """Returns the title that its owner gave it, or else the name it came with."""
        return self.about.title or self.garment.name

    def seen_by(self, viewer: str | None) -> bool:
        """Returns whether the API key of the name ``viewer``, None for a client without a key, may see the garment."""
        return self.owner is None or self.published or self.owner == viewer

    @property
    def layers(self) -> tuple[Entry, ...]:
        """Returns the layers of the scene: this garment alone."""
        return (self,)

    def only(self, ids: Sequence[str]) -> Entry:
        """Returns the garment itself: ``ids`` leave nothing out of a scene of one garment."""
        return self

    @cached_property
    def fine(self) -> Entry:
        """Returns the entry of the garment's subdivided mesh; itself if intake did not subdivide it."""
        garment = fine_garment(self.garment)
        return self if garment is self.garment else replace(self, garment=garment)

    @property
    def vertex_count(self) -> int:
        """Returns the number of vertices of the drawn mesh."""
        return self.garment.surface.vertex_count

    @property
    def patch_count(self) -> int:
        return self.garment.patch_count

    @cached_property
    def jet_layout(self) -> bytes:
        """Returns the LAYOUT message (``drape.wire.layout``), by which a client makes vertices of the garment's jets.

        Refuses (``TooLarge``) a garment of more than ``PATCH_LIMIT`` patches.
        """
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
        """Returns the outfit with only its layers of ``ids``, still an outfit if one is left: its answer names
        garments."""
        return Outfit(tuple(entry for entry in self.layers if entry.id in ids))

    @property
    def fine(self) -> Outfit:
        """Returns the outfit with the subdivided mesh of every layer that has one."""
        return Outfit(tuple(entry.fine for entry in self.layers))

    @property
    def vertex_count(self) -> int:
        """Returns the number of vertices of all layers together."""
        return sum(entry.vertex_count for entry in self.layers)

    @property
    def patch_count(self) -> int:
        """Returns the number of patches of all layers together."""
        return sum(entry.patch_count for entry in self.layers)


Scene = Entry | Outfit


def layer_list(scene: Scene, *, patches: bool = False) -> list[dict[str, str | int]]:
    """Returns for each layer a document with its ``id``, the number of its ``vertices`` and, with ``patches``, of its
    ``patches``, in the order of the layers."""
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
    return tuple(_fabric(own) for own in chosen)


def _fabric(chosen: FabricChoice | None) -> Fabric | None:
    if chosen is None:
        return None
    return fabric(chosen if isinstance(chosen, str) else chosen.model_dump())


def check_known(fabrics: Sequence[Fabric | None], *, known: bool, model: str) -> None:
    """Refuses (``InputError``) any of ``fabrics`` that is not None, unless ``known``: whether ``model``, a name, drapes
    by fabrics."""
    if not known and any(own is not None for own in fabrics):
        raise InputError(
            "fabric", expected=f"none: model {model} was trained on one cloth", got="a fabric", cure="Leave it out."
        )


def narrowed(scene: Scene, options: DrapeOptions, *, felt: bool, pressed: bool) -> tuple[list[int], DrapeOptions]:
    """Returns the indices of the layers of ``scene`` that must be draped, and ``options`` for these layers alone.

    Visible layers are draped, and hidden ones below the outermost visible one if layers feel those below (``felt``), or
    above the innermost visible one if layers give way to those above (``pressed``). Refuses (``InputError``) hidden
    garments that are not worn, and an outfit that is hidden as a whole.
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
