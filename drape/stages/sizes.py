"""The sizes of garments, made of the garments' tables when they are first worn, and kept."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drape.body.measures import measures
from drape.body.model import BodyModel
from drape.errors import InputError, NotFound
from drape.garment.cache import Garment
from drape.garment.size_chart import Advice, advice, check_size, cut_for, deciding
from drape.garment.sizes import SizeTable, load_table, sized, sized_digest, table_path
from drape.stages.scene import Entry, Outfit, Scene
from drape.stages.stage import Make, call_here
from drape.wanted import go_on

SizeChoice = str | Sequence[str | None] | None  # one size for all layers, or one for each


class Sizes:
    """The garments that come in sizes: a table of the sizes of each, and the garments that were made of the tables so
    far."""

    def __init__(self, body: BodyModel, folder: Path, entries: Iterable[Entry], make: Make = call_here) -> None:
        """Reads the tables beside the garments in ``folder``, which were sewn on ``body``; raises ``ArtifactError``."""
        self._body, self._make = body, make
        paths = {entry.garment.digest: (table_path(folder, entry.garment), entry) for entry in entries}
        self._tables: dict[str, SizeTable] = {
            digest: load_table(path, entry.garment) for digest, (path, entry) in paths.items() if path.is_file()
        }
        self._standard = measures(body)._asdict()
        self._sized: dict[str, Garment] = {}
        self._making = threading.Lock()

    def measures(self, entry: Entry) -> Mapping[str, Mapping[str, float]]:
        """Returns the measures [m] of the garment ``entry`` by size, such as "M", and then by name, such as "chest_m";
        empty if it has one size only."""
        table = self._tables.get(entry.garment.digest)
        return {} if table is None else table.measures

    def cut_for(self, entry: Entry, size: str) -> dict[str, tuple[float, float]]:
        """Returns by the name of each measure that decides the size, such as "chest_m", the least and the greatest
        girth [m] of the bodies that ``size`` of the garment ``entry`` is cut for."""
        return cut_for(size, {name: self._standard[name] for name in deciding(self.measures(entry)["M"])})

    def advice(self, entry: Entry, shape: np.ndarray) -> Advice:
        """Returns the size of ``entry`` that fits the body in ``shape`` (S,), and why. Refuses (``NotFound``) a garment
        that has one size only."""
        own = self.measures(entry)
        if not own:
            raise _one_size(entry, "one to be found")
        return advice(measures(self._body, shape)._asdict(), self._standard, deciding(own["M"]))

    def wear(self, scene: Scene, size: SizeChoice) -> Scene:
        """Returns ``scene`` with its garments in ``size``: one size for all layers, or a list with one for each, where
        None is M.

        A size takes seconds to make when it is first worn. Refuses (``NotFound``) a size that the garment does not
        have, naming the nearest, and (``InputError``) a list of another length.
        """
        layers = scene.layers
        sizes = [size] * len(layers) if size is None or isinstance(size, str) else list(size)
        if len(sizes) != len(layers):
            expected, cure = f"one for all, or {len(layers)}: one for each garment", "Put null where a garment is in M."
            raise InputError("size", expected=expected, got=str(len(sizes)), cure=cure)
        worn = tuple(self._of(layer, own) for layer, own in zip(layers, sizes, strict=True))
        return Outfit(worn) if isinstance(scene, Outfit) else worn[0]

    def _of(self, entry: Entry, size: str | None) -> Entry:
        if size is None:
            return entry
        table = self._tables.get(entry.garment.digest)
        if table is None:
            raise _one_size(entry, size[:40])
        check_size(size, entry.id)
        if size == "M":
            return entry
        digest = sized_digest(entry.garment, table, size)
        with self._making:
            go_on()
            if digest not in self._sized:
                self._sized[digest] = self._make(sized, entry.garment, self._body, table, size)
        return replace(entry, garment=self._sized[digest])


def _one_size(entry: Entry, got: str) -> NotFound:
    cure = "Leave size out, or choose a garment that comes in sizes."
    return NotFound("size", expected=f"none: {entry.id} comes in one", got=got, cure=cure)
