"""Clips in GLB, VRMA and FBX are those of the person who moves in them, on whatever skeleton the file has."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drape.errors import MotionError
from drape.export.glb_file import GlbFile
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion.node_clip import MOST_MATRICES, check_size
from drape.motion.readers import read_motion
from drape.motion.rig_poses import Rig
from drape.motion.samples import SAMPLES
from tests.drape.motion.motion_files import BODY_PARENTS, t_pose_offsets
from tests.drape.motion.rigs import a_pose, rig_and_motion
from tests.fixtures.fbx_writer import fbx_motion

FPS = 30.0
CLIP = SAMPLES["walk"]().resampled(FPS).window(0, 40)
LIMITS_DEG = 2.0  # asked of a reader; of a T-pose all is exact
T_POSE = np.tile(np.eye(3), (22, 1, 1))


def level_joints() -> np.ndarray:
    """The rest joints (24, 3) of a person whose arms are exactly level."""
    places = np.zeros((24, 3))
    places[:22] = t_pose_offsets()
    for joint in range(1, 22):
        places[joint] += places[BODY_PARENTS[joint]]
    return places


JOINTS = level_joints()


def moved(scheme: str, rest: np.ndarray, unit: float = 1.0) -> tuple[Rig, np.ndarray, np.ndarray]:
    """A rig with axes of its own, its local quaternions (F, J, 4) wxyz and its root's places (F, 3) in its unit."""
    joints = JOINTS
    rig, quaternions = rig_and_motion(joints, rotvec_to_matrix(CLIP.poses), scheme=scheme, rest=rest, seed=3)
    places = (CLIP.trans + joints[0]) / unit
    return Rig(rig.names, rig.parents, rig.rest_rotations, rig.rest_translations / unit), quaternions, places


def glb(
    rig: Rig, quaternions: np.ndarray, places: np.ndarray, *, extensions=None, interpolation="LINEAR", scale=1.0
) -> bytes:
    """A GLB of the rig's nodes below an armature that has a ``scale``, and one animation of them."""
    file = GlbFile()
    armature = file.node({"name": "Armature", "scale": [scale] * 3})
    first = armature + 1
    for number, name in enumerate(rig.names):
        children = [first + k for k, parent in enumerate(rig.parents) if parent == number]
        node = {"name": name, "translation": rig.rest_translations[number].tolist()}
        node["rotation"] = np.roll(rig.rest_rotations[number], -1).tolist()
        file.add("nodes", node | ({"children": children} if children else {}))
    file.json["nodes"][armature]["children"] = [first]
    times = file.array(np.arange(len(places), dtype=np.float32) / np.float32(FPS), bounds=True)
    channels, samplers = [], []
    rows = [(number, "rotation", np.roll(quaternions[:, number], -1, axis=1)) for number in range(len(rig.names))]
    for number, path, values in [*rows, (0, "translation", places)]:
        if interpolation == "CUBICSPLINE":
            slope = np.gradient(values, 1.0 / FPS, axis=0)
            values = np.stack([slope, values, slope], axis=1).reshape(-1, values.shape[1])
        samplers.append(
            {"input": times, "output": file.array(values.astype(np.float32)), "interpolation": interpolation}
        )
        channels.append({"sampler": len(samplers) - 1, "target": {"node": first + number, "path": path}})
    file.add("animations", {"name": "walk", "channels": channels, "samplers": samplers})
    if extensions:
        file.json["extensions"] = extensions(first)
    return file.to_bytes()


def errors_deg(found, joints: slice = slice(0, 22)) -> np.ndarray:
    """The angles [degrees] (F, 22) between the world rotations' causes: local ones of ``found`` and of the clip."""
    got, want = (rotvec_to_matrix(one.astype(float)) for one in (found.poses, CLIP.poses))
    return np.degrees(np.linalg.norm(matrix_to_rotvec(np.swapaxes(want, -1, -2) @ got), axis=-1))[:, joints]


def written(folder: Path, name: str, payload: bytes) -> Path:
    (folder / name).write_bytes(payload)
    return folder / name


@pytest.mark.parametrize("scheme", ["mixamo", "rigify", "vrm"])
def test_a_glb_s_animation_is_the_clip_in_any_names_and_axes(scheme: str, tmp_path: Path):
    found = read_motion(written(tmp_path, "walk.glb", glb(*moved(scheme, T_POSE))))
    assert (found.fps, found.frame_count) == (pytest.approx(FPS), CLIP.frame_count)
    assert errors_deg(found).max() < LIMITS_DEG
    way = found.trans - found.trans[0]
    np.testing.assert_allclose(way, CLIP.trans - CLIP.trans[0], rtol=0, atol=2e-3)


def test_an_a_pose_in_centimetres_under_an_armature_that_scales_is_the_same_clip(tmp_path: Path):
    rig, quaternions, places = moved("mixamo", a_pose(45.0, 6.0), unit=0.01)
    found = read_motion(written(tmp_path, "walk.glb", glb(rig, quaternions, places, scale=0.01)))
    assert errors_deg(found).max() < LIMITS_DEG
    np.testing.assert_allclose(found.trans - found.trans[0], CLIP.trans - CLIP.trans[0], rtol=0, atol=2e-3)


def test_a_vrma_s_bones_tell_its_nodes_whatever_they_are_called(tmp_path: Path):
    rig, quaternions, places = moved("vrm", T_POSE)

    def extensions(first: int) -> dict:
        bones = {name: {"node": first + number} for number, name in enumerate(rig.names)}
        return {"VRMC_vrm_animation": {"specVersion": "1.0", "humanoid": {"humanBones": bones}}}

    payload = glb(rig, quaternions, places, extensions=extensions)
    for name in rig.names:
        payload = payload.replace(f'"name": "{name}"'.encode(), f'"name": "{"x" * len(name)}"'.encode())
        payload = payload.replace(f'"name":"{name}"'.encode(), f'"name":"{"x" * len(name)}"'.encode())
    assert b'UpperLeg",' not in payload.split(b"humanBones")[0]
    assert errors_deg(read_motion(written(tmp_path, "walk.vrma", payload))).max() < LIMITS_DEG


