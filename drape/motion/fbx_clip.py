"""Motion clips from FBX files, as Mixamo and motion capture have them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drape.errors import MotionError
from drape.files.fbx import read_animation
from drape.motion.clip import MotionClip, check_frame_count
from drape.motion.joint_names import ancestors
from drape.motion.node_clip import MovingNodes, file_bytes, node_clip


def read_fbx_motion(path: Path, *, clip: str | None = None, most_frames: int | None = None) -> MotionClip:
    """Returns the animation called ``clip`` in an FBX file, its longest if none is named, at the file's rate and
    retargeted to the 24 SMPL joints.

    Raises ``MotionError`` where there is none of a person, and where ufbx is not installed, and ``TooLarge`` for more
    than ``most_frames`` frames.
    """
    path = Path(path)

    def fault(expected: str, got: str, cure: str) -> MotionError:
        return MotionError(path.name, expected=expected, got=got, cure=cure)

    held = read_animation(file_bytes(path), fault, clip=clip)
    check_frame_count(path.name, len(held.moves), most_frames)
    order, parents = _parents_first(held.parents)
    rest = np.tile(np.eye(4), (len(order), 1, 1))
    rest[:, :3] = held.rest[order]
    moves = held.moves[:, order]
    length = np.maximum(np.linalg.norm(moves[:, :, 3:7], axis=2, keepdims=True), 1e-12)
    turns = np.roll(moves[:, :, 3:7] / length, 1, axis=2)
    names = [held.names[node] or f"node {node}" for node in order]
    moving = MovingNodes(names, parents, rest, moves[:, :, :3], turns, moves[:, :, 7:], held.fps)
    return node_clip(moving, name=clip or path.stem)


def _parents_first(parents: list[int]) -> tuple[list[int], list[int]]:
    """The nodes with parents before children, and the place of each one's parent among them."""
    depth = [len(ancestors(parents, node)) for node in range(len(parents))]
    order = np.argsort(depth, kind="stable").tolist()
    place = {node: number for number, node in enumerate(order)}
    return order, [place[parents[node]] if parents[node] >= 0 else -1 for node in order]
