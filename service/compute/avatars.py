"""The avatars in service: characters of users, with the stages and the garments that are cut for each."""

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

FOLDER = ".avatars"  # in the folder of garments, whose lists pass over names with a dot
log = logging.getLogger("drape.service")
# The most avatars whose stages and garments stay in memory, at 20 to 40 MB a garment. Others are made again when used.
MOST_WORN = 4


class OwnFiles(NamedTuple):
    """The own clothes of a character. ``caches`` are the paths of the files of the garments made from them, the
    innermost first. ``stiff`` has the clothes that did not become garments: the names of their parts as keys, the
    reasons as values."""

    caches: Sequence[Path]
    stiff: dict[str, str]


@dataclass(frozen=True)
class AvatarRecord:
    """The JSON file beside an avatar's other files: its id, its facts (``told``) and the key that sent it."""

    id: str
    told: AvatarFacts
    owner: str | None


@dataclass(frozen=True)
class AvatarEntry:
    """An avatar in service. ``path`` is the file of its wearer (``load_wearer``), ``source`` the file that the user
    sent, ``owner`` the key that sent it, None where no keys are asked for."""

    id: str
    path: Path
    source: Path
    facts: AvatarFacts
    owner: str | None = None

    @cached_property
    def document(self) -> bytes:
        """The JSON text of its ``AvatarInfo``. It is computed once, because a character may have thousands of nodes."""
        return AvatarInfo(id=self.id, **self.facts.model_dump()).model_dump_json().encode()

    def own_files(self) -> list[Path]:
        """Returns the paths of the caches of the garments made from its own clothes."""
        return sorted(self.path.parent.glob(f"{self.id}{MARK}*.npz"))

    def wearing(self, garment: Garment) -> Entry:
        """Returns the entry of ``garment``, one of those made from its own clothes."""
        name = own_id(self.id, garment)
        return Entry(name, garment, "user", self.path.with_name(f"{name}.npz"), self.owner)

    def seen_by(self, viewer: str | None) -> bool:
        """Whether the key ``viewer`` may see it: it has no owner, or that one."""
        return self.owner is None or self.owner == viewer


