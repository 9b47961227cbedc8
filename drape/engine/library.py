"""The engine's library: which file fits this processor, and whether it matches the Python beside it."""

from __future__ import annotations

import ctypes
import os
import platform
from functools import cache
from pathlib import Path

import numpy as np

from drape.engine.build import LIBRARIES
from drape.engine.probe import CURE, SUFFIX, processor_level
from drape.engine.records import HASH
from drape.errors import ArtifactError

LEVELS = {"v2": 2, "v3": 3, "v4": 4}
LANES = 16  # numbers of a row
_PERMIT = (158, 0x1023, 18)  # the system's call for the state of tiles: arch_prctl, ARCH_REQ_XCOMP_PERM, XTILEDATA


class Scratch(ctypes.Structure):
    """``size`` bytes of scratch memory as a function of the engine takes it (``source/arrays.hpp``). A call sets
    ``used`` to the bytes that it took, and ``overflowed`` where there were too few."""

    _fields_ = [
        ("begin", ctypes.c_void_p),
        ("size", ctypes.c_int64),
        ("used", ctypes.c_int64),
        ("overflowed", ctypes.c_bool),
    ]

    def __init__(self, size: int) -> None:
        self._memory = np.empty(size, np.uint8)
        super().__init__(self._memory.ctypes.data, size, 0, False)


def library_name(level: int, forced: str | None = None) -> str:
    """Returns the name, without suffix, of the library's file for a processor of this ``level`` of x86-64 (0: arm64).
    ``forced``, such as "v3", is the level that ``DRAPE_ISA`` names in its place.

    Refuses (``ArtifactError``) a processor that no library is made for, and a level above its own.
    """
    if level == 0:
        return "engine-arm64"
    wanted = LEVELS.get(forced or f"v{level}", 0)
    if not 2 <= wanted <= level:
        raise ArtifactError(
            "processor",
            expected="x86-64 of level v2, v3 or v4, and no higher DRAPE_ISA than that",
            got=f"v{level}" + (f", DRAPE_ISA {forced}" if forced else ""),
            cure="Leave DRAPE_ISA out, or use a processor of 2009 or later.",
        )
    return f"engine-x86-64-v{wanted}"


@cache
def load(*, tests: bool = False, folder: Path = LIBRARIES) -> ctypes.CDLL:
    """Returns the opened library in ``folder`` for this processor, or with ``tests`` the one that also has what only
    tests call: kernels in float64, parts of kernels.

    Refuses (``ArtifactError``) what ``library_name`` does, a missing file, and one whose records are laid out otherwise
    than those of ``records.py``. Other changes of its sources are not noticed here.
    """
    name = library_name(processor_level(folder)[0], os.environ.get("DRAPE_ISA") or None)
    path = folder / f"{name}{'-tests' if tests else ''}{SUFFIX}"
    if not path.is_file():
        raise ArtifactError("engine", expected=f"the file {path.name}", got="none", cure=CURE)
    library = ctypes.CDLL(str(path))
    library.drape_records_hash.restype = ctypes.c_uint64
    if library.drape_records_hash() != HASH:
        raise ArtifactError("engine", expected="that of this version", got=f"another one: {path.name}", cure=CURE)
    return library


@cache
def has_tiles() -> bool:
    """Returns whether layers of the network may use the processor's tiles (AMX): the processor and its library have
    them, and Linux lets this process keep their state."""
    level, tiles = processor_level()
    if not tiles or library_name(level, os.environ.get("DRAPE_ISA") or None) != library_name(4):
        return False
    return platform.system() == "Linux" and ctypes.CDLL(None).syscall(*map(ctypes.c_long, _PERMIT)) == 0


def empty_points(count: int, dtype: type[np.floating] | np.dtype) -> np.ndarray:
    """Returns zeros (``count``, 3) for points. Behind the last one the memory has room for one number more, since the
    engine reads points four numbers at a time."""
    return np.zeros(3 * count + 1, dtype)[: 3 * count].reshape(count, 3)
