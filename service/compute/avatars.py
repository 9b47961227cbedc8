"""The avatars in service: characters of users, and for each the stages and the garments that are cut for it."""

from __future__ import annotations

import hashlib
import json
import logging
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import BaseModel, Field

from drape.avatar.attire_words import Kind
from drape.avatar.own_clothes import Halves
from drape.avatar.wearer import Wearer, load_wearer
from drape.avatar.wears import Reach, reach_of, why_not
from drape.body.model import BodyModel
from drape.errors import ArtifactError, NotFound, did_you_mean
from drape.garment.tailor import tailored, tailored_digest
from drape.stages.body_stages import BodyStages
from drape.stages.scene import Entry, Outfit, Scene
from drape.stages.stage import Make, call_here
from drape.wanted import go_on
from service.compute import garment_files
from service.compute.records import read_record

if TYPE_CHECKING:
    from service.settings import Settings

FOLDER = ".avatars"  # beside the garments, which their registry looks for without dots
log = logging.getLogger("drape.service")
# Avatars whose stages and garments are kept, 20 to 40 MB a garment; others are made again when they are worn.
MOST_WORN = 4


class AvatarPart(BaseModel):
    """One part of a character."""

    name: str
    kind: Kind = Field(description="What it is.")
    faces: int = Field(description="The number of its triangles.")
    sure: float = Field(description="How sure the kind is, 0 to 1; 1 where a client told it.")
    bulky: bool = Field(default=False, description="Whether it is a thing that comes off with what a top replaces.")


class AvatarFacts(BaseModel):
    """The facts of an avatar that clients are told."""

    name: str
    digest: str
    joints: dict[str, str] = Field(description="The node of the character's skeleton for each of SMPL's joints.")
    found_by: Literal["vrm", "names", "shape", "told"] = Field(
        default="names",
        description="How the joints were found: by VRM's bones, by the names of nodes, by their "
        "places, or told by PATCH.",
    )
    confidence: float = Field(
        default=1.0, description="Of joints found by their places: how much these are like a person's, 0 to 1."
    )
    notes: list[str] = Field(default=[], description="Sentences on what looks wrong with the character.")
    nodes: list[str] = Field(
        description="The names of all nodes of its file, parents first. The rotations of "
        "``rig_poses`` come in this order."
    )
    fit: dict[str, float] = Field(
        description="The distances [mm] of its trunk and limbs from the body that stands for it."
    )
    height_m: float
    rest_joints: list[list[float]] = Field(
        description="The joints at rest [m] of the body that stands for it, as in BodyDocument."
    )
    floor_m: float = Field(description="The height of its soles [m].")
    scale: float = Field(description="How many metres a unit of its file is.")
    vrm: str | None = Field(description="The version of VRM, if the file is one.")
    vertices: int = Field(description="The number of vertices of its own surface.")
    parts: list[AvatarPart] = Field(
        default=[], description="What is what on the character: skin, hair, clothes, things that it carries."
    )


class AvatarInfo(AvatarFacts):
    """A user's character that wears garments."""

    id: str


class AvatarWears(AvatarInfo):
    """A user's character, and what it can wear."""

    wears: dict[str, bool] = Field(description="Whether it can wear each garment, by the garments' ids.")
    wears_why: dict[str, str] = Field(description="Why it cannot wear a garment.")


@dataclass(frozen=True)
class AvatarRecord:
    """What is stored of an avatar beside its files."""

    id: str
    told: AvatarFacts
    owner: str | None


@dataclass(frozen=True)
class AvatarEntry:
    """An avatar in service: ``told`` are its facts for clients, ``path`` its file; ``source`` the user's own file."""

    id: str
    path: Path
    source: Path
    told: AvatarFacts
    owner: str | None = None

    @cached_property
    def document(self) -> bytes:
        """What clients are told of it, an ``AvatarInfo`` as JSON: thousands of nodes are written once."""
        return AvatarInfo(id=self.id, **self.told.model_dump()).model_dump_json().encode()

    def seen_by(self, viewer: str | None) -> bool:
        """Whether the key ``viewer`` may know of it."""
        return self.owner is None or self.owner == viewer


