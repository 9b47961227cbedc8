"""AMASS files: layouts, the up axis, and refusals."""

import io
import zipfile

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.skeleton import PARENTS
from drape.errors import MotionError
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion import amass
from drape.motion.amass import Y_FROM_Z, read_amass
from drape.motion.readers import read_motion
from drape.motion.t_pose import CANONICAL_JOINTS, JOINT_INDEX

EXACT = 1e-12


def write(path, **arrays):
    parts = {"poses": np.zeros((4, 156)), "trans": np.zeros((4, 3)), "mocap_framerate": 120.0} | arrays
    np.savez(path, **{key: value for key, value in parts.items() if value is not None})
    return path


def joints_of(poses, trans):
    _, joints = forward_kinematics(rotvec_to_matrix(poses), CANONICAL_JOINTS, PARENTS)
    return joints + trans[:, None]


def test_body_standing_along_z_stands_along_y_after_reading(tmp_path):
    # In AMASS a standing body's root is turned by 90 degrees about x: SMPL's own y goes to z.
    poses = np.zeros((4, 156))
    poses[:, 0] = np.pi / 2.0
    trans = np.tile([0.3, 0.5, 0.93], (4, 1))
    clip = read_amass(write(tmp_path / "stand.npz", poses=poses, trans=trans))
    joints = joints_of(clip.poses, clip.trans)
    trunk = joints[:, JOINT_INDEX["head"]] - joints[:, JOINT_INDEX["pelvis"]]
    assert_allclose(trunk[:, [0, 2]], np.zeros((4, 2)), rtol=0.0, atol=EXACT)
    assert (trunk[:, 1] > 0.4).all()
    left = joints[:, JOINT_INDEX["left_hip"]] - joints[:, JOINT_INDEX["right_hip"]]
    assert (left[:, 0] > 0.1).all()
    assert_allclose(clip.trans, np.tile([0.3, 0.93, -0.5], (4, 1)), rtol=0.0, atol=EXACT)


@pytest.mark.parametrize(("width", "joints"), [(66, 22), (72, 24), (156, 22), (165, 22)])
def test_reading_turns_the_posed_joints_from_z_up_to_y_up(width, joints, rng, tmp_path):
    flat, trans = 0.5 * rng.normal(size=(4, width)), rng.normal(size=(4, 3))
    clip = read_amass(write(tmp_path / "clip.npz", poses=flat, trans=trans))
    poses = np.zeros((4, 24, 3))
    poses[:, :joints] = flat[:, : 3 * joints].reshape(4, joints, 3)
    assert_allclose(joints_of(clip.poses, clip.trans), joints_of(poses, trans) @ Y_FROM_Z.T, rtol=0.0, atol=EXACT)
    assert_allclose(clip.poses[:, 1:], poses[:, 1:], rtol=0.0, atol=EXACT)


def test_root_and_body_apart_are_the_poses_of_both(rng, tmp_path):
    flat, trans = 0.5 * rng.normal(size=(4, 66)), rng.normal(size=(4, 3))
    apart = {"root_orient": flat[:, :3], "pose_body": flat[:, 3:], "pose_hand": np.zeros((4, 90))}
    clip = read_amass(write(tmp_path / "apart.npz", poses=None, trans=trans, **apart))
    own = read_amass(write(tmp_path / "own.npz", poses=flat, trans=trans))
    np.testing.assert_array_equal(clip.poses, own.poses)
    np.testing.assert_array_equal(clip.trans, own.trans)
    apart["pose_body"] = apart["pose_body"][:3]
    with pytest.raises(MotionError, match=r"apart.npz: pose_body: expected shape \(4, 63\), got shape \(3, 63\)"):
        read_amass(write(tmp_path / "apart.npz", poses=None, trans=trans, **apart))


def test_a_refusal_names_its_file_once(tmp_path):
    with pytest.raises(MotionError) as refused:
        read_amass(write(tmp_path / "clip.npz", mocap_framerate=None))
    assert str(refused.value).count("clip.npz") == 1


def test_three_dimensional_poses_are_taken_as_they_are(rng, tmp_path):
    poses, trans = rng.normal(size=(4, 24, 3)), rng.normal(size=(4, 3))
    clip = read_amass(write(tmp_path / "ours.npz", poses=poses, trans=trans))
    np.testing.assert_array_equal(clip.poses, poses)
    np.testing.assert_array_equal(clip.trans, trans)


