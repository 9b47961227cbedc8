"""SMPL poses from a person's key points in space: MediaPipe's 33 world landmarks or COCO's 17 points.

Points tell where joints are, and not how bones turn about themselves. So a pose is read
in steps, each seen from the one before: the pelvis from hips and shoulders, the spine
spread from there to the line of the shoulders, each limb by the least turn that lays its
bone on the points, and its twist by the plane in which elbow or knee bends.

What points cannot tell is zero: collars, wrists, hands, toes, a forearm's twist, and
with COCO the feet. Nor do they tell how much of a trunk's lean to the front is a bend of
the spine: that is guessed from how far the hips are bent (``TUCK``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from drape.arrays import check_finite, check_shape
from drape.body.skeleton import JOINT_COUNT, PARENTS
from drape.errors import MotionError
from drape.geometry.rotations import cross, matrix_to_rotvec, rotvec_to_matrix
from drape.motion.alignment import least_turn
from drape.motion.key_points import KeyPoints, Layout, layout_named
from drape.motion.legs import SIDES
from drape.motion.one_euro import OneEuro
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX

TWIST_BENDS = (float(np.radians(5.0)), float(np.radians(15.0)))
"""Bends [rad] of elbow and knee between which the twist of upper arm and thigh grows from zero to what they tell.

A straight limb tells no twist, and the errors of its points are divided by the sine of the bend.
"""

TUCK = 0.2
"""Share of the hips' flexion by which the pelvis tilts back against the line from hips to shoulders.

In 23 recorded clips (CMU) the spine bends forward by 0.43 of the flexion, with a correlation of 0.88. A fifth halves
the pelvis's error there, from 16.9 to 8.8 degrees, and costs 1.7 in the sample clips, whose backs are straight.
"""

BACKWARDS = 0.5
"""Cosine beyond which a face looks backwards: nobody turns the head by two thirds of a half turn all the time."""

TOLD_AFTER = 30
"""Samples of a stream, a second or two, by which sides are judged: who looks over the shoulder does so for less."""

# Measured on the shipped body in the T-pose: from the middle of the ears the nose lies ahead and 14.4 degrees below,
# and from the heels (2, 3) the big toes lie ahead, inwards and below.
_LOOKING = rotvec_to_matrix(np.radians([14.4, 0.0, 0.0]))
_TOE_LINES = np.array([[-0.114, -0.080, 0.990], [0.114, -0.080, 0.990]])
_TOE_LINES /= np.linalg.norm(_TOE_LINES, axis=-1, keepdims=True)

# The limbs, by the joints of upper bone and lower bone and the lower's end, and the axes (4, 3) that elbows and knees
# flex about in the T-pose.
_UPPER = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
_LOWER = ("left_elbow", "right_elbow", "left_knee", "right_knee")
_ENDS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")
_FLEXION = np.array([[0.0, -1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])

_COLLARS, _HEELS, _TOES, _ANKLES = (
    tuple(f"{side}_{name}" for side in SIDES) for name in ("collar", "heel", "toe", "ankle")
)
_SHOULDERS, _HIPS, _KNEES = _UPPER[:2], _UPPER[2:], _LOWER[2:]
_HEAD = ("left_ear", "right_ear", "nose")


@dataclass(frozen=True)
class _Rest:
    """The posed body's T-pose: pelvis and chest (3, 3) as points tell them, upper and lower bones (4, 3)."""

    pelvis: np.ndarray
    chest: np.ndarray
    upper: np.ndarray
    lower: np.ndarray


@dataclass
class _Memory:
    """What is held while points are not seen: local rotations (24, 3, 3), the limbs' twists (4,), a tilt (1,) [rad]."""

    local: np.ndarray = field(default_factory=lambda: np.tile(np.eye(3), (JOINT_COUNT, 1, 1)))
    twist: np.ndarray = field(default_factory=lambda: np.zeros(len(_UPPER)))
    tilt: np.ndarray = field(default_factory=lambda: np.zeros(1))


