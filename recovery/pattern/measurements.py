"""A tailor's measurements, taken from a body's mesh in the T-pose: girths by an imagined tape, heights, reaches.

In sizes S to XXL, of which the body is M, girths of the trunk grow by a letter of EN 13402-3
(``drape.garment.size_chart``). The other steps are proportional to these, as in tailors' grading tables, and lengths
grow by what makers of T-shirts print.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.errors import BodyError, NotFound
from drape.garment.size_chart import GIRTH_STEP_M, STEPS
from drape.geometry.sections import convex_hull, level_section

STEP_M = 0.01  # between the heights at which the trunk is measured
BESIDE_M = 1e-4  # planes beside the middle: vertices lie exactly on it
# Patterns come in one size more than garments that are sewn and stored.
PATTERN_STEPS = STEPS | {"XXL": 3}
# Growth [m] per size; girths whole, half widths half.
GROWTH_M = {
    "chest_girth": GIRTH_STEP_M,
    "waist_girth": GIRTH_STEP_M,
    "hip_girth": GIRTH_STEP_M,
    "thigh_girth": 0.044,
    "calf_girth": 0.024,
    "arm_girth": 0.028,
    "wrist_girth": 0.012,
    "neck_half_width": 0.003,
    "shoulder_x": 0.012,
    "underarm_y": -0.008,  # armholes deepen
    "longer_m": 0.02,
    "wider_m": 0.024,
}


@dataclass(frozen=True, eq=False)
class BodyMeasurements:
    """The measures [m] of a body at rest in the T-pose; heights are y, reaches are x on the left side.

    ``heights`` and ``girths`` (N,) give the tape around the trunk (both legs below the crotch), ``front_z`` and
    ``back_z`` how far the trunk reaches. Arm girths are taken a quarter down the upper arm and at the wrist.
    ``longer_m`` is what tops and skirts for it are cut longer, and sleeves and legs by half of it: a size is worn by
    bodies of any height, and its lengths grow with its girths. ``wider_m`` is what the ends of sleeves and legs are cut
    wider, where no girth of the body tells them.
    """

    neck_y: float
    neck_half_width: float
    shoulder_x: float
    underarm_y: float
    chest_girth: float
    waist_y: float
    waist_girth: float
    hip_y: float
    hip_girth: float
    crotch_y: float
    knee_y: float
    ankle_y: float
    thigh_girth: float
    calf_girth: float
    elbow_x: float
    wrist_x: float
    arm_y: float
    arm_z: float
    arm_girth: float
    wrist_girth: float
    front_z: float
    back_z: float
    heights: np.ndarray
    girths: np.ndarray
    longer_m: float = 0.0
    wider_m: float = 0.0

    @property
    def limbs_longer_m(self) -> float:
        """The length [m] by which sleeves and legs are cut longer."""
        return 0.5 * self.longer_m

    def girth_at(self, y: float) -> float:
        """Returns the girth [m] of the trunk at the height ``y`` [m], as a tape around it reads."""
        return float(np.interp(y, self.heights, self.girths))


def section(vertices: np.ndarray, faces: np.ndarray, axis: int, value: float) -> np.ndarray:
    """Returns points [m] (N, 3) where edges of the triangles cross the plane x_axis = ``value`` [m]."""
    level = np.roll(vertices, 1 - axis, axis=1)
    return np.roll(level_section(faces, level, value).points(level), axis - 1, axis=1)


def tape(points: np.ndarray) -> float:
    """Returns the perimeter [m] of the convex hull of ``points`` [m] (N, 2), which a taut tape reads. Raises
    ``BodyError`` where there is none."""
    hull = convex_hull(points)
    if hull is None:
        raise BodyError(
            "body",
            expected="a mesh that the measuring plane cuts",
            got=f"{len(points)} points",
            cure="Check that the body stands in the T-pose, in metres, y up.",
        )
    return float(hull.area)  # in the plane qhull's "area" is the perimeter


def measure_body(body: BodyModel) -> BodyMeasurements:
    """Returns the measurements of ``body`` in its rest pose, both arms spread."""
    vertices, joints = body.v_template, body.joints_template
    place = {name: joints[JOINT_NAMES.index(name)] for name in JOINT_NAMES}
    arms = [JOINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("elbow", "wrist", "hand")]
    is_arm = body.weights[:, arms].sum(axis=1) > 0.5
    trunk = body.faces[~is_arm[body.faces].any(axis=1)]
    shoulder, elbow, wrist = place["left_shoulder"], place["left_elbow"], place["left_wrist"]

    def level(y: float, reach: float = np.inf) -> np.ndarray:
        points = section(vertices, trunk, 1, y)[:, [0, 2]]
        return points[np.abs(points[:, 0]) < reach]

    def across(x: float) -> np.ndarray:
        points = section(vertices, body.faces, 0, x)
        return points[points[:, 1] > place["spine3"][1]]

    inner_arm = float(shoulder[0] + 0.05 * (elbow[0] - shoulder[0]))
    armpit = across(inner_arm)
    underarm_y = float(armpit[:, 1].min())
    heights = np.arange(place["left_ankle"][1], underarm_y, STEP_M)
    girths = np.array([tape(level(y, inner_arm)) for y in heights])
    around_waist = (heights > place["spine1"][1]) & (heights < place["spine3"][1])
    around_hips = (heights > place["left_hip"][1] - 0.12) & (heights < place["spine1"][1])
    waist = int(np.flatnonzero(around_waist)[girths[around_waist].argmin()])
    hip = int(np.flatnonzero(around_hips)[girths[around_hips].argmax()])
    middle = section(vertices, trunk, 0, BESIDE_M)
    below = middle[(middle[:, 1] < place["spine1"][1]) & (middle[:, 1] > place["left_knee"][1])]
    crotch_y = float(below[:, 1].min())
    neck = level(float(place["neck"][1]), 0.6 * float(shoulder[0]))
    leg = level(crotch_y - 0.03)
    calves = [
        tape(points[points[:, 0] > 0.0])
        for points in (level(y) for y in np.arange(place["left_ankle"][1] + 0.05, place["left_knee"][1], STEP_M))
    ]
    upper = across(float(shoulder[0] + 0.25 * (elbow[0] - shoulder[0])))
    trunk_points = vertices[(vertices[:, 1] > crotch_y) & (vertices[:, 1] < underarm_y) & ~is_arm]
    return BodyMeasurements(
        neck_y=float(place["neck"][1]),
        neck_half_width=0.5 * float(np.ptp(neck[:, 0])),
        shoulder_x=float(shoulder[0]),
        underarm_y=underarm_y,
        chest_girth=float(girths[heights > place["spine3"][1] + 0.05].max()),
        waist_y=float(heights[waist]),
        waist_girth=float(girths[waist]),
        hip_y=float(heights[hip]),
        hip_girth=float(girths[hip]),
        crotch_y=crotch_y,
        knee_y=float(place["left_knee"][1]),
        ankle_y=float(place["left_ankle"][1]),
        thigh_girth=tape(leg[leg[:, 0] > 0.0]),
        calf_girth=max(calves),
        elbow_x=float(elbow[0]),
        wrist_x=float(wrist[0]),
        arm_y=float(elbow[1]),
        arm_z=float(elbow[2]),
        arm_girth=tape(upper[:, 1:]),
        wrist_girth=tape(across(float(wrist[0]))[:, 1:]),
        front_z=float(trunk_points[:, 2].max()),
        back_z=float(trunk_points[:, 2].min()),
        heights=heights,
        girths=girths,
    )


# --- sizes -----------------------------------------------------------------------------------------------------------


def in_size(body: BodyMeasurements, size: str) -> BodyMeasurements:
    """Returns the measurements that a pattern of ``size`` is drafted for, where ``body`` has size M.

    Raises ``NotFound`` for a size that is none of ``PATTERN_STEPS``.
    """
    if size not in PATTERN_STEPS:
        raise NotFound(
            "size",
            expected=f"one of {', '.join(PATTERN_STEPS)}",
            got=size,
            cure="Beyond the grade, draft for a body of that size: measure it and make its M.",
        )
    step = PATTERN_STEPS[size]
    if step == 0:
        return body
    grown = {name: getattr(body, name) + step * growth for name, growth in GROWTH_M.items()}
    return replace(body, girths=body.girths + step * GROWTH_M["waist_girth"], **grown)