def test_the_key_up_overrules_the_layout(rng, tmp_path):
    flat, trans = rng.normal(size=(4, 72)), rng.normal(size=(4, 3))
    plain = read_amass(write(tmp_path / "y.npz", poses=flat, trans=trans, up="y"))
    np.testing.assert_array_equal(plain.poses, flat.reshape(4, 24, 3))
    turned = read_amass(write(tmp_path / "z.npz", poses=flat.reshape(4, 24, 3), trans=trans, up="z"))
    assert_allclose(turned.trans, trans @ Y_FROM_Z.T, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize("key", ["mocap_framerate", "mocap_frame_rate"])
def test_rate_betas_and_name_are_kept(key, tmp_path):
    betas = np.linspace(0.0, 1.0, 16)
    path = write(tmp_path / "walk_01.npz", **{"mocap_framerate": None, key: np.array(100.0), "betas": betas})
    clip = read_motion(path)
    assert clip.fps == 100.0
    assert clip.name == "walk_01"
    assert clip.betas is not None
    assert_allclose(clip.betas, betas, rtol=0.0, atol=EXACT)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"poses": None}, "poses.*an array 'poses'"),
        ({"trans": None}, "trans.*an array 'trans'"),
        ({"mocap_framerate": None}, "frame rate"),
        ({"mocap_framerate": [60.0, 60.0]}, "one number"),
        ({"mocap_framerate": 0.0}, "fps.*positive"),
        ({"poses": np.zeros((4, 63))}, r"got shape \(4, 63\)"),
        ({"poses": np.zeros((4, 52, 3))}, r"got shape \(4, 52, 3\)"),
        ({"poses": np.zeros(4)}, r"got shape \(4,\)"),
        ({"poses": np.zeros((0, 72)), "trans": np.zeros((0, 3))}, "at least one frame"),
        ({"trans": np.zeros((3, 3))}, "one translation per pose"),
        ({"trans": np.full((4, 3), np.nan)}, "trans.*finite"),
        ({"poses": np.full((4, 72), np.inf)}, "poses.*finite"),
        ({"poses": np.full((4, 24, 3), np.nan)}, "poses.*finite"),
        ({"poses": np.full((4, 72), "x")}, "real numbers"),
        ({"betas": np.zeros((2, 10))}, "betas"),
        ({"up": "x"}, "'y' or 'z'"),
        ({"up": 3}, "one string"),
        ({"poses": np.full((4, 72), None)}, "plain array"),
    ],
)
def test_wrong_contents_are_refused_with_the_files_name(change, match, tmp_path):
    with pytest.raises(MotionError, match=match) as refusal:
        read_amass(write(tmp_path / "bad.npz", **change))
    assert refusal.value.name.startswith("bad.npz")


def test_missing_and_broken_files_are_refused(tmp_path):
    with pytest.raises(MotionError, match=r"absent\.npz"):
        read_amass(tmp_path / "absent.npz")
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(MotionError, match="readable npz"):
        read_amass(tmp_path / "text.npz")


def test_every_truncation_is_refused(tmp_path, rng):
    whole = write(tmp_path / "whole.npz", poses=rng.normal(size=(4, 72))).read_bytes()
    for length in range(0, len(whole) - 1, 97):
        (tmp_path / "cut.npz").write_bytes(whole[:length])
        with pytest.raises(MotionError):
            read_amass(tmp_path / "cut.npz")


def rewritten(source, target, name, payload):
    """The archive with one member replaced."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for member in old.namelist():
            new.writestr(member, payload if member == name else old.read(member))
    return target


def test_header_that_declares_more_than_the_file_holds_is_refused_before_it_is_read(tmp_path):
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 72)})
    path = rewritten(write(tmp_path / "clip.npz"), tmp_path / "lie.npz", "poses.npy", stream.getvalue() + b"\0" * 64)
    with pytest.raises(MotionError, match="as its header declares"):
        read_amass(path)


def test_array_larger_than_the_bound_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(amass, "MAX_ARRAY_BYTES", 1000)
    with pytest.raises(MotionError, match="at most 1000 bytes"):
        read_amass(write(tmp_path / "clip.npz"))


def test_bytes_that_are_no_array_are_refused(tmp_path):
    path = rewritten(write(tmp_path / "clip.npz"), tmp_path / "odd.npz", "trans.npy", b"not an array")
    with pytest.raises(MotionError, match="trans"):
        read_amass(path)
