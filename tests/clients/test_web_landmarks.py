"""Key points to poses: bones lie on the points, hinges tell twists, hidden points hold, clips come back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.geometry.rigid import bone_transforms, forward_kinematics
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion.retarget import global_rotations
from drape.motion.samples import SAMPLES
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX
from tests.clients.node import answer_of
from tests.clients.people import INDEX, SIGNS, person

# Some thirty products and an arc tangent, whose errors a hinge bent by 15 degrees multiplies by four.
EXACT = 1e-11
# Directions of nose and toes are written to three digits.
WRITTEN = 2e-3
# A thigh of the body leans 1.6 degrees outwards: seen from the side it is shorter by the cosine.
TILTED = 1e-3
TWIST_BENDS = np.radians([5.0, 15.0])
TUCK = 0.2
FPS = 30.0

UNSEEN = [JOINT_INDEX[f"{side}_{name}"] for side in ("left", "right") for name in ("collar", "wrist", "hand", "foot")]
TOLD = [joint for joint in range(JOINT_COUNT) if joint not in UNSEEN]
BONES = [
    (f"{side}_{start}", f"{side}_{end}")
    for side in ("left", "right")
    for start, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]

READ = """
import { checkedPoints } from "./key_points.js";
import { LandmarkPoses } from "./landmarks.js";
const { points, visibility, joints, layout } = input;
const reader = new LandmarkPoses(joints, { layout });
console.log(JSON.stringify(points.map((one, at) => reader.read(checkedPoints(one, visibility?.[at], layout)))));
"""
FILTER = """
import { OneEuro } from "./one_euro.js";
const filter = new OneEuro(input.numbers);
const seen = (one, at) => input.seen?.[at] ?? one.map(() => true);
console.log(JSON.stringify(input.points.map((one, at) => filter.filter(one, 1 / 30, seen(one, at)))));
"""
STREAM = """
import { landmarkSource } from "./landmarks.js";
const source = landmarkSource({ smoothing: input.smoothing });
source.put(input.points[0]);
const early = source.sample();
await source.begin({ body: async () => ({ joints: input.joints, floor_m: -0.9 }) });
const found = input.points.map((points, frame) => {
  source.put(points, undefined, 100 + frame / 30);
  return source.sample();
});
console.log(JSON.stringify({ early, poses: found.map(({ poses }) => poses), trans: found.map(({ trans }) => trans) }));
"""
REFUSALS = """
import { landmarkSource } from "./landmarks.js";
const told = [];
const tell = async (task) => { try { await task(); told.push(""); } catch (error) { told.push(error.message); } };
const body = (joints) => ({ body: async () => ({ joints, floor_m: 0 }) });
const { points: [first], swapped, hidden, line } = input;
await tell(() => landmarkSource({ layout: "openpose" }));
const source = landmarkSource({ smoothing: null });
await tell(() => source.begin(body(input.joints.map(() => [0, 0, 0]))));
await source.begin(body(input.joints));
await tell(() => source.put(first.slice(1), undefined, 1));
await tell(() => source.put(first, [1], 1));
await tell(() => source.put([[NaN, 0, 0], ...first.slice(1)], undefined, 2));
await tell(() => source.put(first.map(() => [0, 0, 0]), undefined, 3));
await tell(() => source.put(line, undefined, 4));
await tell(() => source.put(line, hidden.trunk, 5));
for (let frame = 0; frame < 30; frame++) await tell(() => source.put(swapped, hidden.nose, 6 + frame));
for (let frame = 0; frame < 30; frame++) await tell(() => source.put(swapped, undefined, 50 + frame));
await tell(() => source.put(first, undefined, 90));
console.log(JSON.stringify(told));
"""


def at(name: str, layout: str = "mediapipe") -> int:
    return INDEX[layout][name]


def other_side(name: str) -> str:
    side, _, rest = name.partition("_")
    return {"left": "right_", "right": "left_"}.get(side, f"{side}_" if rest else side) + rest


def hidden(points: np.ndarray, *names: str) -> np.ndarray:
    visibility = np.ones(points.shape[:2])
    visibility[:, [at(name) for name in names]] = np.nextafter(0.5, 0.0)
    return visibility


Reader = Callable[..., np.ndarray]


@pytest.fixture
def read(body: BodyModel, tmp_path: Path) -> Reader:
    """Poses (F, 24, 3) of points (F, N, 3), on the shipped body unless other joints are given."""

    def poses_of(
        points: np.ndarray,
        layout: str = "mediapipe",
        visibility: np.ndarray | None = None,
        joints: np.ndarray | None = None,
    ) -> np.ndarray:
        asked: dict[str, Any] = {"points": points.tolist(), "layout": layout}
        asked["joints"] = (body.rest_joints() if joints is None else joints).tolist()
        asked["visibility"] = None if visibility is None else visibility.tolist()
        return np.reshape(answer_of(READ, asked, tmp_path), (-1, JOINT_COUNT, 3))

    return poses_of


@pytest.fixture
def poses(rng: np.random.Generator) -> np.ndarray:
    return some_poses(rng)


@pytest.fixture
def points(body: BodyModel, poses: np.ndarray) -> np.ndarray:
    return person(body, poses)


def some_poses(rng: np.random.Generator, count: int = 6) -> np.ndarray:
    """Poses (F, 24, 3) of people: everything turned at random, elbows and knees bent."""
    poses = 0.35 * rng.normal(size=(count, JOINT_COUNT, 3))
    poses[:, UNSEEN] = 0.0
    for side, sign in (("left", 1.0), ("right", -1.0)):
        poses[:, JOINT_INDEX[f"{side}_elbow"]] = np.outer(rng.uniform(0.5, 2.0, count), [0.0, -sign, 0.0])
        poses[:, JOINT_INDEX[f"{side}_knee"]] = np.outer(rng.uniform(0.5, 2.0, count), [1.0, 0.0, 0.0])
    return poses


@pytest.mark.parametrize("layout", INDEX)
def test_a_person_in_the_t_pose_is_in_the_t_pose(read: Reader, layout: str, body: BodyModel):
    got = read(person(body, np.zeros((2, JOINT_COUNT, 3)), layout), layout)
    assert_allclose(got, np.zeros((2, JOINT_COUNT, 3)), rtol=0.0, atol=WRITTEN)
    exact = [joint for joint in range(JOINT_COUNT) if not JOINT_NAMES[joint].endswith(("neck", "head", "ankle"))]
    assert_allclose(got[:, exact], np.zeros((2, len(exact), 3)), rtol=0.0, atol=EXACT)


def test_mediapipes_axes_are_turned_into_ours(read: Reader):
    """Somebody before the camera with the left arm forward: x is right in the picture, y down, z away."""
    points = np.zeros((1, 33, 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # A person who faces the camera has the left side at the picture's right.
        for name, place in {
            "ear": (0.08, -0.65, 0.0), "shoulder": (0.18, -0.5, 0.0), "elbow": (0.45, -0.5, 0.0),
            "wrist": (0.7, -0.5, 0.0), "hip": (0.1, 0.0, 0.0), "knee": (0.1, 0.4, 0.0), "ankle": (0.1, 0.8, 0.0),
            "heel": (0.1, 0.85, 0.05), "toe": (0.1, 0.85, -0.15),
        }.items():  # fmt: skip
            points[0, at(f"{side}_{name}")] = np.array(place) * [sign, 1.0, 1.0]
    points[0, at("nose")] = 0.0, -0.62, -0.11
    points[0, at("left_elbow")] = 0.18, -0.5, -0.27
    points[0, at("left_wrist")] = 0.18, -0.5, -0.52
    got = read(points, joints=CANONICAL_JOINTS)[0]
    assert_allclose(got[JOINT_INDEX["left_shoulder"]], [0.0, -np.pi / 2, 0.0], rtol=0.0, atol=EXACT)
    straight = ("pelvis", "spine2", "right_shoulder", "left_elbow", "left_hip", "left_knee")
    assert_allclose(got[[JOINT_INDEX[name] for name in straight]], np.zeros((6, 3)), rtol=0.0, atol=EXACT)


def test_bones_lie_on_the_points(read: Reader, body: BodyModel, points: np.ndarray):
    _, joints = forward_kinematics(rotvec_to_matrix(read(points)), body.rest_joints(), PARENTS)
    for start, end in [*BONES, ("right_hip", "left_hip"), ("right_shoulder", "left_shoulder")]:
        want = (points[:, at(end)] - points[:, at(start)]) * SIGNS["mediapipe"]
        line = joints[:, JOINT_INDEX[end]] - joints[:, JOINT_INDEX[start]]
        unit, want = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (line, want))
        assert_allclose(unit, want, rtol=0.0, atol=EXACT)


def test_hinges_tell_how_upper_arms_and_thighs_are_twisted(read: Reader, body: BodyModel, rng: np.random.Generator):
    """A straight trunk, and limbs of any twist with elbows and knees that bend as hinges: limbs lose nothing."""
    poses = some_poses(rng, 20)
    poses[:, [JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3")]] = 0.0
    got, want = (global_rotations(rotvec_to_matrix(told), PARENTS) for told in (read(person(body, poses)), poses))
    # The chest is a straight trunk's, whatever the pelvis is taken to do below it.
    exact = [*(JOINT_INDEX[start] for start, _ in BONES), JOINT_INDEX["spine3"]]
    assert_allclose(got[:, exact], want[:, exact], rtol=0.0, atol=EXACT)


def test_bent_hips_tilt_the_pelvis_back_by_a_share_and_the_spine_makes_up_for_it(read: Reader, body: BodyModel):
    poses = np.zeros((3, JOINT_COUNT, 3))
    for side, angles in {"left": (1.0, 1.0, -0.4), "right": (1.0, 0.0, -0.4)}.items():
        poses[:, JOINT_INDEX[f"{side}_hip"], 0] = -np.array(angles)
        poses[:, JOINT_INDEX[f"{side}_knee"], 0] = 0.9
    got = read(person(body, poses))
    tilt = -TUCK * np.array([1.0, 0.5, 0.0])
    assert_allclose(got[:, 0], np.outer(tilt, [1.0, 0.0, 0.0]), rtol=0.0, atol=TILTED)
    for joint in ("spine1", "spine2", "spine3"):
        assert_allclose(got[:, JOINT_INDEX[joint]], np.outer(-tilt / 3.0, [1.0, 0.0, 0.0]), rtol=0.0, atol=TILTED)
    assert_allclose(got[:, JOINT_INDEX["left_hip"], 0], [-1.0 - tilt[0], -1.0 - tilt[1], 0.4], rtol=0.0, atol=TILTED)


def test_a_pelvis_whose_knees_are_not_seen_keeps_its_tilt(read: Reader, points: np.ndarray):
    visibility = np.ones(points.shape[:2])
    visibility[:2, at("left_knee")] = 0.0
    visibility[3:, at("right_knee")] = 0.0
    got = rotvec_to_matrix(read(points, visibility=visibility)[:, 0])
    upright = rotvec_to_matrix(read(points, visibility=hidden(points, "left_knee", "right_knee"))[:, 0])
    tilts = matrix_to_rotvec(np.swapaxes(upright, -1, -2) @ got)
    assert_allclose(tilts[:2], np.zeros((2, 3)), rtol=0.0, atol=EXACT)
    assert tilts[2, 0] < -0.01
    assert_allclose(tilts[3:], np.tile(tilts[2], (3, 1)), rtol=0.0, atol=EXACT)


def bent_arm(bend: np.ndarray, twist: float) -> np.ndarray:
    """COCO's points of a T-pose whose left elbow is bent by ``bend`` [rad] (F,), its upper arm twisted by ``twist``."""
    poses = np.zeros((len(bend), JOINT_COUNT, 3))
    poses[:, JOINT_INDEX["left_shoulder"], 0] = twist
    poses[:, JOINT_INDEX["left_elbow"], 1] = -bend
    _, joints = forward_kinematics(rotvec_to_matrix(poses), CANONICAL_JOINTS, PARENTS)
    points = np.zeros((len(bend), 17, 3))
    for name, index in INDEX["coco"].items():
        if name in JOINT_INDEX:
            points[:, index] = joints[:, JOINT_INDEX[name]]
    for name, place in {"left_ear": (0.1, 0.7, 0.0), "right_ear": (-0.1, 0.7, 0.0), "nose": (0.0, 0.7, 0.1)}.items():
        points[:, at(name, "coco")] = place
    return points