def landmark_poses(
    points: np.ndarray,
    *,
    layout: str = "mediapipe",
    visibility: np.ndarray | None = None,
    rest_joints: np.ndarray = CANONICAL_JOINTS,
) -> np.ndarray:
    """SMPL poses (F, 24, 3) [rad] of key points (F, N, 3) [m] with ``visibility`` (F, N) from 0 to 1.

    Points are in the axes of their ``layout`` (``LAYOUTS``), from any origin. A joint whose
    points are less visible than ``VISIBLE`` holds its last pose, at first the T-pose.
    ``rest_joints`` (24, 3) [m] are the posed body's: its bones are laid on the points.
    Raises ``MotionError`` for other shapes, NaN, seen points that make no skeleton, and a person who looks backwards,
    as one does whose left and right are swapped.
    """
    sample = KeyPoints.checked(points, visibility, layout_named(layout))
    _check_sides(_looking(sample))
    return _read(sample, _rest(rest_joints), _Memory())


def _check_sides(looking: Sequence[float] | np.ndarray) -> None:
    """Refuses frames in whose mean the nose lies behind the shoulders; ``looking`` as ``_looking`` gives it."""
    if len(looking) and np.mean(looking) < -BACKWARDS:
        raise MotionError(
            "landmarks",
            expected="a nose on the side that the shoulders face",
            got="one behind them: left and right look swapped",
            cure="Swap the points of left and right, as a mirrored picture needs, or name the layout.",
        )


def _looking(points: KeyPoints) -> np.ndarray:
    """Cosines between where shoulders and nose point, of the frames that show both."""
    seen = points.sees(*_HEAD, *_HIPS, *_SHOULDERS)
    if not seen.any():
        return np.zeros(0)
    _, chest = _trunk_frames(points)
    nose = points.with_middles(ears=_HEAD[:2]).lines(["ears"], ["nose"])[:, 0]
    return _dot(chest[seen, :, 2], nose[seen])


class LandmarkPoses:
    """The poses of a stream of key points, one sample after the other.

    Without ``smoothing``, which filters the points before they are read, a stream gives what ``landmark_poses`` gives
    for the clip. A refused sample leaves the stream as it was, but for the filter. A person whose left and right are
    swapped is refused after ``TOLD_AFTER`` samples that look so, and then after as many more.
    """

    def __init__(
        self,
        *,
        layout: str = "mediapipe",
        rest_joints: np.ndarray = CANONICAL_JOINTS,
        smoothing: OneEuro | None = None,
    ) -> None:
        self._layout, self._rest = layout_named(layout), _rest(rest_joints)
        self._smoothing, self._memory, self._looked = smoothing, _Memory(), list[float]()

    def __call__(self, points: np.ndarray, *, dt_s: float, visibility: np.ndarray | None = None) -> np.ndarray:
        """The pose (24, 3) [rad] of points (N, 3) [m] with visibility (N,), ``dt_s`` after the last sample."""
        seen = None if visibility is None else np.asarray(visibility)[None]
        sample = KeyPoints.checked(np.asarray(points)[None], seen, self._layout)
        self._looked += _looking(sample).tolist()
        if len(self._looked) >= TOLD_AFTER:
            looked, self._looked = self._looked, []
            _check_sides(looked)
        if self._smoothing is not None:
            smooth = self._smoothing(sample.places[0], dt_s, seen=sample.seen[0])
            sample = KeyPoints(smooth[None], sample.seen, self._layout)
        return _read(sample, self._rest, self._memory)[0]


class _Skeleton:
    """Local rotations (F, 24, 3, 3), set from the pelvis on, and the world rotations that they make."""

    def __init__(self, count: int, memory: _Memory) -> None:
        self.local = np.tile(np.eye(3), (count, JOINT_COUNT, 1, 1))
        # The last entry is the world itself, which PARENTS calls -1.
        self.world = np.tile(np.eye(3), (count, JOINT_COUNT + 1, 1, 1))
        self.memory = memory

    def below(self, joints: Sequence[str]) -> np.ndarray:
        """World rotations (F, n, 3, 3) of the joints' parents."""
        return self.world[:, [PARENTS[JOINT_INDEX[joint]] for joint in joints]]

    def seen_from(self, joints: Sequence[str], directions: np.ndarray) -> np.ndarray:
        """World directions (F, n, 3) in the axes of the joints' parents."""
        return _turned(_transposed(self.below(joints)), directions)

    def turn(self, joints: Sequence[str], local: np.ndarray, seen: np.ndarray) -> None:
        """Sets rotations relative to the parents (F, n, 3, 3), held where a joint is not seen (F, n)."""
        at = [JOINT_INDEX[joint] for joint in joints]
        self.local[:, at] = _held(local, seen, self.memory.local[at])
        self.world[:, at] = self.below(joints) @ self.local[:, at]


