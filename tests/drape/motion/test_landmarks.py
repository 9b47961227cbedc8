"""Poses of key points: bones lie on the points, hinges tell twists, hidden points hold, and clips come back."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.errors import MotionError
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion import key_points, landmarks
from drape.motion.key_points import LAYOUTS
from drape.motion.landmarks import TUCK, TWIST_BENDS, LandmarkPoses, landmark_poses
from drape.motion.one_euro import OneEuro, one_euro
from drape.motion.retarget import global_rotations
from drape.motion.samples import SAMPLES
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX
from tests.drape.motion.people import person, skin_points

# Some thirty products and an arc tangent, whose errors a hinge bent by 15 degrees multiplies by four.
EXACT = 1e-11
# Directions of nose and toes are written to three digits.
WRITTEN = 2e-3
# A thigh of the body leans 1.6 degrees outwards: seen from the side it is shorter by the cosine.
TILTED = 1e-3

UNSEEN = [JOINT_INDEX[f"{side}_{name}"] for side in ("left", "right") for name in ("collar", "wrist", "hand", "foot")]
TOLD = [joint for joint in range(JOINT_COUNT) if joint not in UNSEEN]
BONES = [
    (f"{side}_{start}", f"{side}_{end}")
    for side in ("left", "right")
    for start, end in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))
]


def angles_deg(got, want):
    """Angles [degrees] (F, 24) between poses (F, 24, 3)."""
    turn = np.swapaxes(rotvec_to_matrix(want), -1, -2) @ rotvec_to_matrix(got)
    return np.degrees(np.linalg.norm(matrix_to_rotvec(turn), axis=-1))


def at(layout, name):
    return LAYOUTS[layout].index[name]


def some_poses(rng, count=6):
    """Poses (F, 24, 3) of people: everything turned at random, elbows and knees bent."""
    poses = 0.35 * rng.normal(size=(count, JOINT_COUNT, 3))
    poses[:, UNSEEN] = 0.0
    for side, sign in (("left", 1.0), ("right", -1.0)):
        poses[:, JOINT_INDEX[f"{side}_elbow"]] = np.outer(rng.uniform(0.5, 2.0, count), [0.0, -sign, 0.0])
        poses[:, JOINT_INDEX[f"{side}_knee"]] = np.outer(rng.uniform(0.5, 2.0, count), [1.0, 0.0, 0.0])
    return poses


@pytest.fixture
def poses(rng):
    return some_poses(rng)


@pytest.fixture
def points(body, poses):
    return person(body, poses, "mediapipe")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_person_in_the_t_pose_is_in_the_t_pose(layout, body):
    still = person(body, np.zeros((2, JOINT_COUNT, 3)), layout)
    got = landmark_poses(still, layout=layout, rest_joints=body.rest_joints())
    assert_allclose(got, np.zeros((2, JOINT_COUNT, 3)), rtol=0.0, atol=WRITTEN)
    exact = [joint for joint in range(JOINT_COUNT) if not JOINT_NAMES[joint].endswith(("neck", "head", "ankle"))]
    assert_allclose(got[:, exact], np.zeros((2, len(exact), 3)), rtol=0.0, atol=EXACT)


def test_mediapipes_axes_are_turned_into_ours():
    """Somebody before the camera with the left arm forward: x is right in the picture, y down, z away."""
    points = np.zeros((1, 33, 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        # A person who faces the camera has the left side at the picture's right.
        for name, place in {
            "ear": (0.08, -0.65, 0.0), "shoulder": (0.18, -0.5, 0.0), "elbow": (0.45, -0.5, 0.0),
            "wrist": (0.7, -0.5, 0.0), "hip": (0.1, 0.0, 0.0), "knee": (0.1, 0.4, 0.0), "ankle": (0.1, 0.8, 0.0),
            "heel": (0.1, 0.85, 0.05), "toe": (0.1, 0.85, -0.15),
        }.items():  # fmt: skip
            points[0, at("mediapipe", f"{side}_{name}")] = np.array(place) * [sign, 1.0, 1.0]
    points[0, at("mediapipe", "nose")] = 0.0, -0.62, -0.11
    points[0, at("mediapipe", "left_elbow")] = 0.18, -0.5, -0.27
    points[0, at("mediapipe", "left_wrist")] = 0.18, -0.5, -0.52
    got = landmark_poses(points)[0]
    assert_allclose(got[JOINT_INDEX["left_shoulder"]], [0.0, -np.pi / 2, 0.0], rtol=0.0, atol=EXACT)
    others = [
        JOINT_INDEX[name] for name in ("pelvis", "spine2", "right_shoulder", "left_elbow", "left_hip", "left_knee")
    ]
    assert_allclose(got[others], np.zeros((6, 3)), rtol=0.0, atol=EXACT)


def test_bones_lie_on_the_points(body, poses, points):
    got = landmark_poses(points, rest_joints=body.rest_joints())
    _, joints = forward_kinematics(rotvec_to_matrix(got), body.rest_joints(), PARENTS)
    for start, end in [*BONES, ("right_hip", "left_hip"), ("right_shoulder", "left_shoulder")]:
        want = (points[:, at("mediapipe", end)] - points[:, at("mediapipe", start)]) * [1.0, -1.0, -1.0]
        line = joints[:, JOINT_INDEX[end]] - joints[:, JOINT_INDEX[start]]
        unit, want = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (line, want))
        assert_allclose(unit, want, rtol=0.0, atol=EXACT)


def test_hinges_tell_how_upper_arms_and_thighs_are_twisted(body, rng):
    """A straight trunk, and limbs of any twist with elbows and knees that bend as hinges: limbs lose nothing."""
    poses = some_poses(rng, 20)
    poses[:, [JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3")]] = 0.0
    got = landmark_poses(person(body, poses, "mediapipe"), rest_joints=body.rest_joints())
    got, want = (global_rotations(rotvec_to_matrix(told), PARENTS) for told in (got, poses))
    limbs = [JOINT_INDEX[start] for start, _ in BONES]
    assert_allclose(got[:, limbs], want[:, limbs], rtol=0.0, atol=EXACT)
    # The chest is a straight trunk's, whatever the pelvis is taken to do below it.
    assert_allclose(got[:, JOINT_INDEX["spine3"]], want[:, JOINT_INDEX["spine3"]], rtol=0.0, atol=EXACT)


def test_bent_hips_tilt_the_pelvis_back_by_a_share_and_the_spine_makes_up_for_it(body):
    poses = np.zeros((3, JOINT_COUNT, 3))
    for side, angles in {"left": (1.0, 1.0, -0.4), "right": (1.0, 0.0, -0.4)}.items():
        poses[:, JOINT_INDEX[f"{side}_hip"], 0] = -np.array(angles)
        poses[:, JOINT_INDEX[f"{side}_knee"], 0] = 0.9
    got = landmark_poses(person(body, poses, "mediapipe"), rest_joints=body.rest_joints())
    tilt = -TUCK * np.array([1.0, 0.5, 0.0])
    assert_allclose(got[:, 0], np.outer(tilt, [1.0, 0.0, 0.0]), rtol=0.0, atol=TILTED)
    for joint in ("spine1", "spine2", "spine3"):
        assert_allclose(got[:, JOINT_INDEX[joint]], np.outer(-tilt / 3.0, [1.0, 0.0, 0.0]), rtol=0.0, atol=TILTED)
    assert_allclose(got[:, JOINT_INDEX["left_hip"], 0], [-1.0 - tilt[0], -1.0 - tilt[1], 0.4], rtol=0.0, atol=TILTED)


def test_a_pelvis_whose_knees_are_not_seen_keeps_its_tilt(points, monkeypatch):
    visibility = np.ones(points.shape[:2])
    visibility[:2, at("mediapipe", "left_knee")] = 0.0
    visibility[3:, at("mediapipe", "right_knee")] = 0.0
    got = rotvec_to_matrix(landmark_poses(points, visibility=visibility)[:, 0])
    monkeypatch.setattr(landmarks, "TUCK", 0.0)
    upright = rotvec_to_matrix(landmark_poses(points)[:, 0])
    tilts = matrix_to_rotvec(np.swapaxes(upright, -1, -2) @ got)
    assert_allclose(tilts[:2], np.zeros((2, 3)), rtol=0.0, atol=EXACT)
    assert tilts[2, 0] < -0.01
    assert_allclose(tilts[3:], np.tile(tilts[2], (3, 1)), rtol=0.0, atol=EXACT)


def bent_arm(bend, twist):
    """Points of a T-pose whose left elbow is bent by ``bend`` [rad] (F,), its upper arm twisted by ``twist``."""
    poses = np.zeros((len(bend), JOINT_COUNT, 3))
    poses[:, JOINT_INDEX["left_shoulder"], 0] = twist
    poses[:, JOINT_INDEX["left_elbow"], 1] = -bend
    _, joints = forward_kinematics(rotvec_to_matrix(poses), CANONICAL_JOINTS, PARENTS)
    points = np.zeros((len(bend), 17, 3))
    for name, index in LAYOUTS["coco"].index.items():
        if name in JOINT_INDEX:
            points[:, index] = joints[:, JOINT_INDEX[name]]
    points[:, at("coco", "left_ear"), :] = 0.1, 0.7, 0.0
    points[:, at("coco", "right_ear"), :] = -0.1, 0.7, 0.0
    points[:, at("coco", "nose"), :] = 0.0, 0.7, 0.1
    return points


def test_twist_grows_smoothly_between_the_two_bends():
    bend = np.radians(np.linspace(0.5, 30.0, 296))
    got = landmark_poses(bent_arm(bend, 0.8), layout="coco")[:, JOINT_INDEX["left_shoulder"]]
    assert_allclose(got[:, 1:], np.zeros((296, 2)), rtol=0.0, atol=EXACT)
    low, high = TWIST_BENDS
    assert_allclose(got[bend <= low, 0], np.zeros((bend <= low).sum()), rtol=0.0, atol=EXACT)
    assert_allclose(got[bend >= high, 0], np.full((bend >= high).sum(), 0.8), rtol=0.0, atol=EXACT)
    steps = np.diff(got[:, 0])
    assert steps.min() > -EXACT
    # A cubic that is at rest at both ends rises by 1.5 over its length at most.
    assert steps.max() <= 1.5 * 0.8 * (bend[1] - bend[0]) / (high - low) + EXACT


def test_bends_and_turns_of_the_trunk_are_spread_evenly(body):
    poses = np.zeros((3, JOINT_COUNT, 3))
    poses[0, [3, 6, 9], 1] = 0.15  # a turn about the upright keeps the line between hips and shoulders nearly
    poses[1, [12, 15], 0] = 0.25
    poses[2, [12, 15], 2] = -0.2
    got = landmark_poses(person(body, poses, "mediapipe"), rest_joints=body.rest_joints())
    assert_allclose(got[1:, [12, 15]], poses[1:, [12, 15]], rtol=0.0, atol=WRITTEN)
    assert np.abs(got[0, [3, 6, 9]] - got[0, 3]).max() < EXACT
    assert np.abs(got[0, [3, 6, 9]] - poses[0, [3, 6, 9]]).max() < 0.02


def test_the_place_and_the_size_of_a_person_do_not_matter(points):
    want = landmark_poses(points)
    assert_allclose(landmark_poses(points + np.array([3.0, -1.0, 2.0])), want, rtol=0.0, atol=EXACT)
    assert_allclose(landmark_poses(1.3 * points), want, rtol=0.0, atol=EXACT)


def test_a_turned_person_is_the_same_pose_with_a_turned_root(points):
    turn = Rotation.from_rotvec([0.5, 2.0, -0.8]).as_matrix()
    flip = np.diag([1.0, -1.0, -1.0])
    want, got = landmark_poses(points), landmark_poses(points @ (flip @ turn @ flip).T)
    assert_allclose(rotvec_to_matrix(got[:, 0]), turn @ rotvec_to_matrix(want[:, 0]), rtol=0.0, atol=EXACT)
    assert_allclose(got[:, 1:], want[:, 1:], rtol=0.0, atol=EXACT)


def test_a_mirrored_person_is_the_mirrored_pose(points):
    names = {index: name for name, index in LAYOUTS["mediapipe"].index.items()}
    swapped = {"left": "right", "right": "left"}

    def mirrored(name):
        side, _, rest = name.partition("_")
        return f"{swapped[side]}_{rest}" if side in swapped else name

    other = points.copy()
    for index, name in names.items():
        other[:, at("mediapipe", mirrored(name))] = points[:, index] * [-1.0, 1.0, 1.0]
    order = [JOINT_INDEX[mirrored(name)] for name in JOINT_NAMES]
    want = landmark_poses(points)[:, order] * [1.0, -1.0, -1.0]
    assert_allclose(rotvec_to_matrix(landmark_poses(other)), rotvec_to_matrix(want), rtol=0.0, atol=EXACT)


def test_left_and_right_that_are_swapped_are_told(points):
    swapped = points.copy()
    for name, index in LAYOUTS["mediapipe"].index.items():
        side, _, rest = name.partition("_")
        if side in ("left", "right"):
            swapped[:, at("mediapipe", f"{'right' if side == 'left' else 'left'}_{rest}")] = points[:, index]
    with pytest.raises(MotionError, match="left and right look swapped"):
        landmark_poses(swapped)
    landmark_poses(swapped, visibility=hidden(points, "nose"))
    stream = LandmarkPoses()
    for _ in range(2):
        for number in range(landmarks.TOLD_AFTER - 1):
            stream(swapped[number % len(swapped)], dt_s=1 / 30)
        with pytest.raises(MotionError, match="left and right look swapped"):
            stream(swapped[0], dt_s=1 / 30)
    for number in range(2 * landmarks.TOLD_AFTER):
        stream(points[number % len(points)], dt_s=1 / 30)


def hidden(points, *names):
    visibility = np.ones(points.shape[:2])
    for name in names:
        visibility[:, at("mediapipe", name)] = np.nextafter(key_points.VISIBLE, 0.0)
    return visibility


def test_points_that_are_not_seen_hold_their_joints(points):
    visibility = np.ones(points.shape[:2])
    visibility[2:4, at("mediapipe", "left_ankle")] = 0.49
    got, want = landmark_poses(points, visibility=visibility), landmark_poses(points)
    knee, hip, foot = (JOINT_INDEX[f"left_{name}"] for name in ("knee", "hip", "ankle"))
    assert_allclose(got[2:4, knee], want[[1, 1], knee], rtol=0.0, atol=0.0)
    others = [joint for joint in range(JOINT_COUNT) if joint not in (knee, hip, foot)]
    assert_allclose(got[:, others], want[:, others], rtol=0.0, atol=0.0)
    assert_allclose(got[[0, 1, 4, 5]], want[[0, 1, 4, 5]], rtol=0.0, atol=EXACT)


def test_a_hidden_wrist_holds_the_twist_and_not_the_swing(body, points):
    rest = body.rest_joints()
    visibility = np.ones(points.shape[:2])
    visibility[1:, at("mediapipe", "left_wrist")] = 0.0
    got = landmark_poses(points, visibility=visibility, rest_joints=rest)
    _, joints = forward_kinematics(rotvec_to_matrix(got), rest, PARENTS)
    arm = joints[:, JOINT_INDEX["left_elbow"]] - joints[:, JOINT_INDEX["left_shoulder"]]
    want = points[:, at("mediapipe", "left_elbow")] - points[:, at("mediapipe", "left_shoulder")]
    assert_allclose(arm, want * [1.0, -1.0, -1.0], rtol=0.0, atol=EXACT)
    # The least turn keeps a wheel from rolling: what is left of the rotation is the twist about the bone at rest.
    bone = rest[JOINT_INDEX["left_elbow"]] - rest[JOINT_INDEX["left_shoulder"]]
    bone /= np.linalg.norm(bone)
    quaternions = Rotation.from_rotvec(got[:, JOINT_INDEX["left_shoulder"]]).as_quat()
    twist = 2.0 * np.arctan2(quaternions[:, :3] @ bone, quaternions[:, 3])
    assert_allclose(np.exp(1j * twist), np.full(len(twist), np.exp(1j * twist[0])), rtol=0.0, atol=EXACT)


def test_somebody_who_is_not_seen_stands_in_the_t_pose(points):
    nobody = np.zeros(points.shape)  # what detectors give for points that they did not find
    got = landmark_poses(nobody, visibility=np.zeros(points.shape[:2]))
    assert_allclose(got, np.zeros(got.shape), rtol=0.0, atol=0.0)
    assert landmark_poses(points[:0]).shape == (0, JOINT_COUNT, 3)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_stream_gives_the_poses_of_the_clip(layout, body, poses, rng):
    points = person(body, poses, layout)
    visibility = rng.uniform(0.3, 1.0, points.shape[:2])
    stream = LandmarkPoses(layout=layout, rest_joints=body.rest_joints())
    got = np.stack([stream(p, dt_s=0.03, visibility=v) for p, v in zip(points, visibility, strict=True)])
    want = landmark_poses(points, layout=layout, visibility=visibility, rest_joints=body.rest_joints())
    assert_allclose(got, want, rtol=0.0, atol=EXACT)


def test_a_stream_smooths_the_points_before_they_are_read(points):
    stream = LandmarkPoses(smoothing=OneEuro(beta=0.5))
    got = np.stack([stream(sample, dt_s=1.0 / 30.0) for sample in points])
    assert_allclose(got, landmark_poses(one_euro(points, fps=30.0, beta=0.5)), rtol=0.0, atol=EXACT)


def test_a_point_that_was_hidden_is_not_smoothed_from_where_it_was_guessed(points):
    stream, name = LandmarkPoses(smoothing=OneEuro()), "left_wrist"
    guessed = np.tile(points[0], (2, 1, 1))
    guessed[0, at("mediapipe", name)] += 5.0
    stream(guessed[0], dt_s=0.03, visibility=hidden(guessed, name)[0])
    assert_allclose(stream(guessed[1], dt_s=0.03), landmark_poses(points[:1])[0], rtol=0.0, atol=EXACT)


def test_a_refused_sample_leaves_the_poses_of_a_stream(points):
    stream = LandmarkPoses()
    stream(points[0], dt_s=0.03)
    with pytest.raises(MotionError, match="apart"):
        stream(np.zeros((33, 3)), dt_s=0.03)
    held = stream(np.zeros((33, 3)), dt_s=0.03, visibility=np.zeros(33))
    assert_allclose(held, landmark_poses(points[:1])[0], rtol=0.0, atol=EXACT)


@pytest.fixture(scope="module")
def clips():
    return {name: make().resampled(30.0).poses for name, make in SAMPLES.items()}


@pytest.mark.parametrize(("layout", "told"), [("mediapipe", TOLD), ("coco", [j for j in TOLD if j not in (7, 8)])])
def test_sample_clips_come_back_from_their_points(layout, told, body, clips):
    errors = [
        angles_deg(landmark_poses(person(body, poses, layout), layout=layout, rest_joints=body.rest_joints()), poses)
        for poses in clips.values()
    ]
    # 2.7 degrees: how collars lift and how the trunk's lean is shared, which points do not tell.
    assert np.concatenate(errors)[:, told].mean() < 3.0


def test_sample_clips_come_back_from_noisy_points(body, clips):
    rng, errors = np.random.default_rng(0), []
    for poses in clips.values():
        points = person(body, poses, "mediapipe")
        noisy = one_euro(points + 0.01 * rng.normal(size=points.shape), fps=30.0, beta=1.0)
        errors.append(angles_deg(landmark_poses(noisy, rest_joints=body.rest_joints()), poses))
    # 4.9 degrees, and 6.6 without the filter.
    assert np.concatenate(errors)[:, TOLD].mean() < 6.0


def test_toes_and_noses_are_those_of_the_body(body):
    skin = {name: place for name, (_, place) in skin_points(body).items()}
    assert skin["nose"][2] > skin["left_ear"][2]
    assert skin["left_ear"][0] > 0.05 > -0.05 > skin["right_ear"][0]
    assert skin["left_toe"][2] > skin["left_heel"][2] + 0.2


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"points": np.zeros((1, 17, 3))}, r"landmarks: expected shape \(any, 33, 3\)"),
        ({"points": np.full((1, 33, 3), np.nan)}, "landmarks: expected finite"),
        ({"visibility": np.ones((1, 17))}, "visibility: expected shape"),
        ({"visibility": np.full((1, 33), np.nan)}, "visibility: expected finite"),
        ({"layout": "openpose"}, "layout: expected 'mediapipe' or 'coco', got 'openpose'"),
        (
            {"points": np.zeros((1, 33, 3))},
            "landmarks of frame 0: expected right_hip and left_hip apart, got one place",
        ),
        ({"rest_joints": np.zeros((22, 3))}, "rest_joints: expected shape"),
        ({"rest_joints": np.full((24, 3), np.inf)}, "rest_joints: expected finite"),
        ({"rest_joints": np.zeros((24, 3))}, "rest_joints of frame 0: expected right_hip and left_hip apart"),
    ],
)
def test_what_is_no_person_is_refused(change, match, body):
    given = {"points": person(body, np.zeros((1, 24, 3)), "mediapipe")} | change
    with pytest.raises(MotionError, match=match):
        landmark_poses(given.pop("points"), **given)


def test_people_folded_to_a_line_are_refused_with_the_frame(points):
    points = points.copy()
    trunk = ["right_hip", "left_hip", "right_shoulder", "left_shoulder"]
    points[3, [at("mediapipe", name) for name in trunk]] = np.outer([0.0, 0.2, 0.4, 0.9], [1.0, 0.0, 0.0])
    with pytest.raises(MotionError, match=r"landmarks of frame 3: expected left_hip, right_hip, .* off one line"):
        landmark_poses(points)
    assert np.isfinite(landmark_poses(points, visibility=hidden(points, *trunk))).all()


def test_a_stream_of_an_unknown_layout_or_body_is_refused_at_once():
    with pytest.raises(MotionError, match="layout"):
        LandmarkPoses(layout="blaze")
    with pytest.raises(MotionError, match="rest_joints"):
        LandmarkPoses(rest_joints=np.zeros((24, 3)))