def test_twist_grows_smoothly_between_the_two_bends(read: Reader):
    bend = np.radians(np.linspace(0.5, 30.0, 296))
    got = read(bent_arm(bend, 0.8), "coco", joints=CANONICAL_JOINTS)[:, JOINT_INDEX["left_shoulder"]]
    assert_allclose(got[:, 1:], np.zeros((296, 2)), rtol=0.0, atol=EXACT)
    low, high = TWIST_BENDS
    assert_allclose(got[bend <= low, 0], np.zeros((bend <= low).sum()), rtol=0.0, atol=EXACT)
    assert_allclose(got[bend >= high, 0], np.full((bend >= high).sum(), 0.8), rtol=0.0, atol=EXACT)
    steps = np.diff(got[:, 0])
    assert steps.min() > -EXACT
    # A cubic that is at rest at both ends rises by 1.5 over its length at most.
    assert steps.max() <= 1.5 * 0.8 * (bend[1] - bend[0]) / (high - low) + EXACT


def test_bends_and_turns_of_the_trunk_are_spread_evenly(read: Reader, body: BodyModel):
    poses = np.zeros((3, JOINT_COUNT, 3))
    poses[0, [3, 6, 9], 1] = 0.15  # a turn about the upright keeps the line between hips and shoulders nearly
    poses[1, [12, 15], 0] = 0.25
    poses[2, [12, 15], 2] = -0.2
    got = read(person(body, poses))
    assert_allclose(got[1:, [12, 15]], poses[1:, [12, 15]], rtol=0.0, atol=WRITTEN)
    assert np.abs(got[0, [3, 6, 9]] - got[0, 3]).max() < EXACT
    assert np.abs(got[0, [3, 6, 9]] - poses[0, [3, 6, 9]]).max() < 0.02


