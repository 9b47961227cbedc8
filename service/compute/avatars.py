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
from typing import TYPE_CHECKING, NamedTuple

from drape.avatar.own_clothes import Halves, joined_halves
from drape.avatar.own_garments import MARK, OWN, body_of, split_own
from drape.avatar.wearer import Wearer, load_wearer, upper_body
from drape.avatar.wears import Reach, reach_of, why_not
from drape.body.model import BodyModel
from drape.errors import ArtifactError, InputError, NotFound, TooLarge, did_you_mean
from drape.garment.cache import Garment, load_garment
from drape.garment.tailor import tailored, tailored_digest
from drape.stages.body_stages import BodyStages
from drape.stages.scene import Entry, Outfit, Scene
from drape.stages.stage import Make, call_here
from drape.wanted import go_on
from service.compute import garment_files
from service.compute.avatar_facts import AvatarFacts, AvatarInfo, facts_of, own_id
from service.compute.garments import check_garment
from service.compute.json_records import read_record

if TYPE_CHECKING:
    from service.settings import Settings

FOLDER = ".avatars"  # beside the garments, which their registry looks for without dots
log = logging.getLogger("drape.service")
# Avatars whose stages and garments are kept, 20 to 40 MB a garment; others are made again when they are worn.
MOST_WORN = 4


class OwnFiles(NamedTuple):
    """The stored clothes that a character came in: the ``caches`` of them, and ``stiff``, which says of other
    parts why they are no cloth.
    """

    caches: Sequence[Path]
    stiff: dict[str, str]


@dataclass(frozen=True)
class AvatarRecord:
    """The record that is stored beside an avatar's files."""

    id: str
    told: AvatarFacts
    owner: str | None


@dataclass(frozen=True)
class AvatarEntry:
    """An avatar in service. ``path``: its stored file; ``source``: the file that the user sent; ``facts``: what clients
    see of it; ``owner``: the key that sent it."""

    id: str
    path: Path
    source: Path
    facts: AvatarFacts
    owner: str | None = None

    @cached_property
    def document(self) -> bytes:
        """The JSON text of its ``AvatarInfo``. It is written once, because a character may have thousands of nodes."""
        return AvatarInfo(id=self.id, **self.facts.model_dump()).model_dump_json().encode()

    def own_files(self) -> list[Path]:
        """The caches of the garments that it came in."""
        return sorted(self.path.parent.glob(f"{self.id}{MARK}*.npz"))

    def wearing(self, garment: Garment) -> Entry:
        """The entry of a ``garment`` that it came in."""
        name = own_id(self.id, garment)
        return Entry(name, garment, "user", self.path.with_name(f"{name}.npz"), self.owner)

    def seen_by(self, viewer: str | None) -> bool:
        """Whether the key ``viewer`` may know of it."""
        return self.owner is None or self.owner == viewer