def test_splines_go_through_their_keys_and_steps_hold(tmp_path: Path):
    rigged = moved("mixamo", T_POSE)
    smooth = read_motion(written(tmp_path, "smooth.glb", glb(*rigged, interpolation="CUBICSPLINE")))
    assert errors_deg(smooth).max() < LIMITS_DEG
    held = read_motion(written(tmp_path, "held.glb", glb(*rigged, interpolation="STEP")))
    assert errors_deg(held).max() < LIMITS_DEG


@pytest.mark.parametrize("up", ["y", "z"])
def test_an_fbx_is_the_clip_whatever_its_axis_and_unit(up: str, tmp_path: Path):
    pytest.importorskip("ufbx", reason="No ufbx: `pip install ufbx`.")
    joints = JOINTS
    rig, quaternions = rig_and_motion(joints, rotvec_to_matrix(CLIP.poses), scheme="mixamo", rest=a_pose(30.0, 4.0))
    places, rest = 100.0 * (CLIP.trans + joints[0]), 100.0 * rig.rest_translations
    turns = Rotation.from_quat(np.roll(quaternions, -1, axis=2).reshape(-1, 4))
    if up == "z":  # the file's root stands on its side
        side = Rotation.from_euler("x", 90, degrees=True)
        first = side * Rotation.from_quat(np.roll(quaternions[:, 0], -1, axis=1))
        quaternions = quaternions.copy()
        quaternions[:, 0] = np.roll(first.as_quat(), 1, axis=1)
        turns = Rotation.from_quat(np.roll(quaternions, -1, axis=2).reshape(-1, 4))
        places, rest[0] = side.apply(places), side.apply(rest[0])
        still = side * Rotation.from_quat(np.roll(rig.rest_rotations[0], -1))
        rig.rest_rotations[0] = np.roll(still.as_quat(), 1)
    angles = turns.as_euler("xyz", degrees=True).reshape(*quaternions.shape[:2], 3)
    still = Rotation.from_quat(np.roll(rig.rest_rotations, -1, axis=1)).as_euler("xyz", degrees=True)
    payload = fbx_motion(rig.names, rig.parents, rest, still, places, angles, fps=FPS, up=2 if up == "z" else 1)
    found = read_motion(written(tmp_path, "walk.fbx", payload))
    assert (found.fps, found.frame_count) == (pytest.approx(FPS), CLIP.frame_count)
    assert errors_deg(found).max() < LIMITS_DEG
    np.testing.assert_allclose(found.trans - found.trans[0], CLIP.trans - CLIP.trans[0], rtol=0, atol=2e-3)


def test_a_clip_is_chosen_by_name_and_the_longest_else(tmp_path: Path):
    file = written(tmp_path, "walk.glb", glb(*moved("mixamo", T_POSE)))
    assert read_motion(file, clip="walk").name == "walk"
    with pytest.raises(MotionError, match="one of 'walk'"):
        read_motion(file, clip="run")
    with pytest.raises(MotionError, match="no clips to choose from"):
        read_motion(written(tmp_path, "walk.bvh", b""), clip="run")


def broken(payload: bytes, change) -> bytes:
    size = int.from_bytes(payload[12:16], "little")
    document = json.loads(payload[20 : 20 + size])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = payload[20 + size :]
    total = (20 + len(text) + len(rest)).to_bytes(4, "little")
    return payload[:8] + total + len(text).to_bytes(4, "little") + b"JSON" + text + rest


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda d: d.pop("animations"), "an animation"),
        (lambda d: d["animations"][0]["channels"][0].update(sampler=900), "a sampler below"),
        (lambda d: d["animations"][0]["channels"][0].update(sampler="x"), "a glTF animation"),
        (lambda d: d["animations"][0]["channels"][0]["target"].update(node=900), "an index of nodes"),
        (lambda d: d["animations"][0]["samplers"][0].update(output=0), "rising times"),
        (lambda d: d["animations"][0].update(channels=[]), "nodes that move"),
        (lambda d: [node.update(name=f"n{k}") for k, node in enumerate(d["nodes"])], "a person's joints"),
    ],
)
def test_broken_animations_are_refused_in_words(change, match: str, tmp_path: Path):
    payload = broken(glb(*moved("mixamo", T_POSE)), change)
    with pytest.raises(MotionError, match=match):
        read_motion(written(tmp_path, "walk.glb", payload))


def test_what_is_no_fbx_with_a_person_is_refused(tmp_path: Path):
    pytest.importorskip("ufbx", reason="No ufbx: `pip install ufbx`.")
    with pytest.raises(MotionError, match="readable FBX"):
        read_motion(written(tmp_path, "walk.fbx", b"Kaydara FBX Binary  \x00\x1a\x00"))
    with pytest.raises(MotionError, match=r"readable FBX|an animation"):
        read_motion(
            written(tmp_path, "walk.fbx", fbx_motion(["a"], [-1], np.zeros((1, 3)), np.zeros((1, 3)), None, None))
        )


@pytest.mark.parametrize("name", ["absent.glb", "absent.fbx"])
def test_an_absent_file_is_refused(name: str, tmp_path: Path):
    with pytest.raises(MotionError, match="a readable file"):
        read_motion(tmp_path / name)


def test_too_many_frames_are_refused():
    with pytest.raises(MotionError, match="Cut it"):
        check_size(MOST_MATRICES, 2, "clip")
