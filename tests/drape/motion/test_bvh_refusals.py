"""BVH files that are refused: the line is named, and what was expected there."""

import numpy as np
import pytest

from drape.errors import MotionError, TooLarge
from drape.motion import bvh
from drape.motion.bvh import read_bvh
from drape.motion.readers import read_motion
from tests.drape.motion.bvh_setup import local, root, wrote
from tests.drape.motion.motion_files import BODY, BODY_PARENTS, scheme_names, t_pose_offsets

__all__ = ["local", "root", "wrote"]  # fixtures


@pytest.fixture
def whole(wrote):
    return wrote().read_text()


def refusal_of(tmp_path, content):
    (tmp_path / "bad.bvh").write_text(content)
    with pytest.raises(MotionError) as refusal:
        read_bvh(tmp_path / "bad.bvh")
    return str(refusal.value)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("HIERARCHY\n", "", "line 1: expected HIERARCHY"),
        ("ROOT Hips", "BONE Hips", "line 2"),
        ("MOTION\n", "", "Frames"),
        ("Frames: 5", "Frames: 6", "6 frames, as declared"),
        ("Frames: 5", "Frames: 1000000000000", "frames, as declared"),
        ("Frames: 5", "Frames: 4", "4 frames, as declared"),
        ("Frames: 5", "Frames: 0", "1 or more"),
        ("Frames: 5", "Frames: five", "numbers for Frames:"),
        ("Frames: 5", "Count: 5", "'Frames:'"),
        ("Frame Time: 0.0", "Frame Time: -0.0", "positive frame time"),
        ("CHANNELS 6", "CHANNELS 5", "CHANNELS, their count"),
        ("CHANNELS 6 Xposition", "CHANNELS 6 Xscale", "distinct channels"),
        ("CHANNELS 6 Xposition", "CHANNELS 6 Yposition", "distinct channels"),
        ("OFFSET 0.000000000", "OFFSET nan", "line 4: expected finite"),
        ("OFFSET 0.000000000", "OFFSET", "3 numbers for OFFSET"),
        ("\tOFFSET 0.000000000 0.000000000 0.000000000\n", "", "an OFFSET of joint 'Hips'"),
        ("}\nMOTION", "MOTION", "closed before MOTION"),
        ("}\nMOTION", "}\n}\nMOTION", "too many"),
        ("}\nMOTION", "}\nROOT Other\nMOTION", "one ROOT"),
        ("}\nMOTION", "}\nJOINT Other\nMOTION", "inside a joint's braces"),
        ("}\nMOTION", "}\n{\nMOTION", "a joint's name before"),
    ],
)
def test_ill_formed_files_are_refused_with_the_line(old, new, match, whole, tmp_path):
    assert old in whole
    message = refusal_of(tmp_path, whole.replace(old, new, 1))
    assert "bad.bvh, line" in message
    assert match in message


def test_nan_in_a_frame_is_refused_with_its_line(whole, tmp_path):
    lines = whole.splitlines()
    lines[-2] = lines[-2].replace(lines[-2].split()[7], "nan", 1)
    assert f"line {len(lines) - 1}: expected finite" in refusal_of(tmp_path, "\n".join(lines))


def test_more_frames_than_are_taken_are_refused_before_they_are_parsed(whole, tmp_path):
    path = tmp_path / "long.bvh"
    path.write_text("\n".join([*whole.splitlines()[:-5], *["nothing"] * 5]))
    with pytest.raises(TooLarge, match="at most 4 frames, got 5"):
        read_motion(path, most_frames=4)
    with pytest.raises(MotionError, match="numbers for a frame"):
        read_motion(path, most_frames=5)


def test_every_truncation_is_refused(whole, tmp_path):
    lines = whole.splitlines(keepends=True)
    for count in range(0, len(lines), 7):
        refusal_of(tmp_path, "".join(lines[:count]))
    refusal_of(tmp_path, whole[: whole.rindex(" ")])


def test_file_without_joints_is_refused(tmp_path):
    assert "a ROOT" in refusal_of(tmp_path, "HIERARCHY\nMOTION\nFrames: 1\nFrame Time: 0.01\n")
    assert "after MOTION" in refusal_of(tmp_path, "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n}\nMOTION\n")


def test_too_few_joints_are_refused(whole, tmp_path):
    assert "no left_knee" in refusal_of(tmp_path, whole.replace("LeftLeg", "LeftSomething"))


def test_trunk_without_joints_is_refused(wrote):
    joints = [joint for joint in range(22) if not BODY[joint].startswith("spine")]
    names = [scheme_names("lafan")[joint] for joint in joints]
    parents = tuple(joints.index(BODY_PARENTS[j]) if BODY_PARENTS[j] in joints else min(j, 1) - 1 for j in joints)
    still = np.tile(np.eye(3), (1, len(joints), 1, 1))
    path = wrote(names=names, parents=parents, offsets=t_pose_offsets()[joints], turns=still, places=np.zeros((1, 3)))
    with pytest.raises(MotionError, match="between the pelvis and the arms"):
        read_bvh(path)


def test_rest_pose_without_extent_is_refused(wrote):
    offsets = t_pose_offsets()
    offsets[[1, 2]] = 0.0
    with pytest.raises(MotionError, match="hips beside a trunk"):
        read_bvh(wrote(offsets=offsets))


def test_bounds_hold(whole, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(bvh, "MAX_JOINT_COUNT", 10)
        assert "at most 10 joints" in refusal_of(tmp_path, whole)
    monkeypatch.setattr(bvh, "MAX_FILE_BYTES", 100)
    assert "at most 100 bytes" in refusal_of(tmp_path, whole)


def test_absent_binary_and_unknown_files_are_refused(tmp_path):
    with pytest.raises(MotionError, match="readable file"):
        read_bvh(tmp_path / "absent.bvh")
    (tmp_path / "noise.bvh").write_bytes(bytes(range(256)) * 20)
    with pytest.raises(MotionError, match="HIERARCHY"):
        read_bvh(tmp_path / "noise.bvh")
    with pytest.raises(MotionError, match=r"expected a motion file: .*\.bvh, .*, got suffix '\.amc'"):
        read_motion(tmp_path / "02_01.amc")
