"""How kernels are compiled: once per type, stored on disk beside the source, with the same bits on every call.

A product may be contracted with a sum, but sums keep their order. numba compiles one loop twice, for arrays that may
overlap and for arrays that do not: if sums could be reordered, the last bits of a result would depend on where its
arrays lie in memory. Keeping the order costs no time. Comparisons see NaN, so that "not lower" holds for it.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit
from numba.core.caching import IndexDataCacheFile

F = TypeVar("F", bound=Callable)
FAST = {"contract", "nsz"}
_HERE = Path(__file__).parent
_PACKAGES = (_HERE, *(_HERE.parent / name for name in ("live", "graph", "network")))  # their kernels call each other


@cache
def _sources(package: Path) -> str:
    """The hash of the packages of kernels and of ``package``, whose kernels may call theirs."""
    packages = _PACKAGES if package in _PACKAGES else (*_PACKAGES, package)
    return hashlib.sha256(b"".join(p.read_bytes() for each in packages for p in sorted(each.glob("*.py")))).hexdigest()


def part(function: F) -> F:
    """``function`` inlined into the kernels that call it. A call would count references to every array of a tuple."""
    inlined: Any = njit(inline="always", error_model="numpy", fastmath=FAST)(function)
    return inlined


def kernel(function: F) -> F:
    """``function`` compiled at its first call, and stored until a file of these packages or of its own changes.

    numba compares the date of the kernel's own file alone, so a changed formula would leave its callers as they were.
    Here it compares the hash of the packages. The hash is in the files' names as well: a file that an older version
    stored may name types that are gone, and reading it would fail. Both go through two private attributes of numba,
    ``_cache`` and ``_cache_file`` (docs/decisions/0011-numba.md).
    """
    compiled: Any = njit(cache=True, error_model="numpy", nogil=True, fastmath=FAST)(function)
    code, sources = function.__code__, _sources(Path(function.__code__.co_filename).parent)
    name = f"{Path(code.co_filename).stem}.{function.__name__}-{code.co_firstlineno}.{sys.implementation.cache_tag}"
    cached = compiled._cache
    cached._cache_file = IndexDataCacheFile(cached.cache_path, f"{name}.{sources[:12]}", sources)
    return compiled