def test_place_and_size_do_not_matter_and_a_turned_person_has_a_turned_root(read: Reader, points: np.ndarray):
    want = read(points)
    assert_allclose(read(1.3 * points + np.array([3.0, -1.0, 2.0])), want, rtol=0.0, atol=EXACT)
    turn, flip = Rotation.from_rotvec([0.5, 2.0, -0.8]).as_matrix(), np.diag(SIGNS["mediapipe"])
    got = read(points @ (flip @ turn @ flip).T)
    assert_allclose(rotvec_to_matrix(got[:, 0]), turn @ rotvec_to_matrix(want[:, 0]), rtol=0.0, atol=EXACT)
    assert_allclose(got[:, 1:], want[:, 1:], rtol=0.0, atol=EXACT)


def test_a_mirrored_person_is_the_mirrored_pose(read: Reader, points: np.ndarray):
    other = points.copy()
    for name, index in INDEX["mediapipe"].items():
        other[:, at(other_side(name))] = points[:, index] * [-1.0, 1.0, 1.0]
    got, straight = (read(seen, joints=CANONICAL_JOINTS) for seen in (other, points))
    want = straight[:, [JOINT_INDEX[other_side(name)] for name in JOINT_NAMES]] * [1.0, -1.0, -1.0]
    assert_allclose(rotvec_to_matrix(got), rotvec_to_matrix(want), rtol=0.0, atol=EXACT)


