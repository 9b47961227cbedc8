"""Clips in GLB, VRMA and FBX are those of the person who moves in them, on whatever skeleton the file has."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from drape.errors import MotionError, TooLarge
from drape.geometry.rotations import matrix_to_rotvec, rotvec_to_matrix
from drape.motion.node_clip import MOST_MATRICES, check_node_count
from drape.motion.readers import read_motion
from tests.drape.motion.node_files import CLIP, FPS, T_POSE, fbx, glb, moved
from tests.drape.motion.rigs import a_pose
from tests.fixtures.fbx_writer import fbx_motion

LIMITS_DEG = 2.0  # asked of a reader; of a T-pose all is exact


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
    found = read_motion(written(tmp_path, "walk.fbx", fbx(up)))
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


@pytest.mark.parametrize("suffix", [".npz", ".glb", ".fbx"])
def test_more_frames_than_are_taken_are_refused(suffix: str, tmp_path: Path):
    if suffix == ".fbx":
        pytest.importorskip("ufbx", reason="No ufbx: `pip install ufbx`.")
    path = tmp_path / f"walk{suffix}"
    if suffix == ".npz":
        CLIP.save(path)
    else:
        path.write_bytes(fbx() if suffix == ".fbx" else glb(*moved("vrm", T_POSE)))
    count = read_motion(path).frame_count
    assert read_motion(path, most_frames=count).frame_count == count
    with pytest.raises(TooLarge, match=f"at most {count - 1} frames, got {count}"):
        read_motion(path, most_frames=count - 1)


def test_too_many_frames_are_refused():
    with pytest.raises(MotionError, match="Cut it"):
        check_node_count(MOST_MATRICES, 2, "clip")
