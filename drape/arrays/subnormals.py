"""A context in which a thread takes subnormal numbers for zero.

Weights that fall off like exp(-x^2) end in numbers below the least normal one, and on many processors an operation on
those takes a hundred times as long. Torch and ONNX Runtime have switches of their own, but torch's cannot be read and
put back, and ONNX Runtime's reaches a calling thread only if that thread opened the first session of the process. So
this module sets the control register of the processor, which rules all of them and numpy.
"""

from __future__ import annotations

import ctypes
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

# In C's fenv_t on Linux: where the control register lies, and its bits. "Denormals are zero" and "flush to zero" of
# MXCSR; "flush to zero" of FPCR, which is both.
_REGISTERS = {"x86_64": (28, 1 << 6 | 1 << 15), "aarch64": (0, 1 << 24)}
_REGISTER = _REGISTERS.get(platform.machine()) if sys.platform == "linux" else None
_FENV_BYTES = 64  # more than any fenv_t has


@contextmanager
def flushed() -> Iterator[None]:
    """A context in which this thread, and threads that it starts, compute with zero in place of subnormal numbers.

    It does nothing on systems other than Linux on x86-64 and arm64: there the same work is slower, and differs by
    numbers below 1.2e-38.
    """
    if _REGISTER is None:
        yield
        return
    place, bits = _REGISTER
    library, before = _library(), _environment()
    within = ctypes.create_string_buffer(before.raw, _FENV_BYTES)
    ctypes.c_uint32.from_buffer(within, place).value |= bits
    library.fesetenv(within)
    try:
        yield
    finally:
        library.fesetenv(before)


def _environment() -> ctypes.Array[ctypes.c_char]:
    """This thread's fenv_t."""
    now = ctypes.create_string_buffer(_FENV_BYTES)
    _library().fegetenv(now)
    return now


@cache
def _library() -> ctypes.PyDLL:
    """The C library; calls keep the interpreter's lock, which they would give up for some nanoseconds."""
    return ctypes.PyDLL(None)
