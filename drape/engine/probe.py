"""What the processor has: the one part of the engine that every processor runs, and that needs no NumPy."""

from __future__ import annotations

import ctypes
import platform
from pathlib import Path

from drape.engine.build import LIBRARIES
from drape.errors import ArtifactError
from drape.folders import CLONE

SUFFIX = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
CURE = "Build it: python -m drape.engine.build." if CLONE else "Install the wheel again, with --force-reinstall."


def processor_level(folder: Path = LIBRARIES) -> tuple[int, bool]:
    """Returns the level of x86-64 that this processor has (0 on another one), and whether it multiplies tiles of
    bfloat16 (AMX).

    Refuses (``ArtifactError``) a ``folder`` without the library that asks the processor.
    """
    probe = folder / f"probe{SUFFIX}"
    if not probe.is_file():
        raise ArtifactError("engine", expected=f"the file {probe.name}", got="none", cure=CURE)
    found = ctypes.CDLL(str(probe)).drape_processor()
    return found % 16, found >= 16
