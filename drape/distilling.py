"""Garments on a character distilled to joints, so that players show them without this program.

shirt = drape.load().wear("tshirt", on="me.vrm")
joints = drape.distil(shirt)
Path("walking.glb").write_bytes(joints.glb("walk"))  # the character, its T-shirt, and tracks of all joints
Path("dressed.vrm").write_bytes(joints.vrm())  # with spring bones, for motion that nobody draped
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from drape.avatar import distilled
from drape.avatar.distilled import JOINTS, DrapedClip
from drape.avatar.file_skeleton import FileRig
from drape.avatar.joint_file import Jointed
from drape.avatar.joint_springs import JointSprings, fit_springs
from drape.avatar.rig_motion import RigClip, RigMotion, rig_motion
from drape.avatar.wearer import Wearer
from drape.avatar.worn_file import worn_glb, worn_vrm
from drape.body.pose_distance import mixed_poses
from drape.catalog import MOTIONS_DIR
from drape.errors import InputError
from drape.export.glb import GARMENT_COLOURS
from drape.export.surface import by_layer
from drape.library import Worn
from drape.motion.clip import MotionClip

FPS = 30.0
MOST_JOINTS = 64  # joints of a garment, at most
POSES, POSES_A_S = 100, 2.5  # training poses that weights are also fitted to, and poses a second

Motion = str | Path | MotionClip


def distil(worn: Worn, motions: Sequence[Motion] | None = None, *, joints: int = JOINTS) -> Joints:
    """Returns the garments of ``worn`` as meshes that are skinned to their character's bones and to ``joints`` further
    joints each.

    ``worn``: garments on a character, from ``Drape.wear`` with ``on``. ``motions``: clips, or names of clips, that are
    draped as examples for the joints; by default the shipped clips. It takes about half a minute a garment. Raises
    ``InputError`` for garments on the standard body, and for ``joints`` outside 1 to ``MOST_JOINTS``.
    """
    if not 1 <= joints <= MOST_JOINTS:
        raise InputError(
            "joints", expected=f"1 to {MOST_JOINTS}", got=str(joints), cure="32 suffice for most garments."
        )
    wearer, rig = worn.on_rig()
    asked = sorted(MOTIONS_DIR.glob("*.npz")) if motions is None else motions
    clips = [_draped(worn, wearer, rig, motion, FPS) for motion in asked]
    support = worn.pose_support
    poses = []
    if support is not None:
        keys = mixed_poses(support, POSES)
        roaming = MotionClip(keys, np.zeros((len(keys), 3)), POSES_A_S, "poses")
        poses = _draped(worn, wearer, rig, roaming, FPS)
    layers, by_garment = [], zip(*clips, strict=True)
    for number, (garment, own) in enumerate(zip(worn.layers, by_garment, strict=True)):
        others = [poses[number]] if poses else []
        made = distilled.distil(garment, own, wearer, rig, count=joints, poses=others)
        layers.append((Jointed(garment.surface, made, GARMENT_COLOURS[number % len(GARMENT_COLOURS)]), own))
    return Joints(worn, layers)


class Joints:
    """The garments of one character as meshes skinned to its bones and to joints of their own; ``distil`` returns
    it."""

    def __init__(self, worn: Worn, layers: Sequence[tuple[Jointed, Sequence[DrapedClip]]]) -> None:
        self.wearer, self._rig = worn.on_rig()
        self._worn, self.layers, self._clips = worn, [one for one, _ in layers], [clips for _, clips in layers]

    def glb(self, motion: Motion, *, fps: float = FPS) -> bytes:
        """Returns the bytes of a GLB: the character's file with the garments, and animation tracks in which all joints
        follow the drape of ``motion`` at ``fps`` frames per second."""
        draped = self._over(motion, fps)
        vertices = [one.vertices for one in draped]
        made = worn_glb(self._worn.character_file, self.layers, vertices, draped[0].motion, self.wearer.scale)
        return made.to_bytes()

    def vrm(self) -> bytes:
        """Returns the bytes of a VRM: the character's file with the garments, whose own joints are spring bones. Its
        VRM version is that of the character. Raises ``InputError`` for a character that is a plain GLB."""
        return worn_vrm(self._worn.character_file, list(zip(self.layers, self.springs, strict=True))).to_bytes()

    @cached_property
    def springs(self) -> list[JointSprings]:
        """Returns the spring bones that move each garment's own joints, fitted to the draped examples; the innermost
        garment first."""
        made = zip(self.layers, self._clips, strict=True)
        return [fit_springs(layer.distilled, clips, self.wearer) for layer, clips in made]

    def errors_mm(self, motion: Motion, *, fps: float = FPS) -> list[dict[str, float]]:
        """Returns for each garment, the innermost first, the root mean square distance [mm] of its vertices from their
        drape over ``motion``. Its keys: "tracks", joints that follow the drape; "springs", spring bones; "carried",
        only the character's bones."""
        errors = []
        for layer, springs, draped in zip(self.layers, self.springs, self._over(motion, fps), strict=True):
            made, scale, on_rig = layer.distilled, self.wearer.scale, draped.motion
            ways = {"tracks": (made, made.fitted(draped, scale)), "springs": (springs.distilled, springs.moves(on_rig))}
            ways["carried"] = made, made.carried(on_rig)
            errors.append({name: 1e3 * one.error_m(draped, moves, scale) for name, (one, moves) in ways.items()})
        return errors

    def _over(self, motion: Motion, fps: float) -> list[DrapedClip]:
        return _draped(self._worn, self.wearer, self._rig, motion, fps)


def _draped(worn: Worn, wearer: Wearer, rig: FileRig, motion: Motion, fps: float) -> list[DrapedClip]:
    """Each garment over ``motion``."""
    clip = worn.placed(motion, fps=fps)
    vertices = np.stack([frame.vertices for frame in worn.play(clip, fps=clip.fps, as_recorded=True)])
    on_rig: RigMotion = rig_motion(RigClip(*wearer.to_rig(clip.poses, clip.trans), clip.fps), wearer, rig.skeleton)
    return list(map(DrapedClip, by_layer(worn.garments, vertices), itertools.repeat(on_rig)))
