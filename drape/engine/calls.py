"""Calls of the engine: flat arrays, records and numbers in, a whole number out.

Arrays that a function writes are given like those that it reads. The engine reads and writes memory by address, so an
array of another type than the function's would be garbage: it is refused here, and so is one that is not contiguous.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from drape.engine.library import Scratch, load
from drape.engine.packer import Record, Recorded, address_of

SUFFIX = {np.dtype(np.float32): "f32", np.dtype(np.float64): "f64"}
_FIRST_BYTES = 1 << 20


class _Room(threading.local):
    """The scratch of a thread: no two calls share it."""

    def __init__(self) -> None:
        self.scratch = Scratch(_FIRST_BYTES)


_ROOM = _Room()


def call(name: str, dtype: Any, *given: Any) -> int:
    """Calls the engine's function ``name`` for numbers of ``dtype``, float32 or float64, with ``given`` arrays, records
    and numbers. Returns the whole number that it returns.

    Raises ``TypeError`` for an array of floats of another type, or that is not contiguous: that is a mistake of ours.
    """
    dtype = np.dtype(dtype)
    return _function(name, dtype)(*(_argument(one, dtype) for one in given))


def call_with_scratch(name: str, dtype: Any, *given: Any) -> int:
    """Does what ``call`` does, for a function that takes scratch memory. The memory is this thread's, and grows until
    it is enough."""
    dtype = np.dtype(dtype)
    function, arguments = _function(name, dtype), [_argument(one, dtype) for one in given]
    while True:
        scratch = _ROOM.scratch
        scratch.used, scratch.overflowed = 0, False
        found = function(*arguments, ctypes.byref(scratch))
        if not scratch.overflowed:
            return found
        _ROOM.scratch = Scratch(2 * scratch.size)


@cache
def _function(name: str, dtype: np.dtype) -> Callable[..., int]:
    symbol = f"drape_{name}_{SUFFIX[dtype]}"
    try:
        function = getattr(load(), symbol)
    except AttributeError:  # what only tests call
        function = getattr(load(tests=True), symbol)
    function.restype = ctypes.c_int64
    return function


def _argument(value: Any, dtype: np.dtype) -> Any:
    if isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and value.dtype != dtype:
            raise TypeError(f"expected {dtype}, got {value.dtype}")
        return ctypes.c_void_p(address_of(value))
    if isinstance(value, Record):
        return ctypes.c_void_p(value.address)
    if isinstance(value, Recorded):
        return ctypes.c_void_p(value.record.address)
    return ctypes.c_int64(int(value)) if isinstance(value, bool | int | np.integer) else ctypes.c_double(value)
