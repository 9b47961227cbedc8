"""Drapes garments on moving bodies: patches carry a garment, a network moves them, and a solver grows folds.

``load`` opens the shipped model and body; ``drape.library`` has an example. The names in ``__all__`` are public; all
others may change. The import loads no torch, and it loads onnxruntime only if a model needs it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drape.distilling import distil
    from drape.errors import DrapeError
    from drape.garment.cache import Garment
    from drape.garment.intake import intake
    from drape.library import Drape, Frame, Worn, load
    from drape.motion.clip import MotionClip
    from drape.motion.readers import read_motion
    from drape.scenes import usd, vat
    from drape.wire.options import DrapeOptions

__version__ = "0.1.0"
__all__ = [
    "Drape", "DrapeError", "DrapeOptions", "Frame", "Garment", "MotionClip", "Worn", "distil", "intake", "load",
    "read_motion", "usd", "vat",
]  # fmt: skip
# They are imported when they are asked for: most modules of the core need few of these.
_HOMES = {
    "drape.distilling": ("distil",),
    "drape.errors": ("DrapeError",),
    "drape.garment.cache": ("Garment",),
    "drape.garment.intake": ("intake",),
    "drape.library": ("Drape", "Frame", "Worn", "load"),
    "drape.motion.clip": ("MotionClip",),
    "drape.motion.readers": ("read_motion",),
    "drape.scenes": ("usd", "vat"),
    "drape.wire.options": ("DrapeOptions",),
}


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
