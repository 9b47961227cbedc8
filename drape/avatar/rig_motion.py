"""A clip on the nodes of a character's own file: their local transforms, and their world transforms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drape.avatar.file_skeleton import FileSkeleton
from drape.avatar.wearer import Wearer
from drape.body.skeleton import JOINT_COUNT
from drape.export.glb_file import Channel, GlbFile
from drape.export.root_motion import quaternion_keys
from drape.motion.rig_poses import carrier

STILL = 1e-11  # A node that turns by less than 1e-5 rad in all frames is not animated.


@dataclass(frozen=True, eq=False)
class RigClip:
    """A clip on a character's rig: local rotations of its N nodes, unit ``quaternions`` (F, N, 4) xyzw, and the
    positions ``places`` [m] (F, 3) of the pelvis's node in the world."""

    quaternions: np.ndarray
    places: np.ndarray
    fps: float


@dataclass(frozen=True, eq=False)
class RigMotion:
    """A clip of F frames on a ``skeleton`` of N nodes. Row 0 of the arrays is the T-pose in which garments are at rest;
    the frames are rows 1 to F.

    ``moves`` (F + 1, N, 3) are the nodes' local translations in the unit of the file, ``turns`` (F + 1, N, 4) their
    local rotations, quaternions wxyz; both are rounded to float32. ``world`` (F + 1, N, 4, 4) are the world transforms
    that follow. ``animated`` (n,) are the indices of the nodes that turn, ``top`` that of the one node that is also
    displaced, and ``pelvis`` that of the pelvis's node.
    """

    skeleton: FileSkeleton
    fps: float
    moves: np.ndarray
    turns: np.ndarray
    world: np.ndarray
    animated: np.ndarray
    top: int
    pelvis: int

    @property
    def blends(self) -> np.ndarray:
        """The affine maps (F + 1, J, 4, 4) of each of the skeleton's joints from the bind pose to the world."""
        return self.world[:, self.skeleton.joints] @ self.skeleton.binds

    def part(self, rows: np.ndarray) -> RigMotion:
        """Returns the T-pose and the frames ``rows`` (n,) of the clip, where 0 is the first frame."""
        rows = np.concatenate([[0], rows + 1])
        return replace(self, moves=self.moves[rows], turns=self.turns[rows], world=self.world[rows])

    def animate(self, file: GlbFile, nodes: Mapping[int, int], more: Sequence[Channel] = ()) -> None:
        """Adds an animation to ``file``: the F frames of the clip and the channels ``more``. The skeleton's node n is
        the node ``nodes[n]`` of ``file``."""
        channels = [(nodes[n], "rotation", quaternion_keys(self.turns[1:, n])) for n in self.animated if n in nodes]
        if self.top in nodes:  # A node on which no skin hangs is not written.
            channels.append((nodes[self.top], "translation", self.moves[1:, self.top].astype(np.float32)))
        file.animate(len(self.moves) - 1, self.fps, [*channels, *more])


def rig_motion(clip: RigClip, wearer: Wearer, skeleton: FileSkeleton) -> RigMotion:
    """Returns ``clip`` on the ``skeleton`` of the file of ``wearer``.

    The node that carries legs and trunk is displaced, so that the node of the pelvis lies where the clip has it.
    """
    rest = wearer.to_rig(np.zeros((1, JOINT_COUNT, 3)), np.zeros((1, 3)))
    quaternions, places = (np.concatenate(pair) for pair in zip(rest, (clip.quaternions, clip.places), strict=True))
    turns = quaternions[..., [3, 0, 1, 2]] / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    still = (np.abs(np.einsum("fnq,nq->fn", turns[1:], skeleton.turns)) > 1.0 - STILL).all(axis=0)
    turns[1:, still] = skeleton.turns[still]
    turns = turns.astype(np.float32).astype(np.float64)
    moves = np.tile(skeleton.moves, (len(turns), 1, 1))
    world = skeleton.world(moves, turns)
    top, pelvis = carrier(wearer.rig), wearer.rig.sources["pelvis"]
    way = places / wearer.scale - world[:, pelvis, :3, 3]
    above = skeleton.parents[top]
    if above >= 0:
        way = np.linalg.solve(world[:, above, :3, :3], way[..., None])[..., 0]
    moves[:, top] = (moves[:, top] + way).astype(np.float32)
    return RigMotion(
        skeleton, clip.fps, moves, turns, skeleton.world(moves, turns), np.flatnonzero(~still), top, pelvis
    )