class Avatars:
    """Avatars by id. What one needs to wear garments is made when it first wears one."""

    def __init__(
        self, body: BodyModel, settings: Settings, stages_on: Callable[[BodyModel], BodyStages], make: Make = call_here
    ) -> None:
        self._body, self._stages_on, self._make = body, stages_on, make
        self._root, self._settings = settings.garments_dir / FOLDER, settings
        self._entries: dict[str, AvatarEntry] = {}
        self._worn: OrderedDict[str, _Dressed] = OrderedDict()
        self._reaches: dict[str, Reach] = {}
        self._one = threading.Lock()
        self._seen: dict[Path, int] = {}  # when each file that tells of an avatar was written [ns]
        self.follow()

    def follow(self) -> None:
        """Takes over what the folder has: at the start all, later what other services added, corrected or removed."""
        there = garment_files.list_avatar_facts(self._root)
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
        """Returns the bodies, with their stages, of the avatars that wear garments."""
        return tuple(stages for one in list(self._worn.values()) for stages in list(one.stages.values()))

    def visible(self, viewer: str | None) -> list[AvatarEntry]:
        """Returns the avatars that the key ``viewer`` may know of."""
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

    def add(self, file: Path, source: Path, owner: str | None, own: OwnFiles | None = None) -> AvatarEntry:
        """Puts the avatar stored at ``file`` in service and returns its entry; both files move into the folder.

        ``source`` is the user's file that it was read from. ``own``: its own clothes, if these were made garments.
        """
        wearer = load_wearer(file, self._body)
        name = wearer.name
        if owner is not None:
            name = f"{name}-{hashlib.sha256(f'{owner} {wearer.digest}'.encode()).hexdigest()[:8]}"
        elif (namesake := self._entries.get(name)) is not None and namesake.facts.digest != wearer.digest:
            name = f"{name}-{wearer.digest[:8]}"
        return self._stored(name, file, source, owner, wearer, own)

    def replaced(self, entry: AvatarEntry, file: Path, own: OwnFiles | None = None) -> AvatarEntry:
        """Puts the file ``file``, in which joints or parts were corrected, in the place of that of ``entry``. Returns
        the new entry."""
        wearer = load_wearer(file, self._body)
        self._undress(entry.id)
        return self._stored(entry.id, file, entry.source, entry.owner, wearer, own)

    def _stored(
        self, name: str, file: Path, source: Path, owner: str | None, wearer: Wearer, own: OwnFiles | None
    ) -> AvatarEntry:
        folder = garment_files.folder_of(self._root, owner)
        folder.mkdir(parents=True, exist_ok=True)
        garments = [] if own is None else [self._own(path, wearer) for path in own.caches]
        facts = facts_of(wearer, name, None if own is None else garments, {} if own is None else own.stiff)
        entry = AvatarEntry(name, folder / f"{name}.npz", folder / f"{name}.glb", facts, owner)
        for path in entry.own_files():
            path.unlink(missing_ok=True)
        for path, garment in zip([] if own is None else own.caches, garments, strict=True):
            path.replace(folder / f"{own_id(name, garment)}.npz")
        file.replace(entry.path)
        if source != entry.source:
            source.replace(entry.source)
        text = json.dumps({"id": name, "told": entry.facts.model_dump(), "owner": owner})
        garment_files.replace_text(entry.path.with_suffix(".json"), text)
        self._entries[name] = entry
        if own is not None:  # it is worn at once, and nothing is read again
            with self._one:
                self._dress_up(name, wearer).own = tuple(map(entry.wearing, garments))
        return entry

    def remove(self, entry: AvatarEntry) -> None:
        """Takes ``entry`` off the disk and out of service."""
        self._entries.pop(entry.id, None)
        for path in (entry.path.with_suffix(".json"), entry.path, entry.source, *entry.own_files()):
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
                self._dress_up(name, self._stored_wearer(self._entries.get(name) or self.get(name)))
            self._worn.move_to_end(name)
            return self._worn[name]

    def _dress_up(self, name: str, wearer: Wearer) -> _Dressed:
        self._worn[name] = _Dressed(wearer, self._stages_on, self._body, self._make)
        while len(self._worn) > MOST_WORN:
            self._worn.popitem(last=False)
        return self._worn[name]

    def _stored_wearer(self, entry: AvatarEntry) -> Wearer:
        """The wearer in the file of ``entry``, which is set aside where that cannot be read."""
        try:
            return load_wearer(entry.path, self._body)
        except ArtifactError as error:
            log.warning("avatar set aside: %s", error)
            self._entries.pop(entry.id, None)
            raise NotFound(error.name, expected=error.expected, got=error.got, cure=error.cure) from error

    def _own(self, path: Path, wearer: Wearer) -> Garment:
        """The checked garment of the cache ``path``, which ``wearer`` came in."""
        garment = load_garment(path)
        check_garment(garment, body_of(garment, wearer, self._body), max_vertices=self._settings.max_vertices)
        return garment

    def own(self, name: str) -> tuple[Entry, ...]:
        """The garments that the avatar ``name`` came in, the innermost first; from any thread."""
        entry, dressed = self._entries.get(name) or self.get(name), self._dressed(name)
        if dressed.own is None:
            paths = [entry.path.with_name(f"{one.garment}.npz") for one in entry.facts.alive or ()]
            dressed.own = tuple(entry.wearing(self._own(path, dressed.wearer)) for path in paths)
        return dressed.own

    def own_garment(self, garment_id: str, viewer: str | None) -> Entry | None:
        """Returns the garment ``garment_id`` of the clothes that an avatar came in; None if there is none that the key
        ``viewer`` may know of."""
        name, mark, _ = garment_id.partition(MARK)
        entry = self._entries.get(name) if mark else None
        if entry is None or not entry.seen_by(viewer):
            return None
        return next((one for one in self.own(name) if one.id == garment_id), None)

    def with_own(self, name: str, scene: Scene | None) -> Scene:
        """Returns ``scene`` with the garments that the avatar ``name`` came in, below and over those of ``scene``, but
        without those that these replace.

        Refuses (``TooLarge``) more layers than are taken, and an avatar none of whose clothes is cloth, if ``scene`` is
        None.
        """
        layers: tuple[Entry, ...] = () if scene is None else scene.layers
        own = {one.garment.digest: one for one in self.own(name) if one not in layers}
        sides = split_own([one.garment for one in own.values()], self._halves(layers))
        below, over = ([own[one.digest] for one in side] for side in sides)
        worn = [*below, *layers, *over]
        limit = self._settings.max_layers
        if len(worn) > limit:
            cure = "Name fewer garments, or leave alive out."
            raise TooLarge("garments", expected=f"at most {limit} layers", got=str(len(worn)), cure=cure)
        if not worn:
            cure = "Send the character with alive=true; GET /avatars/ID tells in `stiff` what is no cloth."
            raise NotFound("alive", expected="clothes of its own that are cloth", got="none", cure=cure)
        return Outfit(tuple(worn)) if len(worn) > 1 or isinstance(scene, Outfit) else worn[0]

    def dress(self, name: str, scene: Scene) -> Scene:
        """The garments of ``scene`` cut for the avatar ``name``; seconds for each that it never wore."""
        dressed = self._dressed(name)
        for layer in scene.layers:
            if OWN in layer.garment.manifest:
                check_own(layer, name)
            elif (refusal := why_not(dressed.wearer.body, self._reach(layer), garment=layer.id)) is not None:
                raise refusal
        halves = self._halves(scene.layers)
        layers = tuple(dressed.cut(layer, halves) for layer in scene.layers)
        return Outfit(layers) if isinstance(scene, Outfit) else layers[0]

    def wears(self, name: str, entries: Sequence[Entry]) -> dict[str, str | None]:
        """Returns for each of ``entries``, by its id, why the avatar ``name`` cannot wear it; None if it can. ``dress``
        refuses the same ones and no others."""
        body = self.wearer(name).body
        found = {entry.id: why_not(body, self._reach(entry), garment=entry.id) for entry in entries}
        return {key: None if refusal is None else str(refusal) for key, refusal in found.items()}

    def look_at(self, entries: Sequence[Entry]) -> None:
        """Finds where ``entries`` lie on a body, which ``wears`` asks of all of them."""
        for entry in entries:
            self._reach(entry)

    def _halves(self, layers: Sequence[Entry]) -> Halves:
        return joined_halves([self._reach(layer).halves for layer in layers])

    def _reach(self, entry: Entry) -> Reach:
        digest = entry.garment.digest
        if digest not in self._reaches:
            body = self._body
            if OWN in entry.garment.manifest:
                body = self.wearer(entry.id.partition(MARK)[0]).body
            self._reaches[digest] = reach_of(entry.garment, body)
        return self._reaches[digest]