def test_points_that_are_not_seen_hold_their_joints(read: Reader, points: np.ndarray):
    visibility = np.ones(points.shape[:2])
    visibility[2:4, at("left_ankle")] = 0.49
    got, want = read(points, visibility=visibility), read(points)
    knee, hip, foot = (JOINT_INDEX[f"left_{name}"] for name in ("knee", "hip", "ankle"))
    assert_allclose(got[2:4, knee], want[[1, 1], knee], rtol=0.0, atol=0.0)
    others = [joint for joint in range(JOINT_COUNT) if joint not in (knee, hip, foot)]
    assert_allclose(got[:, others], want[:, others], rtol=0.0, atol=0.0)
    assert_allclose(got[[0, 1, 4, 5]], want[[0, 1, 4, 5]], rtol=0.0, atol=EXACT)
    nobody = np.zeros(points.shape)  # what detectors give for points that they did not find
    assert_allclose(read(nobody, visibility=np.zeros(points.shape[:2])), nobody[:, :24], rtol=0.0, atol=0.0)


def test_a_hidden_wrist_holds_the_twist_and_not_the_swing(read: Reader, body: BodyModel, points: np.ndarray):
    rest = body.rest_joints()
    visibility = np.ones(points.shape[:2])
    visibility[1:, at("left_wrist")] = 0.0
    got = read(points, visibility=visibility)
    _, joints = forward_kinematics(rotvec_to_matrix(got), rest, PARENTS)
    arm = joints[:, JOINT_INDEX["left_elbow"]] - joints[:, JOINT_INDEX["left_shoulder"]]
    want = points[:, at("left_elbow")] - points[:, at("left_shoulder")]
    assert_allclose(arm, want * SIGNS["mediapipe"], rtol=0.0, atol=EXACT)
    # The least turn keeps a wheel from rolling: what is left of the rotation is the twist about the bone at rest.
    bone = rest[JOINT_INDEX["left_elbow"]] - rest[JOINT_INDEX["left_shoulder"]]
    bone /= np.linalg.norm(bone)
    quaternions = Rotation.from_rotvec(got[:, JOINT_INDEX["left_shoulder"]]).as_quat()
    twist = 2.0 * np.arctan2(quaternions[:, :3] @ bone, quaternions[:, 3])
    assert_allclose(np.exp(1j * twist), np.full(len(twist), np.exp(1j * twist[0])), rtol=0.0, atol=EXACT)