def _read(points: KeyPoints, rest: _Rest, memory: _Memory) -> np.ndarray:
    """Poses (F, 24, 3) [rad]; ``memory`` goes on from the last frame."""
    body = _Skeleton(len(points), memory)
    tilts = _read_trunk(points, rest, body)
    twists = _read_limbs(points, rest, body)
    if points.has("left_toe"):
        ahead = body.seen_from(_ANKLES, points.lines(_HEELS, _TOES))
        body.turn(_ANKLES, _bent(ahead, _TOE_LINES, _FLEXION[2:]), points.lines_seen(_HEELS, _TOES))
    if len(points):
        memory.local, memory.twist, memory.tilt = (held[-1].copy() for held in (body.local, twists, tilts))
    return matrix_to_rotvec(body.local)


def _read_trunk(points: KeyPoints, rest: _Rest, body: _Skeleton) -> np.ndarray:
    """Turns pelvis, spine in three equal parts, neck and head in two; returns the pelvis's tilts [rad] (F, 1)."""
    pelvis, chest = _trunk_frames(points)
    seen = points.sees(*_HIPS, *_SHOULDERS)[:, None]
    upright = (pelvis @ rest.pelvis.T)[:, None]
    flexion = _flexion(_turned(_transposed(upright), points.lines(_HIPS, _KNEES)), rest.upper[2:])
    tilt = _held(-TUCK * flexion.mean(axis=1, keepdims=True), points.sees(*_KNEES)[:, None] & seen, body.memory.tilt)
    body.turn(["pelvis"], upright @ rotvec_to_matrix(tilt[..., None] * _FLEXION[2]), seen)
    third = _share(_transposed(body.below(["spine1"])) @ (chest @ rest.chest.T)[:, None], 1.0 / 3.0)
    for joint in ("spine1", "spine2", "spine3"):
        body.turn([joint], third, seen)
    head = points.with_middles(ears=_HEAD[:2])
    axes = head.lines(("right_ear", "ears"), ("left_ear", "nose"))
    looking = points.frame(axes[:, 0], axes[:, 1], of=_HEAD) @ _LOOKING.T
    half = _share(_transposed(body.below(["neck"])) @ looking[:, None], 0.5)
    for joint in ("neck", "head"):
        body.turn([joint], half, points.sees(*_HEAD)[:, None])
    body.world[:, [JOINT_INDEX[joint] for joint in _COLLARS]] = body.below(_COLLARS)
    return tilt


