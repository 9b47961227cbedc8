"""The page's file of a character in garments: what the service wrote on its rig, joined to the file of the browser."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.avatar.rig_file import Dressed, add_dressed, add_nodes
from drape.avatar.rig_motion import RigClip
from drape.avatar.wearer import Wearer, read_wearer
from drape.body.model import BodyModel
from drape.export.glb_file import GlbFile
from drape.garment.cache import Garment
from tests.clients.node import page_answer
from tests.drape.avatar.test_undressed_file import twice
from tests.drape.avatar.test_worn_file import listed
from tests.fixtures.characters import bare_wearer, character, with_json
from tests.fixtures.glb_reader import Reader, khronos_complaints
from tests.fixtures.poses import smooth_motion

COLOUR = (0.1, 0.2, 0.3, 1.0)
JOIN = """
const { wornFile } = await import(`${WEB}/src/worn_file.js`);
const bytes = (text) => Uint8Array.from(Buffer.from(text, "base64")).buffer;
let said = null;
try {
  const file = wornFile(bytes(input.own), bytes(input.worn), input.covered);
  said = { file: Buffer.from(await file.arrayBuffer()).toString("base64") };
} catch ({ message }) { said = { message }; }
console.log(JSON.stringify(said));
"""


def joined(own: bytes, worn: bytes, covered: dict[str, Any], folder: Path) -> dict[str, Any]:
    told = {"own": base64.b64encode(own).decode(), "worn": base64.b64encode(worn).decode(), "covered": covered}
    return page_answer(JOIN, told, folder)


def on_its_rig(wearer: Wearer, tube: Garment) -> bytes:
    """What the service writes with ``rig``."""
    assert wearer.file is not None
    clip = RigClip(*wearer.to_rig(*smooth_motion(np.arange(3) / 30.0)), 30.0)
    file, cloth = GlbFile(), np.broadcast_to(tube.vertices, (3, *tube.vertices.shape))
    add_dressed(file, add_nodes(file, wearer.file.skeleton), [Dressed(tube, cloth, COLOUR)], clip, wearer, wearer.file)
    return file.to_bytes()


def covered_by(payload: bytes, *, ranges: list[int], hidden: list[int]) -> dict[str, Any]:
    document = Reader(payload).json
    node = next(i for i, one in enumerate(document["nodes"]) if "mesh" in one)
    (primitive,) = document["meshes"][0]["primitives"]
    count = document["accessors"][primitive["indices"]]["count"] // 3
    told = {"node": node, "name": "", "primitive": 0, "triangles": count, "ranges": ranges, "hidden": hidden}
    return {"primitives": [told]}


@pytest.mark.parametrize("vrm", ["0", "1"])
def test_the_character_stays_as_it_was_in_its_garments(vrm: str, body: BodyModel, tube: Garment, tmp_path: Path):
    payload = character(body, vrm=vrm, arms_rad=0.5, scale=10.0, change=listed)
    worn = on_its_rig(read_wearer(payload, name="somebody", body=body), tube)
    covered = covered_by(payload, ranges=[0, 10], hidden=[20, 30])
    content = base64.b64decode(joined(payload, worn, covered, tmp_path)["file"])
    was, now, theirs = Reader(payload), Reader(content), Reader(worn)
    assert now.binary[: len(was.binary)] == was.binary
    assert now.json["extensions"] == was.json["extensions"] if vrm == "1" else True
    for before, after in zip(was.json["nodes"], now.json["nodes"], strict=False):
        assert before == after
    skin = next(number for number, mesh in enumerate(now.json["meshes"]) if mesh["name"] != "tube")
    cloth = next(number for number, mesh in enumerate(now.json["meshes"]) if mesh["name"] == "tube")
    faces = was.array(was.json["meshes"][0]["primitives"][0]["indices"]).reshape(-1, 3)
    kept = np.ones(len(faces), dtype=bool)
    kept[:10] = kept[20:50] = False
    left = now.array(now.json["meshes"][skin]["primitives"][0]["indices"]).reshape(-1, 3)
    assert_array_equal(left, faces[kept])
    number = next(number for number, mesh in enumerate(theirs.json["meshes"]) if mesh["name"] == "tube")
    assert_array_equal(now.skinned(3, cloth), theirs.skinned(3, number))
    before = {one["code"] for one in khronos_complaints(payload, tmp_path)}
    assert {one["code"] for one in khronos_complaints(content, tmp_path)} <= before
    if vrm == "0":
        told = now.json["extensions"]["VRM"]["materialProperties"]
        assert len(told) == len(now.json["materials"]) and told[-1]["shader"] == "VRM_USE_GLTFSHADER"


def test_a_mesh_of_two_nodes_is_cut_at_one_and_a_mesh_that_is_gone_keeps_a_triangle(
    body: BodyModel, tube: Garment, tmp_path: Path
):
    payload = character(body, change=twice)
    covered = covered_by(payload, ranges=[], hidden=[])
    (one,) = covered["primitives"]
    one["hidden"] = [0, one["triangles"]]
    worn = on_its_rig(read_wearer(payload, name="somebody", body=body), tube)
    content = base64.b64decode(joined(payload, worn, covered, tmp_path)["file"])
    now = Reader(content)
    counts = [now.json["accessors"][mesh["primitives"][0]["indices"]]["count"] for mesh in now.json["meshes"]]
    assert sorted(counts)[0] == 3 and 3 * one["triangles"] in counts


def test_another_character_and_a_file_in_parts_are_told(body: BodyModel, tube: Garment, tmp_path: Path):
    payload = character(body)
    worn, none = on_its_rig(bare_wearer(), tube), {"primitives": []}
    said = joined(with_json(payload, lambda one: one["nodes"][3].update(name="other")), worn, none, tmp_path)
    assert "another version of this character" in said["message"]
    said = joined(with_json(payload, lambda one: one["buffers"][0].update(uri="a.bin")), worn, none, tmp_path)
    assert "export it as one GLB" in said["message"]
    assert "no GLB" in joined(b"{" + json.dumps({}).encode() + bytes(40), worn, none, tmp_path)["message"]
