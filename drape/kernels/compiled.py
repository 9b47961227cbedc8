"""How kernels are compiled: once per type, kept on disk beside the source, the same bits on every call.

Products may be contracted with sums, but sums keep their order: a loop that was compiled twice, for arrays that may
overlap and for arrays that do not, would otherwise give other last bits by where its arrays happen to lie, and no time
is lost by it. Comparisons see NaN: "not lower" has to hold for it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable)
FAST = {"contract", "nsz"}
_HERE = Path(__file__).parent
_ROOMS = (_HERE, *(_HERE.parent / name for name in ("live", "graph")))  # where kernels call each other


@cache
def _sources(room: Path) -> str:
    """The hash of the packages of kernels, and of the folder ``room``, whose kernels may call theirs."""
    rooms = _ROOMS if room in _ROOMS else (*_ROOMS, room)
    return hashlib.sha256(b"".join(p.read_bytes() for each in rooms for p in sorted(each.glob("*.py")))).hexdigest()


def part(function: F) -> F:
    """``function`` written into the kernels that call it: a call would count references to all arrays of a tuple."""
    written: Any = njit(inline="always", error_model="numpy", fastmath=FAST)(function)
    return written


def kernel(function: F) -> F:
    """``function`` compiled when it is first called, and stored until a file of these packages or of its own changes.

    numba looks at the date of the kernel's own file alone, so that a changed formula would leave its callers as
    they were; the stamp that it compares is therefore the hash of the packages. It is in the files' names as well: what
    an older version stored names types that may be gone, and could not be read.
    """
    compiled: Any = njit(cache=True, error_model="numpy", nogil=True, fastmath=FAST)(function)
    stored = compiled._cache._cache_file
    sources = _sources(Path(function.__code__.co_filename).parent)
    stored._source_stamp = sources
    name = f"{stored._index_name.removesuffix('.nbi')}.{sources[:12]}"
    stored._index_name, stored._data_name_pattern = f"{name}.nbi", f"{name}.{{number:d}}.nbc"
    stored._index_path = str(Path(stored._cache_path, stored._index_name))
    return compiled
