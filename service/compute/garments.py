"""The garments in service: shipped and uploaded caches, whose constants every stage stores."""

from __future__ import annotations

import hashlib
import logging
import re
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.errors import ArtifactError, DrapeError, InputError, NotFound, TooLarge, did_you_mean, legible
from drape.garment.bound import BoundMesh
from drape.garment.cache import CHARTS_PER_VERTEX, Garment, load_garment
from drape.geometry.jets import JET_COUNT
from drape.graph.layer_feed import check_layers
from drape.stages.body_stages import BodyStages
from drape.stages.scene import UNCHANGED, About, Entry, Outfit, Scene, Source
from drape.stages.stage import Make, call_here
from service.compute import garment_files

if TYPE_CHECKING:
    from service.settings import Settings

INTAKE = "Run the intake again."
log = logging.getLogger("drape.service")


class Registry:
    """The garments in service by their ids, shipped and uploaded ones, as ``Entry``.

    ``worn`` has the stages that drape on the standard body. ``read(path)`` returns the garment of a cache; a garment's
    constants are then made when a request first needs them. Where ``read`` is None, each cache is read by ``prepare``
    and its constants are made at once. ``make(function, *arguments)`` calls a function that takes long. A shipped cache
    that cannot be read stops the start; an uploaded one is left out, and ``refused`` has a line on it.
    """

    def __init__(
        self,
        settings: Settings,
        worn: BodyStages,
        make: Make = call_here,
        read: Callable[[Path], Garment] | None = None,
    ) -> None:
        take, self._at_once = read or self.prepare, read is None
        self._settings, self._worn, self._make = settings, worn, make
        self._entries: dict[str, Entry] = {}
        self.refused: list[str] = []
        self.others: Callable[[str, str | None], Entry | None] = lambda name, viewer: None
        """Looks up garments that only one avatar wears and that no list has, by id and the key that asks."""
        for path in _shipped(settings):
            self.add(take(path), "shipped")
        for path in garment_files.list_caches(settings.garments_dir):
            try:
                self.add(take(path), "user", path)
            except Exception as error:  # no uploaded file may stop the start
                self.refused.append(set_aside(path, error))

    def entries(self) -> list[Entry]:
        """Returns all garments in service, shipped ones first."""
        return list(self._entries.values())

    def visible(self, viewer: str | None) -> list[Entry]:
        """Returns the garments that the key ``viewer`` may see: shipped ones, published ones and its own."""
        return [entry for entry in self.entries() if entry.seen_by(viewer)]

    def get(self, name: str, viewer: str | None = None) -> Entry:
        """Returns the entry of the garment with the id ``name``. Refuses (``NotFound``) an unknown one, and one that
        the key ``viewer`` may not see."""
        entry = self._entries.get(name) or self.others(name, viewer)
        if entry is None or not entry.seen_by(viewer):
            ids = sorted(entry.id for entry in self.visible(viewer))
            known = ", ".join(ids[:20]) or "none yet"
            cure = did_you_mean(name, ids, "GET /garments lists them; POST /garments adds one.")
            raise NotFound("garment", expected=f"one of: {known}", got=name[:120], cure=cure)
        return entry

    def scene(self, garment: str | None, garments: Sequence[str] | None, viewer: str | None = None) -> Scene:
        """Returns the scene of one ``garment``, or of ``garments`` worn over each other, the innermost first.

        Refuses both and neither (``InputError``), an unknown garment (``NotFound``), one that is named twice, and more
        layers than ``DRAPE_MAX_LAYERS`` (``TooLarge``).
        """
        if garment is not None and garments is not None:
            cure = "Name one garment, or the layers of an outfit."
            raise InputError("garments", expected="garment or garments", got="both", cure=cure)
        worn = garments if garment is None else [garment]
        if worn is None:
            raise InputError("garment", expected="a value", got="nothing", cure="See /docs for the request's fields.")
        if len(worn) == 1:
            return self.get(worn[0], viewer)
        limit = self._settings.max_layers
        if len(worn) > limit:
            cure = "Leave the inner ones out that cannot be seen."
            raise TooLarge("garments", expected=f"at most {limit} layers", got=str(len(worn)), cure=cure)
        entries = tuple(self.get(name, viewer) for name in worn)
        check_layers([entry.garment for entry in entries])
        return Outfit(entries)

    def prepare(self, path: Path) -> Garment:
        """Returns the garment of the cache ``path``, read by a call of ``make``. Where the registry was made without
        ``read``, the garment's constants are made too. Refuses as ``check_garment`` does."""
        garment = self._make(_read, path, self._worn.body, self._settings.max_vertices)
        if self._at_once:
            self._worn.add(garment, self._worn.feed(garment))
        return garment

    def add(self, garment: Garment, source: Source, path: Path | None = None) -> Entry:
        """Puts ``garment``, which ``prepare`` has checked, in service and returns its entry.

        Its id is its name, or name and digest if another garment has that id. ``path`` is its cache, None for a shipped
        one. A cache in the folder of a key belongs to that key; its id then does not depend on other keys' garments.
        """
        about = UNCHANGED if path is None else garment_files.read_about(path)
        owner = garment_files.owner_of(path)
        name = slug(garment.name)
        present = self._entries.get(name)
        if owner is not None:
            name = f"{name}-{hashlib.sha256(f'{owner} {garment.digest}'.encode()).hexdigest()[:8]}"
        elif present is not None and present.garment.digest == garment.digest:
            source, path = present.source, path if present.source == "user" else None
        elif present is not None or not (path is None or garment_files.claim(path, name)):
            name = f"{name}-{garment.digest[:8]}"
        entry = self._entries[name] = Entry(name, garment, source, path, owner, about)
        return entry

    def change(self, entry: Entry, *, name: str | None, published: bool | None) -> Entry:
        """Changes the name of ``entry`` and whether it is published, on disk and in service; None keeps the value.
        Returns the new entry."""
        assert entry.path is not None
        title = entry.about.title if name is None else name
        garment_files.write_about(entry.path, About(title, entry.published if published is None else published))
        return self.read_again(entry)

    def read_again(self, entry: Entry) -> Entry:
        """Puts ``entry`` in service with the name and visibility that its ``About`` file has now. Returns the new
        entry."""
        assert entry.path is not None
        changed = self._entries[entry.id] = replace(entry, about=garment_files.read_about(entry.path))
        return changed

    def withdraw(self, entry: Entry) -> None:
        """Makes ``entry`` unknown to later requests. ``remove`` or ``forget`` frees its constants later."""
        self._entries.pop(entry.id, None)

    def remove(self, entry: Entry) -> None:
        """Deletes the files of ``entry`` and takes it out of service."""
        if entry.path is not None:
            garment_files.remove_cache(entry.path, entry.id)
        self.forget(entry)

    def forget(self, entry: Entry) -> None:
        """Takes ``entry`` out of service, and frees its constants if no other entry has the same garment."""
        self.withdraw(entry)
        if all(other.garment.digest != entry.garment.digest for other in self.entries()):
            for garment in (entry.garment, entry.fine.garment):
                self._worn.remove(garment)


