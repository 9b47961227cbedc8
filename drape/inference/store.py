"""Constants of garments as the packed graph reads them. Once a call has asked for several garments, each array lies in
one piece, and the arrays of a garment are views of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drape.errors import NotFound
from drape.garment.cache import Garment
from drape.graph.packing import PackedGarment, Place

FIRST = "patch_first"  # the one array of a garment's constants that depends on its fabric


@dataclass(eq=False)
class _Stored:
    """A garment and its constants. ``of``: the key of the same garment in its own fabric, None where this is that
    one."""

    garment: Garment
    packed: PackedGarment
    of: str | None = None


class Store:
    """The garments of a ``Packer`` and their constants, by their keys."""

    def __init__(self) -> None:
        self._garments: dict[str, _Stored] = {}
        self._places: dict[str, Place] = {}
        self._arrays: dict[str, np.ndarray] = {}

    def __contains__(self, key: str) -> bool:
        return key in self._garments

    def add(self, key: str, garment: Garment, packed: PackedGarment) -> None:
        """Stores ``garment`` and its constants ``packed`` under ``key``, and forgets what was there with its
        fabrics."""
        self._undress(key)
        self._garments[key] = _Stored(garment, packed)
        self._arrays = {}

    def garment(self, key: str) -> Garment:
        """Returns the garment stored under ``key``; refuses (``NotFound``) one that is not in store."""
        self.packed(key)
        return self._garments[key].garment

    def dress(self, key: str, name: str, patch_first: np.ndarray) -> None:
        """Stores the garment ``key`` once more, under ``name``: in another fabric, for which ``patch_first`` (K, n) is
        the encoder's output. Both share their tiles."""
        packed = self.packed(key)
        packed = replace(packed, stored=packed.stored | {FIRST: patch_first})
        self._garments[name] = _Stored(self._garments[key].garment, packed, key)
        self._arrays = {}

    def remove(self, key: str) -> None:
        """Forgets the garment ``key`` with all its fabrics. A name that ``dress`` stored forgets that fabric alone."""
        self.packed(key)
        self._undress(key)
        del self._garments[key]
        self._arrays = {}

    def _undress(self, key: str) -> None:
        for name in [name for name, stored in self._garments.items() if stored.of == key]:
            del self._garments[name]

    def packed(self, key: str) -> PackedGarment:
        """Returns the constants of the garment ``key``; refuses (``NotFound``) one that is not in store."""
        if key not in self._garments:
            raise NotFound(
                "garment", expected=", ".join(self._garments) or "one in store", got=key, cure="Add the garment first."
            )
        return self._garments[key].packed

    def place(self, key: str) -> Place:
        """Returns the rows of ``arrays`` at which the patches and the tiles of the garment ``key`` begin."""
        self.arrays()
        return self._places[key]

    def arrays(self) -> dict[str, np.ndarray]:
        """Returns the stored inputs of the packed graph by name: rows of all garments, one garment after the other.

        After a change of the garments they are laid out anew, in a millisecond for each garment.
        """
        if not self._arrays:
            self._lay_out()
        return self._arrays

    @property
    def bytes(self) -> int:
        """Returns the size of all constants in store [bytes]."""
        whole = sum(stored.packed.bytes for stored in self._garments.values() if stored.of is None)
        return whole + sum(stored.packed.stored[FIRST].nbytes for stored in self._garments.values() if stored.of)

    def _lay_out(self) -> None:
        every = list(self._garments.values())
        whole = [stored for stored in every if stored.of is None]
        names = every[0].packed.stored if every else ()
        self._arrays = {
            name: np.concatenate([stored.packed.stored[name] for stored in (whole if _of_tiles(name) else every)])
            for name in names
        }
        patch = tile = 0
        for key, stored in self._garments.items():
            packed = stored.packed
            first = tile if stored.of is None else self._places[stored.of].tile
            self._places[key] = Place(patch, first)
            for name, array in self._arrays.items():
                start = first if _of_tiles(name) else patch
                packed.stored[name] = array[start : start + len(packed.stored[name])]
            patch += packed.patch_count
            tile += packed.tile_count if stored.of is None else 0


def _of_tiles(name: str) -> bool:
    """Whether rows of the stored array ``name`` are tiles, not patches."""
    return name.startswith("tile")