class Avatars:
    """The avatars in service by their ids. Each has a body of its own. The stages that drape on that body are made when
    the avatar first wears a garment.

    ``body`` is the standard body. ``stages_on(body)`` makes the stages for another body. ``make(function, *arguments)``
    calls a function that takes long.
    """

    def __init__(
        self, body: BodyModel, settings: Settings, stages_on: Callable[[BodyModel], BodyStages], make: Make = call_here
    ) -> None:
        self._body, self._stages_on, self._make = body, stages_on, make
        self._root, self._settings = settings.garments_dir / FOLDER, settings
        self._entries: dict[str, AvatarEntry] = {}
        self._worn: OrderedDict[str, _Dressed] = OrderedDict()
        self._reaches: dict[str, Reach] = {}
        self._lock = threading.Lock()
        self._seen: dict[Path, int] = {}  # when each file of an avatar's facts was written [ns since 1970]
        self.follow()

    def follow(self) -> None:
        """Puts avatars in service that are new or changed in the folder of avatars, and takes those out of service
        whose files are gone. Other services may share the folder."""
        present = garment_files.list_avatar_facts(self._root)
        for about, written_ns in present.items():
            if self._seen.get(about) != written_ns:
                self._read(about)
        for entry in [entry for entry in self._entries.values() if entry.path.with_suffix(".json") not in present]:
            if not entry.path.exists():  # else it came after the list was read
                self._entries.pop(entry.id, None)
                self._undress(entry.id)
        self._seen = present

    def _read(self, about: Path) -> None:
        """Puts the avatar with the facts in ``about`` in service. A file that was removed meanwhile is passed over."""
        record = read_record(AvatarRecord, about)
        if record is None:
            return
        files = about.with_suffix(".npz"), about.with_suffix(".glb")
        entry = AvatarEntry(record.id, *files, record.told, record.owner)
        if entry.path.is_file() and entry != self._entries.get(entry.id):
            self._entries[entry.id] = entry
            self._undress(entry.id)

    @property
    def worn(self) -> tuple[BodyStages, ...]:
        """The stages of all bodies of the avatars that are in memory."""
        return tuple(stages for dressed in list(self._worn.values()) for stages in list(dressed.stages.values()))

    def visible(self, viewer: str | None) -> list[AvatarEntry]:
        """Returns the entries of the avatars that the key ``viewer`` may see."""
        return [entry for entry in list(self._entries.values()) if entry.seen_by(viewer)]

    def get(self, name: str, viewer: str | None = None) -> AvatarEntry:
        """Returns the entry of the avatar with the id ``name``. Refuses (``NotFound``) an unknown one, and one that the
        key ``viewer`` may not see."""
        entry = self._entries.get(name)
        if entry is None or not entry.seen_by(viewer):
            ids = sorted(other.id for other in self.visible(viewer))
            known = ", ".join(ids[:20]) or "none yet"
            cure = did_you_mean(name, ids, "GET /avatars lists them; POST /avatars adds one.")
            raise NotFound("avatar", expected=f"one of: {known}", got=name[:120], cure=cure)
        return entry

    def add(self, file: Path, source: Path, owner: str | None, own: OwnFiles | None = None) -> AvatarEntry:
        """Moves files of an avatar into the folder of the key ``owner``, puts it in service and returns its entry.

        ``file`` is that of its wearer, ``source`` the one that the user sent, ``own`` its own clothes, None if they
        were not to become garments.
        """
        wearer = load_wearer(file, self._body)
        name = wearer.name
        if owner is not None:
            name = f"{name}-{hashlib.sha256(f'{owner} {wearer.digest}'.encode()).hexdigest()[:8]}"
        elif (namesake := self._entries.get(name)) is not None and namesake.facts.digest != wearer.digest:
            name = f"{name}-{wearer.digest[:8]}"
        return self._store(name, file, source, owner, wearer, own)

    def replace(self, entry: AvatarEntry, file: Path, own: OwnFiles | None = None) -> AvatarEntry:
        """Replaces the wearer of ``entry`` by that in ``file``, whose joints or parts were corrected, and its garments
        by ``own``. Returns the new entry, with the same id."""
        wearer = load_wearer(file, self._body)
        self._undress(entry.id)
        return self._store(entry.id, file, entry.source, entry.owner, wearer, own)

    def _store(
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
        if own is not None:  # it will wear them soon, so they stay in memory
            with self._lock:
                self._dress_up(name, wearer).own = tuple(map(entry.wearing, garments))
        return entry

    def remove(self, entry: AvatarEntry) -> None:
        """Deletes the files of ``entry`` and takes it out of service."""
        self._entries.pop(entry.id, None)
        for path in (entry.path.with_suffix(".json"), entry.path, entry.source, *entry.own_files()):
            path.unlink(missing_ok=True)
        self._undress(entry.id)

    def _undress(self, name: str) -> None:
        with self._lock:
            self._worn.pop(name, None)

    # --- garments that an avatar wears ---

    def wearer(self, name: str) -> Wearer:
        """Returns the body, rig and surface of the avatar with the id ``name``, read from its file unless they are in
        memory. Any thread may call it. Refuses (``NotFound``) an unknown avatar, and one whose file cannot be read."""
        return self._dressed(name).wearer

    def _dressed(self, name: str) -> _Dressed:
        with self._lock:
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
        """Returns the wearer in the file of ``entry``, which is taken out of service if that cannot be read."""
        try:
            return load_wearer(entry.path, self._body)
        except ArtifactError as error:
            log.warning("avatar set aside: %s", error)
            self._entries.pop(entry.id, None)
            raise NotFound(error.name, expected=error.expected, got=error.got, cure=error.cure) from error

    def _own(self, path: Path, wearer: Wearer) -> Garment:
        """Returns the checked garment of the cache ``path``, made from the own clothes of ``wearer``."""
        garment = load_garment(path)
        check_garment(garment, body_of(garment, wearer, self._body), max_vertices=self._settings.max_vertices)
        return garment

    def own(self, name: str) -> tuple[Entry, ...]:
        """Returns the entries of the garments made from the own clothes of the avatar ``name``, the innermost first.
        Any thread may call it."""
        entry, dressed = self._entries.get(name) or self.get(name), self._dressed(name)
        if dressed.own is None:
            paths = [entry.path.with_name(f"{own.garment}.npz") for own in entry.facts.alive or ()]
            dressed.own = tuple(entry.wearing(self._own(path, dressed.wearer)) for path in paths)
        return dressed.own

    def own_garment(self, garment_id: str, viewer: str | None) -> Entry | None:
        """Returns the entry of the garment ``garment_id`` if it was made from the own clothes of an avatar that the key
        ``viewer`` may see; otherwise None."""
        name, mark, _ = garment_id.partition(MARK)
        entry = self._entries.get(name) if mark else None
        if entry is None or not entry.seen_by(viewer):
            return None
        return next((own for own in self.own(name) if own.id == garment_id), None)

    def with_own(self, name: str, scene: Scene | None) -> Scene:
        """Returns ``scene`` with the avatar's own garments below and over it, but for those that garments of ``scene``
        replace, as they lie on the same half of the body. None is a scene without garments.

        Refuses (``TooLarge``) more layers than ``DRAPE_MAX_LAYERS``, and (``NotFound``) a scene without any garment.
        """
        layers: tuple[Entry, ...] = () if scene is None else scene.layers
        own = {entry.garment.digest: entry for entry in self.own(name) if entry not in layers}
        sides = split_own([entry.garment for entry in own.values()], self._halves(layers))
        below, over = ([own[garment.digest] for garment in side] for side in sides)
        worn = [*below, *layers, *over]
        limit = self._settings.max_layers
        if len(worn) > limit:
            cure = "Name fewer garments, or leave alive out."
            raise TooLarge("garments", expected=f"at most {limit} layers", got=str(len(worn)), cure=cure)
        if not worn:
            cure = "Upload the character with alive=true; `stiff` of GET /avatars/ID says what did not become cloth."
            raise NotFound("alive", expected="an avatar with garments of its own", got="none", cure=cure)
        return Outfit(tuple(worn)) if len(worn) > 1 or isinstance(scene, Outfit) else worn[0]

    def dress(self, name: str, scene: Scene) -> Scene:
        """Returns ``scene`` with each garment cut for the avatar ``name``. Each that it has not worn yet takes seconds.

        Refuses (``BodyError``, ``InputError``) a garment that it cannot wear, as ``why_not`` and ``check_own`` say.
        """
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
        """Returns for each of ``entries``, by its id, the sentence why the avatar ``name`` cannot wear it; None if it
        can. ``dress`` refuses the same garments."""
        body = self.wearer(name).body
        refusals = {entry.id: why_not(body, self._reach(entry), garment=entry.id) for entry in entries}
        return {key: None if refusal is None else str(refusal) for key, refusal in refusals.items()}

    def look_at(self, entries: Sequence[Entry]) -> None:
        """Computes which parts of a body ``entries`` reach and keeps that in memory, where ``wears`` reads it."""
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
    """Refuses (``InputError``) ``layer``, a garment made from an avatar's own clothes, for another avatar ``name``."""
    owner = layer.id.partition(MARK)[0]
    if owner != name:
        cure = "Upload it as a garment to wear it on others."
        raise InputError("avatar", expected=f"{owner}, who came in {layer.id}", got=name, cure=cure)


class _Dressed:
    """An avatar in memory: its wearer, the stages of each of its bodies by digest, and the garments cut for it."""

    def __init__(
        self, wearer: Wearer, stages_on: Callable[[BodyModel], BodyStages], standard: BodyModel, make: Make
    ) -> None:
        self.wearer, self._stages_on, self._standard, self._make = wearer, stages_on, standard, make
        self.stages: dict[str, BodyStages] = {wearer.body.digest: stages_on(wearer.body)}
        self._cut: dict[str, Entry] = {}
        self.own: tuple[Entry, ...] | None = None  # the garments of its own clothes, once they are read
        self._lock = threading.Lock()

    def cut(self, entry: Entry, halves: Halves) -> Entry:
        """Returns ``entry`` cut for this avatar. All garments of the scene together lie on ``halves`` of the body."""
        with self._lock:
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