class Avatars:
    """Avatars by id. What one needs to wear garments is made when it first wears one."""

    def __init__(
        self, body: BodyModel, settings: Settings, stages_on: Callable[[BodyModel], BodyStages], make: Make = call_here
    ) -> None:
        self._body, self._stages_on, self._make = body, stages_on, make
        self._root = settings.garments_dir / FOLDER
        self._entries: dict[str, AvatarEntry] = {}
        self._worn: OrderedDict[str, _Dressed] = OrderedDict()
        self._reaches: dict[str, Reach] = {}
        self._one = threading.Lock()
        self._seen: dict[Path, int] = {}  # when each file that tells of an avatar was written [ns]
        self.follow()

    def follow(self) -> None:
        """Takes over what the folder has: at the start all, later what other services added, corrected or removed."""
        there = garment_files.told(self._root)
        for about, written_ns in there.items():
            if self._seen.get(about) != written_ns:
                self._read(about)
        for entry in [one for one in self._entries.values() if one.path.with_suffix(".json") not in there]:
            if not entry.path.exists():  # else it came after the look
                self._entries.pop(entry.id, None)
                self._undress(entry.id)
        self._seen = there

    def _read(self, about: Path) -> None:
        """Puts the avatar that ``about`` tells of in service; a file that was removed meanwhile is passed over."""
        held = read_record(AvatarRecord, about)
        if held is None:
            return
        entry = AvatarEntry(held.id, about.with_suffix(".npz"), about.with_suffix(".glb"), held.told, held.owner)
        if entry.path.is_file() and entry != self._entries.get(entry.id):
            self._entries[entry.id] = entry
            self._undress(entry.id)

    @property
    def worn(self) -> tuple[BodyStages, ...]:
        """The bodies of those that wear garments."""
        return tuple(stages for one in list(self._worn.values()) for stages in list(one.stages.values()))

    def visible(self, viewer: str | None) -> list[AvatarEntry]:
        """Those that the key ``viewer`` may know of."""
        return [entry for entry in list(self._entries.values()) if entry.seen_by(viewer)]

    def get(self, name: str, viewer: str | None = None) -> AvatarEntry:
        """The avatar ``name``; refuses an unknown one, and one that ``viewer`` may not know of."""
        entry = self._entries.get(name)
        if entry is None or not entry.seen_by(viewer):
            ids = sorted(one.id for one in self.visible(viewer))
            known = ", ".join(ids[:20]) or "none yet"
            cure = did_you_mean(name, ids, "GET /avatars lists them; POST /avatars adds one.")
            raise NotFound("avatar", expected=f"one of: {known}", got=name[:120], cure=cure)
        return entry

    def add(self, made: Path, source: Path, owner: str | None) -> AvatarEntry:
        """Puts the avatar stored at ``made``, read from the user's file ``source``, in service; both files move."""
        wearer = load_wearer(made, self._body)
        name = wearer.name
        if owner is not None:
            name = f"{name}-{hashlib.sha256(f'{owner} {wearer.digest}'.encode()).hexdigest()[:8]}"
        elif (taken := self._entries.get(name)) is not None and taken.told.digest != wearer.digest:
            name = f"{name}-{wearer.digest[:8]}"
        return self._stored(name, made, source, owner, wearer)

    def replaced(self, entry: AvatarEntry, made: Path) -> AvatarEntry:
        """``entry`` as the file ``made`` has it, whose joints were corrected."""
        wearer = load_wearer(made, self._body)
        self._undress(entry.id)
        return self._stored(entry.id, made, entry.source, entry.owner, wearer)

    def _stored(self, name: str, made: Path, source: Path, owner: str | None, wearer: Wearer) -> AvatarEntry:
        folder = garment_files.folder_of(self._root, owner)
        folder.mkdir(parents=True, exist_ok=True)
        entry = AvatarEntry(name, folder / f"{name}.npz", folder / f"{name}.glb", _facts(wearer), owner)
        made.replace(entry.path)
        if source != entry.source:
            source.replace(entry.source)
        text = json.dumps({"id": name, "told": entry.told.model_dump(), "owner": owner})
        garment_files.replace_text(entry.path.with_suffix(".json"), text)
        self._entries[name] = entry
        return entry

    def remove(self, entry: AvatarEntry) -> None:
        """Takes ``entry`` off the disk and out of service."""
        self._entries.pop(entry.id, None)
        for path in (entry.path.with_suffix(".json"), entry.path, entry.source):
            path.unlink(missing_ok=True)
        self._undress(entry.id)

    def _undress(self, name: str) -> None:
        with self._one:
            self._worn.pop(name, None)

    # --- what it wears ---

    def wearer(self, name: str) -> Wearer:
        """The wearer of the avatar ``name``; from any thread."""
        return self._dressed(name).wearer

    def _dressed(self, name: str) -> _Dressed:
        with self._one:
            if name not in self._worn:
                wearer = self._stored_wearer(self._entries.get(name) or self.get(name))
                self._worn[name] = _Dressed(wearer, self._stages_on, self._body, self._make)
                while len(self._worn) > MOST_WORN:
                    self._worn.popitem(last=False)
            self._worn.move_to_end(name)
            return self._worn[name]

    def _stored_wearer(self, entry: AvatarEntry) -> Wearer:
        """The wearer in the file of ``entry``, which is set aside where that cannot be read."""
        try:
            return load_wearer(entry.path, self._body)
        except ArtifactError as error:
            log.warning("avatar set aside: %s", error)
            self._entries.pop(entry.id, None)
            raise NotFound(error.name, expected=error.expected, got=error.got, cure=error.cure) from error

    def dress(self, name: str, scene: Scene) -> Scene:
        """The garments of ``scene`` cut for the avatar ``name``; seconds for each that it never wore."""
        dressed = self._dressed(name)
        reaches = [self._reach(layer) for layer in scene.layers]
        halves = Halves(*(any(which) for which in zip(*(reach.halves for reach in reaches), strict=True)))
        for layer, reach in zip(scene.layers, reaches, strict=True):
            if (refusal := why_not(dressed.wearer.body, reach, garment=layer.id)) is not None:
                raise refusal
        layers = tuple(dressed.cut(layer, halves) for layer in scene.layers)
        return Outfit(layers) if isinstance(scene, Outfit) else layers[0]

    def wears(self, name: str, entries: Sequence[Entry]) -> dict[str, str | None]:
        """Why the avatar ``name`` cannot wear each of ``entries``, by their ids; None where it can: what ``dress`` then
        never refuses."""
        body = self.wearer(name).body
        found = {entry.id: why_not(body, self._reach(entry), garment=entry.id) for entry in entries}
        return {key: None if refusal is None else str(refusal) for key, refusal in found.items()}

    def _reach(self, entry: Entry) -> Reach:
        digest = entry.garment.digest
        if digest not in self._reaches:
            self._reaches[digest] = reach_of(entry.garment, self._body)
        return self._reaches[digest]


