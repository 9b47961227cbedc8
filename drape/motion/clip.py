"""A motion clip: SMPL poses and root translations at a constant frame rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.skeleton import JOINT_COUNT
from drape.errors import MotionError, TooLarge
from drape.files.atomic import whole_file
from drape.geometry.rotations import quaternion_multiply, quaternion_slerp, quaternion_to_rotvec, rotvec_to_quaternion

FLAGGED_SPEED = 0.5 * 60.0
"""Joint speed [rad/s] above which a step is taken for a glitch: 0.5 rad in 1/60 s (issue 2, part 3)."""

# A resampled time this close to a source sample [frames] takes the sample itself.
_KNOT_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class MotionClip:
    """A motion: SMPL poses and root translations at a fixed rate, as read-only float64.

    ``poses`` (F, 24, 3) are rotation vectors [rad] relative to the parent joint. ``trans`` [m] (F, 3), y up, is SMPL's
    root translation, which moves the posed body away from its rest position. ``fps``: frames a second. ``betas`` is the
    shape of the recorded person, None if it is not known. Raises ``MotionError`` for arrays of other shapes or with
    NaN.
    """

    poses: np.ndarray
    trans: np.ndarray
    fps: float
    name: str
    betas: np.ndarray | None = None

    def __post_init__(self) -> None:
        poses = _frozen("poses", self.poses)
        check_shape("poses", poses, (None, JOINT_COUNT, 3), error=MotionError)
        if len(poses) == 0:
            raise MotionError("poses", expected="at least one frame", got="none", cure="Pass a clip that holds frames.")
        trans = _frozen("trans", self.trans)
        check_shape("trans", trans, (len(poses), 3), error=MotionError)
        betas = None if self.betas is None else _frozen("betas", self.betas)
        if betas is not None:
            check_shape("betas", betas, (None,), error=MotionError)
        _check_rate(self.fps)
        object.__setattr__(self, "poses", poses)
        object.__setattr__(self, "trans", trans)
        object.__setattr__(self, "betas", betas)
        object.__setattr__(self, "fps", float(self.fps))

    def __repr__(self) -> str:
        return f"MotionClip({self.name!r}, {self.frame_count} frames at {self.fps:g} per second)"

    @property
    def frame_count(self) -> int:
        return len(self.poses)

    @property
    def duration_s(self) -> float:
        """The time [s] from the first frame to the last."""
        return (self.frame_count - 1) / self.fps

    def resampled(self, fps: float) -> MotionClip:
        """Returns the clip at ``fps`` frames a second: joints by slerp, translations linearly, exact at this clip's
        frames."""
        _check_rate(fps)
        count = int(np.floor((self.frame_count - 1) * (fps / self.fps) + _KNOT_TOLERANCE)) + 1
        place = np.arange(count) * (self.fps / fps)  # It counts this clip's frames.
        nearest = np.rint(place)
        place = np.where(np.abs(place - nearest) < _KNOT_TOLERANCE, nearest, place)
        before = np.minimum(np.floor(place).astype(np.int64), self.frame_count - 1)
        after = np.minimum(before + 1, self.frame_count - 1)
        fraction = place - before
        turn = quaternion_slerp(
            rotvec_to_quaternion(self.poses[before]),
            rotvec_to_quaternion(self.poses[after]),
            np.broadcast_to(fraction[:, None], (count, JOINT_COUNT)),
        )
        at_knot = fraction[:, None] == 0.0
        poses = np.where(at_knot[..., None], self.poses[before], quaternion_to_rotvec(turn))
        trans = (1.0 - fraction[:, None]) * self.trans[before] + fraction[:, None] * self.trans[after]
        return replace(self, poses=poses, trans=trans, fps=fps)

    def window(self, start: int, count: int) -> MotionClip:
        """Returns the clip of ``count`` frames from frame ``start`` on. Raises ``MotionError`` if they run out of this
        clip."""
        if start < 0 or count < 1 or start + count > self.frame_count:
            raise MotionError(
                "window",
                expected=f"1 or more frames inside the {self.frame_count} of {self.name!r}",
                got=f"start {start}, count {count}",
                cure="Choose a start and a count that fit the clip.",
            )
        return replace(self, poses=self.poses[start : start + count], trans=self.trans[start : start + count])

    def slice(self, start_s: float, end_s: float) -> MotionClip:
        """Returns the clip of the frames whose time [s] lies in ``start_s <= t <= end_s``. Raises ``MotionError`` as
        ``window`` does."""
        first = int(np.ceil(start_s * self.fps - _KNOT_TOLERANCE))
        last = int(np.floor(end_s * self.fps + _KNOT_TOLERANCE))
        return self.window(first, last - first + 1)

    def save(self, path: Path) -> None:
        """Writes the clip to ``path`` as an npz that ``read_amass`` reads, whole or not at all. Makes the folder."""
        arrays = {
            "poses": self.poses.astype(np.float32),
            "trans": self.trans.astype(np.float32),
            "mocap_framerate": np.float32(self.fps),
            "name": np.str_(self.name),
            "up": np.str_("y"),
        }
        if self.betas is not None:
            arrays["betas"] = self.betas.astype(np.float32)
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as stream:
            np.savez_compressed(stream, **arrays)


def check_frame_count(name: str, count: int, most_frames: int | None) -> None:
    """Refuses (``TooLarge``) a motion called ``name`` of more than ``most_frames`` frames; None is no limit."""
    if most_frames is not None and count > most_frames:
        cure = "Cut it, or export it at a lower rate."
        raise TooLarge(name, expected=f"at most {most_frames} frames", got=str(count), cure=cure)


def joint_steps(clip: MotionClip) -> np.ndarray:
    """Returns the angles [rad] (F - 1, 24) by which each joint turns, relative to its parent, from frame to frame."""
    quaternions = rotvec_to_quaternion(clip.poses)
    inverse = quaternions[:-1] * np.array([1.0, -1.0, -1.0, -1.0])
    return np.linalg.norm(quaternion_to_rotvec(quaternion_multiply(inverse, quaternions[1:])), axis=-1)


def flagged_steps(clip: MotionClip) -> np.ndarray:
    """Returns whether any joint turns faster than ``FLAGGED_SPEED`` from frame i to i + 1, bool (F - 1,).

    Two orientations are never more than pi apart, so below 9.5 frames per second nothing is flagged.
    """
    return np.any(joint_steps(clip) > FLAGGED_SPEED / clip.fps, axis=-1)


def clean_windows(clip: MotionClip, length: int, *, stride: int = 1) -> list[int]:
    """Returns the indices of the first frames of the windows of ``length`` frames that hold no flagged step
    (``flagged_steps``). A window is tried from every ``stride``-th frame on."""
    return clean_starts(flagged_steps(clip), length, stride=stride).tolist()


def clean_starts(flagged: np.ndarray, length: int, *, stride: int = 1) -> np.ndarray:
    """Returns the first frames (n,) that ``clean_windows`` returns, for the ``flagged_steps`` (F - 1,) of a clip.
    Raises ``MotionError`` for a length or a stride below 1."""
    for name, value in (("length", length), ("stride", stride)):
        if value < 1:
            raise MotionError(name, expected="1 or more frames", got=str(value), cure=f"Choose a positive {name}.")
    flagged_before = np.concatenate([[0], np.cumsum(flagged)])
    starts = np.arange(0, len(flagged) + 1 - length + 1, stride)
    return starts[flagged_before[starts + length - 1] == flagged_before[starts]]


def _frozen(name: str, value: np.ndarray) -> np.ndarray:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise MotionError(name, expected="an array of numbers", got=str(cause), cure="Pass numbers only.") from cause
    check_finite(name, array, error=MotionError)
    array.setflags(write=False)
    return array


def _check_rate(fps: float) -> None:
    if not (np.isfinite(fps) and fps > 0.0):
        raise MotionError(
            "fps", expected="a positive frame rate [1/s]", got=str(fps), cure="Pass the clip's frames per second."
        )
