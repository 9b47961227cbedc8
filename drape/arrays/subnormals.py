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
from contextlib import ContextDecorator
from functools import cache

# In C's fenv_t on Linux: which word the control register is, and its bits. "Denormals are zero" and "flush to zero" of
# MXCSR; "flush to zero" of FPCR, which is both.
_REGISTERS = {"x86_64": (7, 1 << 6 | 1 << 15), "aarch64": (0, 1 << 24)}
_REGISTER = _REGISTERS.get(platform.machine()) if sys.platform == "linux" else None
_Environment = ctypes.c_uint32 * 16  # longer than any fenv_t


class _Flushed(ContextDecorator):
    """``flushed``; by hand, since a frame enters it several times and a generator takes ten times as long."""

    def __enter__(self) -> None:
        if _REGISTER is None:
            return
        place, bits = _REGISTER
        self._library, self._environment = _library(), _Environment()
        self._library.fegetenv(self._environment)
        self._before = self._environment[place]
        self._environment[place] = self._before | bits
        self._library.fesetenv(self._environment)

    def __exit__(self, *_: object) -> None:
        if _REGISTER is not None:
            self._environment[_REGISTER[0]] = self._before
            self._library.fesetenv(self._environment)

    def _recreate_cm(self) -> _Flushed:
        """Another context for each call of a function that this decorates: calls may be nested or in threads."""
        return _Flushed()


def flushed() -> _Flushed:
    """Returns a context, which is also a decorator, in which this thread, and threads that it starts, compute with zero
    in place of subnormal numbers.

    It does nothing on systems other than Linux on x86-64 and arm64: there the same work is slower, and differs by
    numbers below 1.2e-38.
    """
    return _Flushed()


@cache
def _library() -> ctypes.PyDLL:
    """The C library; calls keep the interpreter's lock, which they would give up for some nanoseconds."""
    return ctypes.PyDLL(None)