def begin_reading(settings: Settings, body: BodyModel) -> Callable[[Path], Garment]:
    """Begins to read all caches in a thread. Returns a function that returns the garment of a cache, once it is read;
    it refuses as ``check_garment`` does."""
    with_limit = partial(_read, body=body, max_vertices=settings.max_vertices)
    pool = ThreadPoolExecutor(1, "drape-reading")
    stored = [*_shipped(settings), *garment_files.list_caches(settings.garments_dir)]
    begun = {path: pool.submit(with_limit, path) for path in stored}
    pool.shutdown(wait=False)
    return lambda path: begun[path].result() if path in begun else with_limit(path)


def _shipped(settings: Settings) -> list[Path]:
    return garment_files.list_shipped(settings.shipped_garments_dir, "DRAPE_SHIPPED_GARMENTS_DIR")


def set_aside(path: Path, error: Exception) -> str:
    """Logs that the cache ``path`` cannot be read because of ``error``, and returns the line: file name and reason."""
    line = legible(f"{path.name}: {error if isinstance(error, DrapeError) else repr(error)[:200]}")
    log.warning("garment set aside: %s", line)
    return line


def _read(path: Path, body: BodyModel, max_vertices: int) -> Garment:
    """Returns the checked garment of the cache ``path``. No stage has its constants yet."""
    garment = load_garment(path)
    check_garment(garment, body, max_vertices=max_vertices)
    return garment


