"""ASF/AMC files: known rotations come back; refusals name the line."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.errors import MotionError
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.asf_amc import read_amc
from drape.motion.readers import read_motion
from drape.motion.skeleton import JOINT_INDEX
from tests.drape.motion.motion_files import ASF_BONES, ASF_UNIT, amc_text, asf_text

WRITTEN = 1e-8
FRAME_COUNT = 4


@pytest.fixture
def case(rng, tmp_path):
    """A pair of files, and the rotations that they hold by SMPL joint."""
    axes = {name: rng.uniform(-40.0, 40.0, 3) for name in ASF_BONES}
    angles, want = {}, {}
    for name, (*_, dof, joint) in ASF_BONES.items():
        if not dof:
            continue
        values = rng.uniform(-50.0, 50.0, (FRAME_COUNT, len(dof.split())))
        full = np.zeros((FRAME_COUNT, 3))
        full[:, ["xyz".index(word[1]) for word in dof.split()]] = values
        # scipy's lower case turns about fixed axes, the first first: Acclaim's convention.
        frame = Rotation.from_euler("xyz", axes[name], degrees=True).as_matrix()
        angles[name] = values
        want[joint] = frame @ Rotation.from_euler("xyz", full, degrees=True).as_matrix() @ frame.T
    root, root_deg = rng.normal(size=(FRAME_COUNT, 3)), rng.uniform(-80.0, 80.0, (FRAME_COUNT, 3))
    want["pelvis"] = Rotation.from_euler("xyz", root_deg, degrees=True).as_matrix()
    (tmp_path / "02.asf").write_text(asf_text(axes))
    (tmp_path / "02_01.amc").write_text(amc_text(root / ASF_UNIT, root_deg, angles))
    return tmp_path / "02_01.amc", want, root


def test_rotations_and_metres_come_back(case):
    path, want, root = case
    clip = read_motion(path)
    for joint, rotation in want.items():
        assert_allclose(
            rotvec_to_matrix(clip.poses[:, JOINT_INDEX[joint]]), rotation, err_msg=joint, rtol=0.0, atol=WRITTEN
        )
    assert_allclose(clip.poses[:, 22:], np.zeros((FRAME_COUNT, 2, 3)), rtol=0.0, atol=WRITTEN)
    assert_allclose(clip.trans, root, rtol=0.0, atol=WRITTEN)
    assert clip.fps == 120.0
    assert clip.name == "02_01"


def test_rate_unit_and_skeleton_may_be_given(case, tmp_path):
    path, _, root = case
    (tmp_path / "02.asf").rename(tmp_path / "other.skeleton")
    clip = read_amc(path, asf=tmp_path / "other.skeleton", fps=60.0, metres_per_unit=1.1 * ASF_UNIT)
    assert clip.fps == 60.0
    assert_allclose(clip.trans, 1.1 * root, rtol=0.0, atol=WRITTEN)


def test_radians_mean_the_same_as_degrees(case):
    path, _, _ = case
    want = read_amc(path)
    lines = []
    for line in path.read_text().splitlines():
        name, *words = line.split()
        if name == ":DEGREES":
            name = ":RADIANS"
        skip = 3 if name == "root" else 0
        if name in (*ASF_BONES, "root"):
            words = words[:skip] + [f"{np.radians(float(word)):.12f}" for word in words[skip:]]
        lines.append(" ".join([name, *words]))
    path.write_text("\n".join(lines))
    assert_allclose(rotvec_to_matrix(read_amc(path).poses), rotvec_to_matrix(want.poses), rtol=0.0, atol=WRITTEN)


def test_root_place_and_orientation_of_the_skeleton_are_added(case):
    path, want, root = case
    asf = path.with_name("02.asf")
    moved = (
        asf.read_text().replace("position 0 0 0", "position 1 2 3").replace("orientation 0 0 0", "orientation 0 90 0")
    )
    asf.write_text(moved)
    clip = read_amc(path)
    assert_allclose(clip.trans, root + ASF_UNIT * np.array([1.0, 2.0, 3.0]), rtol=0.0, atol=WRITTEN)
    turn = Rotation.from_euler("y", 90.0, degrees=True).as_matrix()
    assert_allclose(rotvec_to_matrix(clip.poses[:, 0]), turn @ want["pelvis"], rtol=0.0, atol=WRITTEN)


def test_skeleton_must_be_beside_the_file(case):
    path, _, _ = case
    asf = path.with_name("02.asf")
    (path.with_name("03.asf")).write_text(asf.read_text())
    assert read_amc(path).frame_count == FRAME_COUNT  # 02.asf fits the name
    asf.rename(path.with_name("04.asf"))
    with pytest.raises(MotionError, match="2 other ASF files"):
        read_amc(path)
    path.with_name("03.asf").unlink()
    assert read_amc(path).frame_count == FRAME_COUNT  # the only one
    path.with_name("04.asf").unlink()
    with pytest.raises(MotionError, match="no ASF file"):
        read_amc(path)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("length 0.45", "length nan", "finite numbers"),
        ("length 0.45", "length 0", "positive unit of length"),
        ("length 0.45", "length 45", "legs of"),
        ("angle deg", "angle gon", "deg or rad"),
        ("order TX TY TZ RX RY RZ", "order TX TY TZ RX RY RQ", "degrees of freedom"),
        ("axis XYZ", "axis XYY", "order of axes"),
        ("position 0 0 0", "position 0 0", "3 numbers"),
        ("orientation 0 0 0", "orientation 0 0 up", "numbers for the root's orientation"),
        ("name lfemur", "name lhipjoint", "a new name for each bone"),
        ("name lfemur", "name root", "a new name for each bone"),
        ("name lfemur", "", "name, direction and length"),
        ("  end\n  begin\n", "  begin\n", "'end' before the next 'begin'"),
        (":bonedata\n  begin\n", ":bonedata\n", "'begin'"),
        ("dof rx ry rz", "dof rx rx rz", "degrees of freedom"),
        ("lfemur ltibia", "lfemur ltibia ltibia", "one parent per bone"),
        ("lfemur ltibia", "lfemur shin", "bones of :bonedata"),
        ("    lfemur ltibia\n", "", "every bone below root"),
        ("name ltibia", "name lshin", "bones of :bonedata"),
    ],
)
def test_ill_formed_skeletons_are_refused(old, new, match, case):
    path, _, _ = case
    asf = path.with_name("02.asf")
    text = asf.read_text()
    assert old in text
    asf.write_text(text.replace(old, new, 1))
    with pytest.raises(MotionError, match=match):
        read_amc(path)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("\nroot ", "\nroof ", "each bone of the skeleton once"),
        ("\nltibia ", "\nltibia 1.0 ", "1 numbers for ltibia"),
        ("\nltibia ", "\nltibia x", "numbers for ltibia"),
        ("\n1\n", "\n", "a frame number"),
        ("\nlfemur ", "\nltibia ", "3 numbers|once|1 numbers"),
        (":DEGREES\n", ":DEGREES\n7\n", "every bone in frame 1"),
    ],
)
def test_ill_formed_motions_are_refused_with_the_line(old, new, match, case):
    path, _, _ = case
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(MotionError, match=match) as refusal:
        read_amc(path)
    assert "02_01.amc, line" in str(refusal.value)


def test_nan_is_refused(case):
    path, _, _ = case
    lines = path.read_text().splitlines()
    lines[4] = "root nan 0 0 0 0 0"
    path.write_text("\n".join(lines))
    with pytest.raises(MotionError, match="line 5: expected finite"):
        read_amc(path)


@pytest.mark.parametrize("suffix", [".amc", ".asf"])
def test_every_truncation_is_refused(suffix, case):
    path, _, _ = case
    target = path if suffix == ".amc" else path.with_name("02.asf")
    lines = target.read_text().splitlines(keepends=True)
    frame_length = 2 + sum(1 for bone in ASF_BONES.values() if bone[3])
    for count in range(0, len(lines) - 1, 3):
        if suffix == ".amc" and count > 3 and (count - 3) % frame_length == 0:
            continue  # whole frames: a shorter clip, not a broken one
        target.write_text("".join(lines[:count]))
        with pytest.raises(MotionError):
            read_amc(path)