class _Dressed:
    """An avatar with its stages and the garments that were cut for it, for each of its bodies."""

    def __init__(
        self, wearer: Wearer, stages_on: Callable[[BodyModel], BodyStages], standard: BodyModel, make: Make
    ) -> None:
        self.wearer, self._stages_on, self._standard, self._make = wearer, stages_on, standard, make
        self.stages: dict[str, BodyStages] = {wearer.body.digest: stages_on(wearer.body)}
        self._cut: dict[str, Entry] = {}
        self._one = threading.Lock()

    def cut(self, entry: Entry, halves: Halves) -> Entry:
        """``entry`` for this avatar, among garments that lie on these ``halves``."""
        body = self.wearer.body_under(halves)
        digest = tailored_digest(entry.garment, body)
        with self._one:
            go_on()
            if body.digest not in self.stages:
                self.stages[body.digest] = self._stages_on(body)
            if digest not in self._cut:
                garment = self._make(tailored, entry.garment, self._standard, body)
                self._cut[digest] = replace(entry, garment=garment, worn=self.stages[body.digest])
            return self._cut[digest]


def _facts(wearer: Wearer) -> AvatarFacts:
    """The facts of ``wearer`` that clients are told."""
    return AvatarFacts(
        name=wearer.name,
        digest=wearer.digest,
        joints=wearer.joints,
        found_by=wearer.found_by,  # pyright: ignore[reportArgumentType]
        confidence=round(wearer.confidence, 3),
        notes=list(wearer.notes),
        nodes=list(wearer.nodes),
        fit={"median_mm": round(wearer.median_mm, 2), "p95_mm": round(wearer.p95_mm, 2)},
        height_m=round(wearer.height_m, 4),
        rest_joints=np.round(wearer.body.joints_template, 6).tolist(),
        floor_m=round(wearer.body.floor_m(), 6),
        scale=wearer.scale,
        vrm=wearer.vrm or None,
        vertices=len(wearer.vertices),
        parts=[AvatarPart(**part._asdict()) for part in wearer.attire.parts],
    )