def slug(name: str) -> str:
    """Returns ``name`` as a part of an id: at most 80 letters, digits, dots, dashes and underscores, with a dash in
    place of all else; "garment" if nothing is left."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", name).strip("-.")[:80] or "garment"


def check_garment(garment: Garment, body: BodyModel, *, max_vertices: int) -> None:
    """Refuses a garment that was made for another body than ``body``, or whose arrays do not fit together or have
    numbers that are not finite (``ArtifactError``), and one of more than ``max_vertices`` vertices, delivered or drawn
    (``TooLarge``)."""
    label, cure = f"garment {garment.name}", INTAKE
    if garment.body_digest != body.digest:
        raise ArtifactError(
            f"{label} body_digest", expected=f"{body.digest} ({body.name})", got=garment.body_digest, cure=cure
        )
    delivered, patches = garment.vertex_count, garment.patch_count
    if delivered > max_vertices:
        raise TooLarge(
            f"{label} vertices", expected=f"at most {max_vertices}", got=str(delivered), cure="Simplify the mesh."
        )
    rows = len(garment.vertices)
    shapes = {
        "vertices": (rows, 3),
        "chart_patch": (rows, CHARTS_PER_VERTEX),
        "chart_weight": (rows, CHARTS_PER_VERTEX),
        "chart_uv": (rows, CHARTS_PER_VERTEX, 2),
        "chart_residual": (rows, CHARTS_PER_VERTEX, 3),
        "patch_rotation": (patches, 3, 3),
        "patch_centre": (patches, 3),
        "patch_scale": (patches,),
        "patch_jet": (patches, JET_COUNT),
        "patch_weights": (patches, JOINT_COUNT),
        "face_material": (len(garment.faces),),
    }
    for name, shape in shapes.items():
        array = getattr(garment, name)
        if array.shape != shape:
            raise ArtifactError(f"{label} {name}", expected=f"shape {shape}", got=f"shape {array.shape}", cure=cure)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ArtifactError(f"{label} {name}", expected="finite numbers", got="NaN or infinity", cure=cure)
    if not 0 < delivered <= rows or patches == 0:
        raise ArtifactError(
            f"{label} vertex_count",
            expected=f"1 to {rows}, and patches",
            got=f"{delivered}, {patches} patches",
            cure=cure,
        )
    if garment.drawn is not None:
        _check_drawn(label, garment, garment.drawn, max_vertices)
    _check_indices(label, garment)


def _check_drawn(label: str, garment: Garment, drawn: BoundMesh, most: int) -> None:
    """Refuses the drawn mesh of a garment if it has too many vertices or its arrays do not fit together."""
    count = len(drawn.corner)
    if count > most:
        raise TooLarge(f"{label} drawn vertices", expected=f"at most {most}", got=str(count), cure="Simplify the mesh.")
    shapes = {"corner": (count, 3), "weight": (count, 3), "offset": (count, 3), "kind": (count,)}
    for name, shape in (shapes | {"face_material": (len(drawn.faces),)}).items():
        array = getattr(drawn, name)
        if array.shape != shape or (array.dtype.kind == "f" and not np.isfinite(array).all()):
            got = f"shape {array.shape}, or numbers that are not finite"
            raise ArtifactError(f"{label} drawn {name}", expected=f"shape {shape}, finite", got=got, cure=INTAKE)


def _check_indices(label: str, garment: Garment) -> None:
    """Refuses faces, charts and texture faces whose indices are out of range."""
    bounds: list[tuple[Any, str, int]] = [(garment, "faces", garment.vertex_count)]
    bounds += [(garment, "chart_patch", garment.patch_count), (garment, "uv_faces", len(garment.uv))]
    if (drawn := garment.drawn) is not None:
        bounds += [(drawn, "corner", garment.vertex_count), (drawn, "faces", drawn.vertex_count)]
        bounds += [(drawn, "uv_faces", len(drawn.uv)), (drawn, "kind", 3)]
    for owner, name, limit in bounds:
        array = getattr(owner, name)
        if array.size and (array.min() < 0 or array.max() >= limit):
            raise ArtifactError(
                f"{label} {name}",
                expected=f"indices in [0, {limit})",
                got=f"[{array.min()}, {array.max()}]",
                cure=INTAKE,
            )