def _flexion(thighs: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Angles [rad] (F, 2) by which thighs (F, 2, 3), in the trunk's axes, are bent forward from rest (2, 3)."""
    angle = np.arctan2(thighs[..., 2], -thighs[..., 1]) - np.arctan2(rest[..., 2], -rest[..., 1])
    return np.maximum(angle, 0.0)  # its jump, at half a turn, is out of a hip's reach


def _trunk_frames(points: KeyPoints) -> tuple[np.ndarray, np.ndarray]:
    """Frames (F, 3, 3) of pelvis and chest: x along hips and along shoulders, y towards the line between the two."""
    points = points.with_middles(hips=_HIPS, shoulders=_SHOULDERS)
    lines = points.lines(("right_hip", "right_shoulder", "hips"), ("left_hip", "left_shoulder", "shoulders"))
    hips, shoulders, up = (lines[:, k] for k in range(3))
    trunk = (*_HIPS, *_SHOULDERS)
    return points.frame(hips, cross(hips, up), of=trunk), points.frame(shoulders, cross(shoulders, up), of=trunk)


def _read_limbs(points: KeyPoints, rest: _Rest, body: _Skeleton) -> np.ndarray:
    """Turns shoulders and hips, elbows and knees; returns the twists [rad] (F, 4) of upper arms and thighs."""
    upper, lower = points.lines(_UPPER, _LOWER), points.lines(_LOWER, _ENDS)
    upper_seen, lower_seen = points.lines_seen(_UPPER, _LOWER), points.lines_seen(_LOWER, _ENDS)
    swing = least_turn(rest.upper, body.seen_from(_UPPER, upper), np.eye(3))
    twist = _twist(_turned(_transposed(swing), body.seen_from(_UPPER, lower)), rest.upper, rest.lower, _FLEXION)
    twist = _held(twist, upper_seen & lower_seen, body.memory.twist)
    body.turn(_UPPER, swing @ rotvec_to_matrix(twist[..., None] * rest.upper), upper_seen)
    body.turn(_LOWER, _bent(body.seen_from(_LOWER, lower), rest.lower, _FLEXION), lower_seen)
    return twist


def _twist(child: np.ndarray, bone_rest: np.ndarray, child_rest: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Twists [rad] (F, n) about ``bone_rest`` (n, 3) after which ``child`` (F, n, 3) hangs on its hinge.

    There it is ``child_rest`` (n, 3) flexed about ``axis`` (n, 3), and a hinge keeps the
    child's part along its axis. Let v be the axis's part across the bone and u = v x bone:
    seen along the bone, the child lies at the angle phi from u to v, and belongs at phi_0,
    (axis.bone) (child.bone) + |child's part across the bone| (axis.v) sin(phi_0) = axis.child_rest.
    """
    v = axis - _dot(axis, bone_rest)[..., None] * bone_rest
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    along, on_u, on_v = _dot(child, bone_rest), _dot(child, cross(v, bone_rest)), _dot(child, v)
    across = np.hypot(on_u, on_v)
    sine = (_dot(axis, child_rest) - _dot(axis, bone_rest) * along) / np.maximum(across * _dot(axis, v), 1e-12)
    angle = np.arctan2(on_v, on_u) - np.arcsin(np.clip(sine, -1.0, 1.0))
    angle = np.arctan2(np.sin(angle), np.cos(angle))  # at half a turn either sign is right, and a blend jumps
    low, high = TWIST_BENDS
    told = np.clip((np.arctan2(across, along) - low) / (high - low), 0.0, 1.0)
    return angle * told * told * (3.0 - 2.0 * told)


def _bent(end: np.ndarray, start: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Rotations (F, n, 3, 3) of ``start`` (n, 3) onto ``end`` (F, n, 3): about ``axis`` (n, 3), then by least turn."""
    from_hinge, to_hinge = (vectors - _dot(vectors, axis)[..., None] * axis for vectors in (start, end))
    angle = np.arctan2(_dot(cross(from_hinge, to_hinge), axis), _dot(from_hinge, to_hinge))
    hinged = rotvec_to_matrix(angle[..., None] * axis)
    return least_turn(_turned(hinged, start), end, hinged) @ hinged


def _rest(joints: np.ndarray) -> _Rest:
    """What reading needs of the T-pose's joints (24, 3); joints that make no skeleton are refused."""
    joints = np.asarray(joints, dtype=np.float64)
    check_shape("rest_joints", joints, (JOINT_COUNT, 3), error=MotionError)
    check_finite("rest_joints", joints, error=MotionError)
    all_seen = np.ones((1, JOINT_COUNT), dtype=bool)
    points = KeyPoints(joints[None], all_seen, Layout(JOINT_INDEX, JOINT_COUNT), "rest_joints")
    pelvis, chest = _trunk_frames(points)
    return _Rest(pelvis[0], chest[0], points.lines(_UPPER, _LOWER)[0], points.lines(_LOWER, _ENDS)[0])


def _held(values: np.ndarray, seen: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Values (F, n, ...), and where one is not seen (F, n) the last that was; ``last`` (n, ...) is before them all."""
    frames = np.arange(1, len(seen) + 1)[:, None]
    newest = np.maximum.accumulate(np.where(seen, frames, 0), axis=0)
    return np.concatenate([last[None], values])[newest, np.arange(seen.shape[1])]


def _share(rotations: np.ndarray, share: float) -> np.ndarray:
    """Rotations (F, 3, 3) about the same axes by a share of their angles."""
    return rotvec_to_matrix(share * matrix_to_rotvec(rotations))


def _transposed(rotations: np.ndarray) -> np.ndarray:
    return np.swapaxes(rotations, -1, -2)


def _turned(rotations: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (rotations @ vectors[..., None])[..., 0]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)
