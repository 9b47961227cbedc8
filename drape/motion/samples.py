"""The sample clips that ship with the product, generated from formulas: no recorded motion.

    python -m drape.motion.samples --out drape/assets/motions

Feet follow planned footsteps, the pelvis rides over them, and inverse kinematics
bends the legs; the upper body follows smooth curves. Every curve is periodic or
starts and ends at rest with two continuous derivatives, so every clip loops
(the walk up to its way forward).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.clip import MotionClip
from drape.motion.grounding import HEEL_BEHIND
from drape.motion.legs import SIDES, posed_clip
from drape.motion.t_pose import ANKLE_HEIGHT, CANONICAL_JOINTS, JOINT_INDEX

FPS = 60.0

_STANCE_SHARE = 0.62  # A foot stays on the ground for this share of a walking cycle.
_STEP_AHEAD = 0.27  # At heel strike a footstep lies this share of a cycle's path before the pelvis.
_LIFT = 0.04  # The height [m] to which a swinging foot is lifted.
_HALF_WIDTH = 0.075  # Footsteps lie so far [m] beside a walker's path.
_STANDING_HEIGHT = 0.922  # The pelvis's height [m] with knees slightly bent.
_ARM_LOWERED = 68.0  # The angle [degrees] from the T-pose down to the side.

_TOE_JOINT = CANONICAL_JOINTS[JOINT_INDEX["left_foot"]] - CANONICAL_JOINTS[JOINT_INDEX["left_ankle"]]
_HEEL = np.array([0.0, -ANKLE_HEIGHT, -HEEL_BEHIND])


def walk() -> MotionClip:
    """Returns a clip of four strides of 1.1 s along +z at 0.9 m/s."""
    return _gait("walk", cycle_s=1.1, cycle_count=4, stride=1.0, turn=0.0, height=0.893)


def turn() -> MotionClip:
    """Returns a clip of six strides of 1 s around a full circle to the left."""
    return _gait("turn", cycle_s=1.0, cycle_count=6, stride=0.9, turn=2.0 * np.pi / 6.0, height=0.886)


def reach() -> MotionClip:
    """Returns a clip in which the right hand reaches up and forward, then the left out and down."""
    t = _times(5.0)
    up = _path(t, (0.3, 1.4, 1.9, 2.8), (0, 1, 1, 0))
    down = _path(t, (2.5, 3.5, 3.9, 4.8), (0, 1, 1, 0))
    root = np.stack([-0.04 * up + 0.03 * down, -0.006 * up - 0.06 * down, 0.03 * up + 0.01 * down], axis=-1)
    root[:, 1] += _STANDING_HEIGHT
    pelvis = _yaw(8 * up + 6 * down) @ _pitch(3 * up + 14 * down)
    lean = {
        "spine1": _yaw(5 * up + 3 * down) @ _pitch(-1 * up + 9 * down),
        "spine2": _yaw(7 * up + 4 * down) @ _pitch(-2 * up + 9 * down),
        "spine3": _yaw(6 * up + 4 * down) @ _pitch(-3 * up + 8 * down) @ _roll(-5 * up),
        "neck": _pitch(-7 * up + 4 * down),
        "head": _yaw(-12 * up + 6 * down) @ _pitch(-12 * up + 8 * down),
    }
    arms = _arms(
        swing={"left": 30 * down, "right": 145 * up},
        bend={"left": 14 - 6 * down, "right": 14 + 30 * up * (1 - up) * 4 - 4 * up},
        lowered={"left": _ARM_LOWERED - 18 * down, "right": _ARM_LOWERED + 4 * up},
        collar={"left": 4 * down, "right": 14 * up},
    )
    return _standing("reach", root, pelvis, lean | arms, half_width=0.12)


def squat() -> MotionClip:
    """Returns a clip of two squats, with arms that swing forward for balance."""
    t = _times(5.0)
    depth = _path(t, (0.3, 1.3, 1.5, 2.5), (0, 1, 1, 0)) + _path(t, (2.5, 3.5, 3.7, 4.7), (0, 1, 1, 0))
    root = np.stack([0 * depth, _STANDING_HEIGHT - 0.36 * depth, -0.13 * depth], axis=-1)
    lean = {
        "spine1": _pitch(3 * depth),
        "spine2": _pitch(4 * depth),
        "spine3": _pitch(2 * depth),
        "neck": _pitch(-12 * depth),
        "head": _pitch(-14 * depth),
    }
    arms = _arms(
        swing={side: 105 * depth for side in SIDES},
        bend={side: 14 + 4 * depth for side in SIDES},
        lowered={side: _ARM_LOWERED + 8 * depth for side in SIDES},
        collar={side: 0 * depth for side in SIDES},
    )
    return _standing("squat", root, _pitch(30 * depth), lean | arms, half_width=0.17, toe_out=18.0)


def stretch() -> MotionClip:
    """Returns a clip in which arms are raised sideways over the head, then the trunk twists and bends to both sides."""
    t = _times(6.0)
    raised = _path(t, (0.2, 1.5, 4.6, 5.9), (0, 1, 1, 0))
    twist = _path(t, (1.4, 2.1, 3.0, 3.7), (0, 1, -1, 0))
    bend = _path(t, (3.2, 3.8, 4.4, 5.0), (0, 1, -1, 0))
    root = np.stack([0.03 * bend, _STANDING_HEIGHT + 0.01 * raised - 0.012 * bend**2, 0 * t], axis=-1)
    lean = {
        "spine1": _yaw(9 * twist) @ _roll(-8 * bend),
        "spine2": _yaw(11 * twist) @ _roll(-8 * bend),
        "spine3": _yaw(11 * twist) @ _roll(-7 * bend) @ _pitch(-5 * raised),
        "neck": _yaw(6 * twist) @ _roll(-4 * bend),
        "head": _yaw(6 * twist) @ _roll(-4 * bend),
    }
    arms = _arms(
        swing={side: 6 * raised for side in SIDES},
        bend={side: 14 + 8 * raised for side in SIDES},
        lowered={side: _ARM_LOWERED - 122 * raised for side in SIDES},
        collar={side: 18 * raised for side in SIDES},
    )
    return _standing("stretch", root, _yaw(8 * twist), lean | arms, half_width=0.13)


SAMPLES = {"walk": walk, "turn": turn, "reach": reach, "squat": squat, "stretch": stretch}


def _gait(name: str, *, cycle_s: float, cycle_count: int, stride: float, turn: float, height: float) -> MotionClip:
    """A walk with ``stride`` [m] of path and ``turn`` [rad] to the left per cycle, the pelvis at ``height`` [m]."""
    t = _times(cycle_s * cycle_count)
    cycle = t / cycle_s  # The left heel strikes at whole numbers, the right one half a cycle later.
    swing = 2.0 * np.pi * cycle
    wave, quarter, still = np.cos(swing), np.sin(swing), np.zeros_like(t)
    root, heading = _on_path(cycle, stride, turn)
    root[:, 1] = height - 0.015 * np.cos(2.0 * swing - 0.9)
    root += _moved(heading, np.stack([0.018 * np.sin(swing - 0.3), still, still], axis=-1))
    bank = -4.0 * turn
    pelvis = heading @ _yaw(-5 * wave) @ _roll(3.5 * quarter + bank) @ _pitch(2.0 + still)
    trunk = {
        "spine1": _yaw(3 * wave) @ _roll(-1.5 * quarter) @ _pitch(1.0 + still),
        "spine2": _yaw(3.5 * wave) @ _roll(-1.5 * quarter),
        "spine3": _yaw(3.5 * wave) @ _roll(-1.0 * quarter) @ _pitch(1.0 + still),
        "neck": _yaw(-2.5 * wave + 4.0 * turn),
        "head": _yaw(-2.5 * wave + 6.0 * turn) @ _roll(still - bank) @ _pitch(-2.0 + still),
    }
    ahead = {"left": -wave, "right": wave}  # An arm swings with the other leg.
    arms = _arms(
        swing={side: 2.0 + 20.0 * ahead[side] for side in SIDES},
        bend={side: 22.0 + 9.0 * ahead[side] for side in SIDES},
        lowered={side: _ARM_LOWERED + still for side in SIDES},
        collar={side: still for side in SIDES},
    )
    steps = {side: _steps(cycle, side, stride, turn) for side in SIDES}
    toes = {f"{side}_foot": steps[side][2] for side in SIDES}
    poses, trans = posed_clip(
        root,
        pelvis,
        trunk | arms | toes,
        {side: steps[side][0] for side in SIDES},
        {side: steps[side][1] for side in SIDES},
    )
    return MotionClip(poses=poses, trans=trans, fps=FPS, name=name)


def _steps(cycle: np.ndarray, side: str, stride: float, turn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ankle positions [m], foot rotations and toe rotations of a walker's foot.

    The foot stays at its footstep, rolls over its toes, swings to the next and lands on the heel.
    """
    late = 0.0 if side == "left" else 0.5
    count = np.floor(cycle - late)
    phase = cycle - late - count
    share = _path(phase, (_STANCE_SHARE, 1.0), (0, 1))
    place, heading = _on_path(count + late + _STEP_AHEAD + share, stride, turn)
    width = _HALF_WIDTH if side == "left" else -_HALF_WIDTH
    heel_up = _path(phase, (0.30, 0.65, 0.88), (0, 48, 0))
    toe_up = _path((phase + 0.5) % 1.0, (0.28, 0.46, 0.50, 0.60), (0, 14, 14, 0))
    free = np.clip((phase - _STANCE_SHARE) / (1.0 - _STANCE_SHARE), 0.0, 1.0)
    ankle = _rolled(_pitch(heel_up), _TOE_JOINT) + _rolled(_pitch(-toe_up), _HEEL)
    ankle += np.stack(
        [np.full_like(phase, width), ANKLE_HEIGHT + _LIFT * 64.0 * (free * (1.0 - free)) ** 3, 0 * phase], axis=-1
    )
    return place + _moved(heading, ankle), heading @ _pitch(heel_up - toe_up), _pitch(-heel_up)