@pytest.fixture
def filtered(tmp_path: Path) -> Reader:
    """Points (F, n, 3) at 30 Hz as the filter gives them; ``seen`` (F, n)."""

    def filter_points(points: np.ndarray, seen: np.ndarray | None = None, **numbers: float) -> np.ndarray:
        told = None if seen is None else seen.tolist()
        return np.array(answer_of(FILTER, {"points": points.tolist(), "seen": told, "numbers": numbers}, tmp_path))

    return filter_points


def test_the_filter_has_the_closed_forms_of_a_low_pass(filtered: Reader):
    """A step leaves a geometric series of the paper's alpha; a ramp of speed v lags by v / (2 pi f_c)."""
    speed, cutoff, beta = 0.7, 1.5, 3.0
    along = np.array([1.0, 0.0, 0.0])
    step = np.ones((100, 1, 1)) * along
    step[0] = 0.0
    left = (1.0 - 1.0 / (1.0 + FPS / (2.0 * np.pi * cutoff))) ** np.arange(100)
    assert_allclose(filtered(step, minCutoff=cutoff, beta=0.0)[:, 0, 0], 1.0 - left, rtol=0.0, atol=1e-12)
    ramp = speed * np.arange(3000)[:, None, None] / FPS * along
    lag = (ramp - filtered(ramp, minCutoff=cutoff, beta=beta))[-1, 0, 0]
    seen = lag * FPS + speed  # the speed seen is that of the point over the filtered one, a step ahead of its place
    assert_allclose(lag, speed / (2.0 * np.pi * (cutoff + beta * seen)), rtol=1e-9, atol=0.0)


def test_the_filter_turns_with_its_points_and_takes_each_by_itself(filtered: Reader, rng: np.random.Generator):
    points = rng.normal(size=(40, 2, 3)).cumsum(axis=0)
    turn = Rotation.random(rng=rng).as_matrix()
    got = filtered(points, beta=0.8)
    assert_allclose(filtered(points @ turn.T, beta=0.8), got @ turn.T, rtol=0.0, atol=1e-11)
    seen = np.ones((40, 2), dtype=bool)
    seen[[0, 1, 4, 5], 1] = False
    back = filtered(points, seen, beta=0.8)
    assert_allclose(back[:, 0], got[:, 0], rtol=0.0, atol=0.0)
    assert_allclose(back[[0, 1, 4, 5], 1], points[[0, 1, 4, 5], 1], rtol=0.0, atol=0.0)
    assert_allclose(back[6:, 1], filtered(points[6:], beta=0.8)[:, 1], rtol=0.0, atol=0.0)


