"""Windows of motion: consecutive frames of clips and the times between them, for training the recurrent encoder."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.body.features import Kinematics, motion_features
from drape.body.model import BodyModel
from drape.errors import MotionError
from drape.graph.feeds import kinematics
from drape.motion.clip import MotionClip, clean_starts, flagged_steps
from training.config import DataConfig, MotionConfig
from training.poses import mirror_poses

HISTORY = 2  # frames before the first that has motion features, and before the first that has inertia
DRAWS = 50  # tries to find frames at the intervals that were drawn; then every frame of a clip is taken
SWAY_HZ = (0.3, 2.0)


@dataclass(frozen=True, eq=False)
class Windows:
    """B windows of N frames: ``poses`` (B, N, 24, 3) [rad], translations of the root ``trans`` (B, N, 3) [m], and the
    times ``dt_s`` (B, N-1) between frames."""

    poses: np.ndarray
    trans: np.ndarray
    dt_s: np.ndarray

    def kinematics(self, body: BodyModel, betas: np.ndarray) -> Kinematics:
        """Returns the kinematics (B, N, ...) of bodies of shapes ``betas`` (B, S) that move as the windows say."""
        shape = self.poses.shape[:2]
        poses, trans = self.poses.reshape(-1, *self.poses.shape[2:]), self.trans.reshape(-1, 3)
        at = kinematics(body, poses, trans, np.repeat(betas, shape[1], axis=0))
        return Kinematics(*(array.reshape(*shape, *array.shape[1:]) for array in (at.static, at.joints, at.rotations)))

    def features(self, body: BodyModel, betas: np.ndarray) -> np.ndarray:
        """Returns the motion features (B, N-2, 24, 12) of all frames but the first two, of bodies of shapes ``betas``
        (B, S)."""
        at = self.kinematics(body, betas)
        now, before, earlier = at[:, 2:], at[:, 1:-1], at[:, :-2]
        return motion_features(now, before, earlier, self.dt_s[:, 1:], self.dt_s[:, :-1])


class WindowBank:
    """The clips from which windows are drawn. A clip's chance grows with the root of its length.

    Raises ``MotionError`` where no clip has enough frames in a row without a glitch.
    """

    def __init__(self, clips: list[MotionClip], data: DataConfig, motion: MotionConfig) -> None:
        self.mirror_share, self.motion = data.mirror_share, motion
        frames = motion.warm_up_frames + 2 * HISTORY + motion.window_frames
        flags = [(clip, flagged_steps(clip)) for clip in clips]
        usable = [(clip, flagged) for clip, flagged in flags if len(clean_starts(flagged, frames))]
        if not usable:
            raise MotionError(
                "training clips",
                expected=f"a clip with {frames} frames in a row",
                got=f"{len(clips)} clips without",
                cure="Set DRAPE_DATA, or name a folder with --motions.",
            )
        self.clips, self.flagged = [clip for clip, _ in usable], [flagged for _, flagged in usable]
        chance = np.sqrt([clip.frame_count for clip in self.clips])
        self.chance = chance / chance.sum()

    @property
    def frame_count(self) -> int:
        return sum(clip.frame_count for clip in self.clips)

    def draw(self, count: int, frames: int, rng: np.random.Generator) -> Windows:
        """Returns ``count`` random windows of ``frames`` frames, as ``MotionConfig`` says."""
        drawn = [self._draw_one(frames, rng) for _ in range(count)]
        poses, trans, dt_s = (np.stack(parts) for parts in zip(*drawn, strict=True))
        flip = rng.random(count) < self.mirror_share
        poses[flip] = mirror_poses(poses[flip])
        trans[flip] *= np.array([-1.0, 1.0, 1.0])
        return Windows(poses, trans, dt_s)

    def _draw_one(self, frames: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        place, steps = self._clean_steps(frames, rng)
        clip = self.clips[place[0]]
        dt_s = steps / (clip.fps * rng.uniform(*self.motion.speeds))
        index = place[1] + np.concatenate([[0], np.cumsum(steps)])
        time_s = np.concatenate([[0.0], np.cumsum(dt_s)])
        last = frames - 1
        if rng.random() < self.motion.stop_share:
            last = int(rng.integers(1, frames))
        # Time goes on after a stop, the body does not.
        frame = np.minimum(np.arange(frames), last)
        trans = clip.trans[index[frame]] - clip.trans[index[0]]
        if rng.random() < self.motion.sway_share:
            trans = trans + self._sway(time_s[frame], rng)
        return clip.poses[index[frame]], trans, dt_s

    def _clean_steps(self, frames: int, rng: np.random.Generator) -> tuple[tuple[int, int], np.ndarray]:
        """A clip and a first frame, and steps (frames - 1,) in frames of the clip that meet no glitch."""
        motion = self.motion
        for _ in range(DRAWS):
            c = int(rng.choice(len(self.clips), p=self.chance))
            stride = max(1, round(self.clips[c].fps * rng.choice(motion.intervals_s)))
            steps = stride * rng.geometric(1.0 - motion.drop_share, size=frames - 1)
            starts = clean_starts(self.flagged[c], int(steps.sum()) + 1)
            if len(starts):
                return (c, int(rng.choice(starts))), steps
        c = int(rng.choice(len(self.clips), p=self.chance))
        steps = np.ones(frames - 1, dtype=np.int64)
        return (c, int(rng.choice(clean_starts(self.flagged[c], frames)))), steps

    def _sway(self, time_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Displacement [m] (N, 3) of the ground: a sum of three waves, weaker upwards."""
        turn = 2.0 * np.pi * np.exp(rng.uniform(*np.log(SWAY_HZ), size=3))  # [rad/s]
        phase = rng.uniform(0.0, 2.0 * np.pi, size=3)
        acceleration = rng.normal(size=(3, 3)) * [1.0, 0.4, 1.0]
        acceleration *= rng.uniform(0.0, self.motion.sway_m_s2) / np.linalg.norm(acceleration, axis=1).sum()
        return np.sin(time_s[:, None] * turn + phase) @ (acceleration / turn[:, None] ** 2)
