"""Motion files of every supported format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drape.errors import MotionError
from drape.motion.amass import read_amass
from drape.motion.bvh import read_bvh
from drape.motion.clip import MotionClip
from drape.motion.fbx_clip import read_fbx_motion
from drape.motion.gltf_clip import read_gltf_motion

_OF_SCENES = {**dict.fromkeys((".glb", ".gltf", ".vrm", ".vrma"), read_gltf_motion), ".fbx": read_fbx_motion}
_READERS: dict[str, Callable[..., MotionClip]] = {".npz": read_amass, ".bvh": read_bvh}
MOTION_SUFFIXES = (*_READERS, *_OF_SCENES)


def read_motion(path: Path, *, clip: str | None = None, most_frames: int | None = None) -> MotionClip:
    """Returns the clip in an npz file (AMASS's form or our own), BVH, GLB, glTF, VRM, VRMA or FBX, with 24 joints, y
    up, in metres.

    Of a scene with several animations it is the one called ``clip``, or the longest. Raises ``MotionError`` for a file
    of another kind or one that cannot be read, and ``TooLarge`` for more than ``most_frames`` frames.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _OF_SCENES:
        return _OF_SCENES[suffix](path, clip=clip, most_frames=most_frames)
    reader = _READERS.get(suffix)
    if reader is None:
        raise MotionError(
            path.name,
            expected=f"a motion file: {', '.join(MOTION_SUFFIXES)}",
            got=f"suffix {path.suffix!r}",
            cure="Convert the motion to one of these formats.",
        )
    if clip is not None:
        raise MotionError(
            f"{path.name}: clip", expected="none", got=repr(clip)[:60], cure="It has no clips to choose from."
        )
    return reader(path, most_frames=most_frames)