def mean_error_deg(got: np.ndarray, want: np.ndarray, joints: list[int]) -> float:
    turn = np.swapaxes(rotvec_to_matrix(want), -1, -2) @ rotvec_to_matrix(got)
    return float(np.degrees(np.linalg.norm(matrix_to_rotvec(turn), axis=-1))[:, joints].mean())


def test_sample_clips_come_back_from_their_points(read: Reader, filtered: Reader, body: BodyModel):
    clips = [make().resampled(FPS).poses for make in SAMPLES.values()]
    rng, errors = np.random.default_rng(0), {"mediapipe": [], "coco": [], "noisy": []}
    without_feet = [joint for joint in TOLD if joint not in (7, 8)]
    for want in clips:
        points = person(body, want)
        errors["mediapipe"].append(mean_error_deg(read(points), want, TOLD))
        errors["coco"].append(mean_error_deg(read(person(body, want, "coco"), "coco"), want, without_feet))
        noisy = filtered(points + 0.01 * rng.normal(size=points.shape), beta=1.0)
        errors["noisy"].append(mean_error_deg(read(noisy), want, TOLD))
    means = {name: np.average(told, weights=[len(clip) for clip in clips]) for name, told in errors.items()}
    # 2.7 degrees: how collars lift and how the trunk's lean is shared, which points do not tell.
    assert means["mediapipe"] < 3.0 and means["coco"] < 3.0
    assert means["noisy"] < 6.0  # 4.9 degrees, and 6.6 without the filter


def test_a_source_filters_points_then_reads_them_and_the_lower_foot_stands(
    read: Reader, filtered: Reader, body: BodyModel, tmp_path: Path
):
    points = person(body, SAMPLES["squat"]().resampled(8.0).poses)
    asked = {"points": points.tolist(), "joints": body.rest_joints().tolist(), "smoothing": {"beta": 0.8}}
    got = answer_of(STREAM, asked, tmp_path)
    assert got["early"] is None
    found = np.reshape(got["poses"], (-1, JOINT_COUNT, 3))
    assert_allclose(found, read(filtered(points, beta=0.8)), rtol=0.0, atol=1e-9)
    joints = body.rest_joints()
    turns, ways = bone_transforms(rotvec_to_matrix(found), joints, PARENTS)
    low = np.array(got["trans"])[:, 1]
    rises = [(turns[:, one] @ joints[one] + ways[:, one] - joints[one])[:, 1] + low for one in (7, 8)]
    assert_allclose(np.min(rises, axis=0), 0.9, rtol=0.0, atol=1e-6)  # soles are that far below the origin


def test_what_is_no_person_is_refused_in_words(body: BodyModel, tmp_path: Path):
    points = person(body, np.zeros((1, JOINT_COUNT, 3)))
    swapped, line = points[0].copy(), points[0].copy()
    for name, index in INDEX["mediapipe"].items():
        swapped[at(other_side(name))] = points[0, index]
    trunk = ["right_hip", "left_hip", "right_shoulder", "left_shoulder"]
    line[[at(name) for name in trunk]] = np.outer([0.0, 0.2, 0.4, 0.9], [1.0, 0.0, 0.0])
    unseen = {"nose": hidden(points, "nose")[0].tolist(), "trunk": hidden(points, *trunk)[0].tolist()}
    asked = {"points": points.tolist(), "joints": body.rest_joints().tolist(), "swapped": swapped.tolist()}
    told = answer_of(REFUSALS, asked | {"line": line.tolist(), "hidden": unseen}, tmp_path)
    words = ["mediapipe or coco", "apart", "33 points", "33 points", "finite", "apart", "off one line"]
    assert [word for word, said in zip(words, told, strict=False) if word not in said] == []
    assert told[7:-2] == [""] * 60 and "left and right look swapped" in told[-2] and told[-1] == ""
