"""Motion files of every supported format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drape.errors import MotionError
from drape.motion.amass import read_amass
from drape.motion.bvh import read_bvh
from drape.motion.clip import MotionClip

_READERS: dict[str, Callable[[Path], MotionClip]] = {".npz": read_amass, ".bvh": read_bvh}
MOTION_SUFFIXES = tuple(_READERS)


def read_motion(path: Path) -> MotionClip:
    """Reads a clip from an npz file (AMASS's form or our own) or a BVH file.

    The clip has 24 joints, y up, in metres. Raises ``MotionError`` for a file that is neither or cannot be read.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise MotionError(
            path.name,
            expected="a motion file: AMASS .npz or .bvh",
            got=f"suffix {path.suffix!r}",
            cure="Convert the motion to one of these formats.",
        )
    return reader(path)
