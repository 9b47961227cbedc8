"""Motions of files on the page, in Node.js: which files are motions, what is in them, and where their person stands."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.model import BodyModel
from drape.body.skeleton import PARENTS
from drape.geometry.rigid import forward_kinematics
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.grounding import place_on_ground
from drape.motion.readers import read_motion
from tests.clients.node import page_answer
from tests.drape.motion.node_files import T_POSE, fbx, glb, moved
from tests.fixtures.characters import character
from tests.fixtures.fbx_writer import fbx_of

READ = """
const { Rest } = await import(`${WEB}/lib/src/rest.js`);
const { askMotion, placed } = await import(`${WEB}/src/motion_file.js`);
const file = new File([Buffer.from(input.file, "base64")], input.name);
const told = await askMotion(new Rest(input.service), file, input.clip).catch((error) => error.message);
const clip = told.poses && placed(told, input.body);
const plain = (rows) => rows.map((row) => [...row]);
const numbers = clip && { ...clip, poses: plain(clip.poses), trans: plain(clip.trans) };
console.log(JSON.stringify(numbers ?? { refused: told }));
"""


def test_a_file_s_motion_is_python_s_on_the_ground(api: httpx.Client, body: BodyModel, tmp_path: Path):
    path = tmp_path / "walk.glb"
    path.write_bytes(glb(*moved("mixamo", T_POSE)))
    betas = np.zeros(body.shape_count)
    betas[0] = 3.0  # other legs than those of an average adult
    joints, floor = body.rest_joints(betas), float(body.floor_m(betas))
    document = {"file": base64.b64encode(path.read_bytes()).decode(), "name": path.name, "service": str(api.base_url)}
    document |= {"clip": "walk", "body": {"joints": joints.tolist(), "floor_m": floor}}
    got = page_answer(READ, document, tmp_path)
    expected = place_on_ground(read_motion(path), joints, floor=floor)
    assert (got["frames"], got["fps"]) == (expected.frame_count, pytest.approx(expected.fps))
    local = rotvec_to_matrix(np.reshape(got["poses"], (-1, 24, 3)))
    assert_allclose(local, rotvec_to_matrix(expected.poses), atol=1e-5)
    trans = np.array(got["trans"])
    flat = [0, 2]
    assert_allclose(trans[:, flat], (expected.trans - expected.trans[0])[:, flat], atol=1e-5)
    _, places = forward_kinematics(local, joints, PARENTS)
    soles = [7, 8, 10, 11]
    heights = places[:, soles, 1] + trans[:, None, 1] - (joints[soles, 1] - floor)
    assert heights.min() == pytest.approx(0.0, abs=1e-5)
    assert "one of 'walk'" in page_answer(READ, document | {"clip": "run"}, tmp_path)["refused"]


KINDS = """
const { kindOfFile } = await import(`${WEB}/src/drop.js`);
const { aboutGlb } = await import(`${WEB}/src/scene_file.js`);
const files = input.files.map(([name, bytes]) => new File([Buffer.from(bytes, "base64")], name));
const told = await Promise.all(files.map(async (file) => [await kindOfFile(file), (await aboutGlb(file)).clips]));
console.log(JSON.stringify(told));
"""


def animated(lengths: dict[str, float]) -> Callable[[dict[str, Any]], None]:
    """What puts animations of some lengths [s] into a GLB's JSON."""

    def change(document: dict[str, Any]) -> None:
        first = len(document["accessors"])
        document["accessors"] += [{"max": [length]} for length in lengths.values()]
        samplers = [[{"input": first + number}] for number in range(len(lengths))]
        document["animations"] = [{"name": name, "samplers": own} for name, own in zip(lengths, samplers, strict=True)]

    return change


def test_kinds_of_files_are_told_by_what_is_in_them(body: BodyModel, tmp_path: Path):
    lengths = {f"clip {k}": float(k) for k in range(25)}
    longest = [f"clip {k}" for k in range(24, 4, -1)]
    motion, shirt = glb(*moved("mixamo", T_POSE)), b"glTF" + bytes(40)
    sheet = fbx_of(np.eye(4)[:, :3], [[0, 1, 2], [0, 2, 3]], np.zeros((6, 2)))
    cases = [
        ("walk.bvh", b"HIERARCHY", "motion", []),
        ("walk.vrma", motion, "motion", ["walk"]),
        ("walk.GLB", motion, "motion", ["walk"]),
        ("walk.fbx", fbx(), "motion", []),
        ("sheet.fbx", sheet, "garment", []),
        ("me.glb", character(body), "character", []),
        ("me.glb", character(body, change=animated(lengths)), "character", longest),
        ("me.vrm", character(body, vrm="1", change=animated({"one": 1.0})), "character", ["one"]),
        ("odd.glb", character(body, change=animated({7: 1.0})), "character", ["7"]),  # pyright: ignore[reportArgumentType]
        ("odd.glb", character(body, change=lambda told: told.update(animations=[{}])), "character", [""]),
        ("shirt.glb", shirt, "garment", []),
        ("shirt.glb", b"", "garment", []),
        ("song.mp3", b"", None, []),
    ]
    files = [[name, base64.b64encode(payload).decode()] for name, payload, _, _ in cases]
    told = page_answer(KINDS, {"files": files}, tmp_path)
    assert told == [[kind, clips] for _, _, kind, clips in cases]
