"""Motion files of every supported format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drape.errors import MotionError
from drape.motion.amass import read_amass
from drape.motion.asf_amc import read_amc
from drape.motion.bvh import read_bvh
from drape.motion.clip import MotionClip

_READERS: dict[str, Callable[[Path], MotionClip]] = {".npz": read_amass, ".bvh": read_bvh, ".amc": read_amc}
MOTION_SUFFIXES = tuple(_READERS)


def read_motion(path: Path) -> MotionClip:
    """The clip of an AMASS or product npz, a BVH, or an AMC with its ASF beside it: 24 joints, y up, metres."""
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise MotionError(
            path.name,
            expected="a motion file: AMASS .npz, .bvh, or .amc with its .asf beside it",
            got=f"suffix {path.suffix!r}",
            cure="Convert the motion to one of these formats."
            if path.suffix.lower() != ".asf"
            else "Pass the .amc file instead.",
        )
    return reader(path)
