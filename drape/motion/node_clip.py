"""The clip of a scene's nodes that move, as glTF and FBX have them.

A node has axes of its own at rest. What turns it in a frame is its world rotation W(t) after the inverse of W at rest,
as if all axes were the world's at rest; then a scene is a skeleton like that of a BVH file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drape.errors import MotionError
from drape.files.gltf_nodes import world_matrices
from drape.geometry.rotations import quaternion_to_matrix
from drape.motion.clip import MotionClip
from drape.motion.retarget import SourceSkeleton, retarget

MOST_MATRICES = 4_000_000  # Frames times nodes.
STILL_SHARE = 1e-4  # A node that moves from its parent by less than this share of the skeleton's extent does not move.


@dataclass(frozen=True, eq=False)
class MovingNodes:
    """J nodes of a scene, parents before children, in F frames. Lengths are in the unit of the file.

    ``parents`` are indices, -1 for none. ``rest`` (J, 4, 4) are the world transforms at rest. ``translations``
    (F, J, 3), unit ``quaternions`` (F, J, 4) wxyz and ``scales`` (F, J, 3) are relative to the parent.
    """

    names: Sequence[str]
    parents: Sequence[int]
    rest: np.ndarray
    translations: np.ndarray
    quaternions: np.ndarray
    scales: np.ndarray
    fps: float


def file_bytes(path: Path) -> bytes:
    """Returns the bytes of a motion file. Raises ``MotionError`` where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        cure = "Check the path."
        raise MotionError(path.name, expected="a readable file", got=error.strerror or "an error", cure=cure) from error


def check_node_count(frames: int, nodes: int, label: str) -> None:
    """Raises ``MotionError``, which names ``label``, for a motion with more matrices (frames times nodes) than are
    read."""
    if frames * nodes > MOST_MATRICES:
        raise MotionError(
            f"{label}: animation",
            expected=f"at most {MOST_MATRICES // nodes:,} frames of {nodes} nodes",
            got=f"{frames:,}",
            cure="Cut it, or export at a lower rate.",
        )


def node_clip(moving: MovingNodes, *, name: str) -> MotionClip:
    """Returns the clip called ``name`` of the nodes ``moving``, retargeted to the 24 SMPL joints. Raises
    ``MotionError`` where the nodes are no person's."""
    frames, count = moving.quaternions.shape[:2]
    check_node_count(frames, count, name)
    world = world_transforms(moving.translations, moving.quaternions, moving.scales, moving.parents)
    rest_turn, rest_place = nearest_rotations(moving.rest[:, :3, :3]), moving.rest[:, :3, 3]
    # A node above all, so that several roots are one skeleton.
    parents = (-1, *(int(parent) + 1 for parent in moving.parents))
    relative = np.empty((frames, count + 1, 3, 3))
    relative[:, 0] = np.eye(3)
    relative[:, 1:] = nearest_rotations(world[..., :3, :3]) @ np.swapaxes(rest_turn, -1, -2)
    place = np.concatenate([np.zeros((frames, 1, 3)), world[..., :3, 3]], axis=1)
    rest = np.concatenate([np.zeros((1, 3)), rest_place])
    above = np.maximum(parents, 0)
    ways = np.einsum("fjba,fjb->fja", relative[:, above], place - place[:, above])
    offsets = rest - rest[above]
    moved = np.abs(ways - offsets).max(axis=(0, 2)) > STILL_SHARE * float(np.ptp(rest, axis=0).max())
    skeleton = SourceSkeleton(("", *moving.names), parents, offsets)
    moves = {0: np.zeros((frames, 3)), **{joint: ways[:, joint] for joint in np.flatnonzero(moved)}}
    return retarget(skeleton, relative, moves, fps=moving.fps, name=name, any_size=True)


def world_transforms(moves: np.ndarray, turns: np.ndarray, scales: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """Returns the world transforms (F, N, 4, 4) of nodes with the local translations ``moves`` (F, N, 3), rotations
    ``turns`` (F, N, 4), unit quaternions wxyz, and ``scales`` (N, 3) or (F, N, 3). ``parents`` come before their
    children."""
    local = np.zeros((*moves.shape[:2], 4, 4))
    local[..., :3, :3] = quaternion_to_matrix(turns) * scales[..., None, :]
    local[..., :3, 3], local[..., 3, 3] = moves, 1.0
    return world_matrices(local, parents)


def nearest_rotations(matrices: np.ndarray) -> np.ndarray:
    """Returns the rotations (..., 3, 3) nearest to ``matrices`` (..., 3, 3), also where these mirror."""
    u, _, vt = np.linalg.svd(matrices)
    u[..., -1] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt
