"""The poses trained on: frames of motion clips, widened by mirroring and by mixing halves of two bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.cluster.vq import kmeans2

from drape.body.pose_distance import BODY_JOINTS, LEGS
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MotionError
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import MotionClip, flagged_steps
from drape.motion.readers import MOTION_SUFFIXES, read_motion
from training.config import DataConfig

MIRROR = tuple(
    JOINT_NAMES.index(n.replace("left", "#").replace("right", "left").replace("#", "right")) for n in JOINT_NAMES
)
KIND_COUNT = 128  # kinds of poses; a share of the draws takes each kind equally often
STRIDE_S = 1.0 / 15.0


def mirror_poses(poses: np.ndarray) -> np.ndarray:
    """Returns ``poses`` (..., 24, 3) [rad] mirrored in the plane x = 0: left and right change places."""
    return poses[..., MIRROR, :] * np.array([1.0, -1.0, -1.0])


def read_training_clips(folders: list[Path], *, held_out: tuple[str, ...]) -> list[MotionClip]:
    """Returns the clips in ``folders``, those of each folder in the order of their names, without those named in
    ``held_out``."""
    clips = []
    for folder in folders:
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in MOTION_SUFFIXES and path.stem not in held_out:
                clips.append(read_motion(path))
    return clips


class PoseBank:
    """The poses to train on: frames of ``clips`` without glitches, 15 a second. A clip's chance to be drawn grows with
    the root of its length, so that long ones do not rule. Raises ``MotionError`` without clips."""

    def __init__(self, clips: list[MotionClip], config: DataConfig) -> None:
        if not clips:
            raise MotionError(
                "training clips",
                expected="at least one motion clip",
                got="none",
                cure="Set DRAPE_DATA, or name a folder with --motions.",
            )
        self.config = config
        frames = []
        for clip in clips:
            flagged = flagged_steps(clip)
            clean = np.ones(clip.frame_count, dtype=bool)
            clean[1:] &= ~flagged
            clean[:-1] &= ~flagged
            stride = max(1, round(clip.fps * STRIDE_S))
            frames.append(clip.poses[np.flatnonzero(clean)[::stride]].astype(np.float64))
        self.frames = [f for f in frames if len(f)]
        chance = np.array([np.sqrt(len(f)) for f in self.frames])
        self.chance = chance / chance.sum()
        self.kinds = pose_kinds(np.concatenate(self.frames))

    @property
    def frame_count(self) -> int:
        return sum(len(f) for f in self.frames)

    def draw(self, count: int, rng: np.random.Generator) -> np.ndarray:
        """Returns random poses (count, 24, 3) [rad] of the clips, some of them with the legs of another pose, some
        mirrored."""
        poses = self._pick(count, rng)
        mixed = rng.random(count) < self.config.mix_share
        other = self._pick(count, rng)
        # The legs of one frame under the trunk of another: both halves were really moved like that.
        rows, legs = np.flatnonzero(mixed)[:, None], np.asarray(LEGS)[None]
        poses[rows, legs] = other[rows, legs]
        flip = rng.random(count) < self.config.mirror_share
        poses[flip] = mirror_poses(poses[flip])
        return poses

    def _pick(self, count: int, rng: np.random.Generator) -> np.ndarray:
        clips = rng.choice(len(self.frames), size=count, p=self.chance)
        poses = np.stack([self.frames[c][rng.integers(len(self.frames[c]))] for c in clips])
        for n in np.flatnonzero(rng.random(count) < self.config.even_share):
            kind = self.kinds[int(rng.integers(len(self.kinds)))]
            poses[n] = kind[int(rng.integers(len(kind)))]
        return poses


def rows_of_three(poses: np.ndarray, step_rad: float, rng: np.random.Generator) -> np.ndarray:
    """Returns poses (3 n, 24, 3) [rad], three for each of ``poses`` (n, 24, 3): the pose minus a random step, the pose,
    and the pose plus that step.

    A step is normal in every component of every joint but the root, with the standard deviation ``step_rad`` [rad].
    """
    step = step_rad * rng.normal(size=poses.shape)
    step[:, 0] = 0.0  # turning as a whole is not what a drape jumps at
    return np.stack([poses - step, poses, poses + step], axis=1).reshape(-1, *poses.shape[1:])


def pose_kinds(poses: np.ndarray) -> list[np.ndarray]:
    """Returns ``poses`` (n, 24, 3) [rad] in up to 128 arrays (m, 24, 3), one for each kind: clusters of the rotations
    of the body's joints (k-means, a fixed seed)."""
    features = rotvec_to_matrix(poses[:, BODY_JOINTS])[..., :2].reshape(len(poses), -1).astype(np.float32)
    count = min(KIND_COUNT, len(poses))
    _, label = kmeans2(features, count, iter=10, minit="++", rng=np.random.default_rng(0))
    return [poses[label == k] for k in range(count) if (label == k).any()]


def draw_betas(count: int, shape_count: int, config: DataConfig, rng: np.random.Generator) -> np.ndarray:
    """Returns random body shapes (count, shape_count): ``config.shape_share`` of them normal with the deviation
    ``config.shape_deviation``, the others zeros, which is the standard body."""
    betas = rng.normal(0.0, config.shape_deviation, size=(count, shape_count))
    return betas * (rng.random((count, 1)) < config.shape_share)