def check_own(layer: Entry, name: str) -> None:
    """Refuses (``InputError``) a garment of the clothes that another avatar than ``name`` came in."""
    owner = layer.id.partition(MARK)[0]
    if owner != name:
        cure = "Upload it as a garment to wear it on others."
        raise InputError("avatar", expected=f"{owner}, who came in {layer.id}", got=name, cure=cure)


class _Dressed:
    """An avatar with its stages and the garments that were cut for it, for each of its bodies."""

    def __init__(
        self, wearer: Wearer, stages_on: Callable[[BodyModel], BodyStages], standard: BodyModel, make: Make
    ) -> None:
        self.wearer, self._stages_on, self._standard, self._make = wearer, stages_on, standard, make
        self.stages: dict[str, BodyStages] = {wearer.body.digest: stages_on(wearer.body)}
        self._cut: dict[str, Entry] = {}
        self.own: tuple[Entry, ...] | None = None  # the garments that it came in, once they are read
        self._one = threading.Lock()

    def cut(self, entry: Entry, halves: Halves) -> Entry:
        """``entry`` for this avatar, among garments that lie on these ``halves``."""
        with self._one:
            go_on()
            if halves == (True, False) and self.wearer.over is None:
                self.wearer = replace(self.wearer, over=self._make(upper_body, self.wearer))
            body = self.wearer.body_under(halves)
            shoes_m = self.wearer.shoes_m
            digest = tailored_digest(entry.garment, body, shoes_m)
            if body.digest not in self.stages:
                self.stages[body.digest] = self._stages_on(body)
            if digest not in self._cut:
                made_for = body_of(entry.garment, self.wearer, self._standard)
                same = made_for.digest == body.digest
                garment = (
                    entry.garment if same else self._make(tailored, entry.garment, made_for, body, shoes_m=shoes_m)
                )
                self._cut[digest] = replace(entry, garment=garment, worn=self.stages[body.digest])
            return self._cut[digest]