def _rolled(rotation: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    """Displacements (F, 3) of the ankle when the foot rolls about a point of its sole."""
    return pivot - rotation @ pivot


def _on_path(cycle: np.ndarray, stride: float, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions (F, 3) [m] on the ground and headings (F, 3, 3) of a walker's path, a line or a circle."""
    angle = turn * cycle
    if turn == 0.0:
        place = np.stack([0 * cycle, 0 * cycle, stride * cycle], axis=-1)
    else:
        place = stride / turn * np.stack([1.0 - np.cos(angle), 0 * cycle, np.sin(angle)], axis=-1)
    return place, _yaw(np.degrees(angle))


def _standing(
    name: str,
    root: np.ndarray,
    pelvis: np.ndarray,
    upper: dict[str, np.ndarray],
    *,
    half_width: float,
    toe_out: float = 8.0,
) -> MotionClip:
    """A clip with both feet flat at their places; ``root`` is the pelvis relative to the point between them."""
    ankles, feet = {}, {}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        ankles[side] = np.broadcast_to([sign * half_width, ANKLE_HEIGHT, -0.03], root.shape)
        feet[side] = _yaw(np.full(len(root), sign * toe_out))
    poses, trans = posed_clip(root, pelvis, upper, ankles, feet)
    return MotionClip(poses=poses, trans=trans, fps=FPS, name=name)


def _arms(
    *,
    swing: dict[str, np.ndarray],
    bend: dict[str, np.ndarray],
    lowered: dict[str, np.ndarray],
    collar: dict[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Local rotations of collars, shoulders and elbows; angles [degrees] by side.

    ``lowered`` brings the arm from the T-pose to the side, ``swing`` forward and up,
    ``bend`` flexes the elbow, ``collar`` lifts the shoulder.
    """
    joints = {}
    for side, sign in zip(SIDES, (1.0, -1.0), strict=True):
        joints[f"{side}_collar"] = _roll(sign * collar[side])
        joints[f"{side}_shoulder"] = _pitch(-swing[side]) @ _roll(-sign * lowered[side])
        joints[f"{side}_elbow"] = _yaw(-sign * bend[side])
    return joints


def _times(duration_s: float) -> np.ndarray:
    """Sample times [s] of a loop: the end, which equals the start, is left out."""
    return np.arange(round(duration_s * FPS)) / FPS


def _path(t: np.ndarray, knots: Sequence[float], values: Sequence[float]) -> np.ndarray:
    """A curve through ``values`` at ``knots``, at rest there and constant outside; quintic, so twice differentiable."""
    curve = np.full_like(t, values[0])
    for start, end, before, after in zip(knots[:-1], knots[1:], values[:-1], values[1:], strict=True):
        s = np.clip((t - start) / (end - start), 0.0, 1.0)
        curve = curve + (after - before) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return curve


def _moved(rotation: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (rotation @ vectors[..., None])[..., 0]


def _about(axis: int, angle_deg: np.ndarray) -> np.ndarray:
    rotvec = np.zeros((*np.shape(angle_deg), 3))
    rotvec[..., axis] = np.radians(angle_deg)
    return rotvec_to_matrix(rotvec)


def _pitch(angle_deg: np.ndarray) -> np.ndarray:
    """Rotations about x: the trunk forward, a hanging arm back, a heel up."""
    return _about(0, angle_deg)


def _yaw(angle_deg: np.ndarray) -> np.ndarray:
    """Rotations about y: to the left."""
    return _about(1, angle_deg)


def _roll(angle_deg: np.ndarray) -> np.ndarray:
    """Rotations about z: the left side up."""
    return _about(2, angle_deg)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Write the generated sample clips.")
    parser.add_argument("--out", type=Path, required=True, help="folder for NAME.npz")
    out = parser.parse_args(arguments).out
    for name, make in SAMPLES.items():
        make().save(out / f"{name}.npz")
        print(out / f"{name}.npz")


if __name__ == "__main__":
    main()
