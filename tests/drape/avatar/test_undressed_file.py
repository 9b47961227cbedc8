"""A character's own file without the faces that its garments replace: the others stay, and skin is where it is bare."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import DracoPy
import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.character import character_in
from drape.avatar.own_garments import Undressed
from drape.avatar.wearer import Wearer, read_wearer
from drape.avatar.worn_file import undressed_file
from drape.body.model import BodyModel
from drape.files.gltf import GltfFile
from drape.files.gltf_compressed import DRACO
from tests.fixtures.characters import character
from tests.fixtures.glb_reader import Reader, khronos_complaints
from tests.fixtures.hostile_characters import glb_of, parts_of


def twice(document: dict[str, Any]) -> None:
    """Another node with the same mesh."""
    node = next(one for one in document["nodes"] if "mesh" in one)
    document["nodes"].append(copy.deepcopy(node) | {"name": "twin"})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)


def in_draco(payload: bytes) -> bytes:
    """``payload`` with the attributes of its mesh packed."""
    document, binary = parts_of(payload)
    (primitive,) = document["meshes"][0]["primitives"]
    read = Reader(payload)
    held = {name: read.array(number) for name, number in primitive["attributes"].items()}
    faces = read.array(primitive["indices"]).reshape(-1, 3).astype(np.uint32)
    others = {number: np.ascontiguousarray(held[name]) for number, name in enumerate(("JOINTS_0", "WEIGHTS_0"))}
    packed = DracoPy.encode(
        held["POSITION"], faces, quantization_bits=20, preserve_order=True, generic_attributes=others
    )
    position = next(one["unique_id"] for one in DracoPy.decode(packed).attributes if one["attribute_type"] == 0)
    primitive["attributes"] = {name: primitive["attributes"][name] for name in ("POSITION", "JOINTS_0", "WEIGHTS_0")}
    view = {"buffer": 0, "byteOffset": len(binary), "byteLength": len(packed)}
    document["bufferViews"].append(view)
    told = {"POSITION": position, "JOINTS_0": 0, "WEIGHTS_0": 1}
    primitive["extensions"] = {DRACO: {"bufferView": len(document["bufferViews"]) - 1, "attributes": told}}
    document["extensionsUsed"] = document["extensionsRequired"] = [DRACO]
    binary += packed + bytes(-len(packed) % 4)
    document["buffers"] = [{"byteLength": len(binary)}]
    return glb_of(document, binary)


MADE: dict[str, Callable[[BodyModel], bytes]] = {
    "plain": lambda body: character(body, scale=100.0, arms_rad=0.5),
    "a mesh of two nodes": lambda body: character(body, change=twice),
    "packed": lambda body: in_draco(character(body)),
}


@pytest.fixture(scope="module", params=MADE)
def payload(request: pytest.FixtureRequest, body: BodyModel) -> bytes:
    return MADE[request.param](body)


@pytest.fixture(scope="module")
def wearer(payload: bytes, body: BodyModel) -> Wearer:
    return read_wearer(payload, name="me", body=body)


def left(wearer: Wearer, off: np.ndarray, bare: int = 0) -> Undressed:
    return Undressed(off, np.arange(len(wearer.body.faces)) < bare)


def middles(payload: bytes) -> np.ndarray:
    """The middles of the faces of a character, sorted, in units of its file."""
    found = character_in(GltfFile(payload))
    rows = found.vertices[found.faces].mean(axis=1)
    return rows[np.lexsort(np.round(rows, 4).T)]


def test_faces_that_are_off_are_gone_and_no_others(payload: bytes, wearer: Wearer, tmp_path):
    assert wearer.file is not None
    off = np.random.default_rng(0).random(len(wearer.faces)) < 0.3
    made = undressed_file(payload, wearer, wearer.file, left(wearer, off))
    before, after = character_in(GltfFile(payload)), character_in(GltfFile(made))
    assert len(after.faces) == (~off).sum()
    stays = before.vertices[before.faces[~off]].mean(axis=1)
    gone = stays[np.lexsort(np.round(stays, 4).T)]
    assert_allclose(middles(made), gone, atol=2e-4 * np.ptp(before.vertices[:, 1]))
    codes = {one["code"] for one in khronos_complaints(payload, tmp_path)}
    assert {one["code"] for one in khronos_complaints(made, tmp_path)} <= codes


def test_a_mesh_that_is_off_as_a_whole_keeps_its_place(payload: bytes, wearer: Wearer):
    """Nodes, meshes and materials stay in their places, for extensions tell of them by number."""
    assert wearer.file is not None
    first = wearer.file.triangle < wearer.file.primitives[0].triangles
    made, was = Reader(undressed_file(payload, wearer, wearer.file, left(wearer, first, bare=50))), Reader(payload)
    number = was.json["nodes"][wearer.file.primitives[0].node]["mesh"]
    shared = sum(one.get("mesh") == number for one in was.json["nodes"]) > 1
    (primitive,) = made.json["meshes"][len(was.json["meshes"]) if shared else number]["primitives"]
    assert made.array(primitive["indices"]).tolist() == [0, 0, 0]
    assert [one.get("name") for one in made.json["nodes"][: len(was.json["nodes"])]] == [
        one.get("name") for one in was.json["nodes"]
    ]
    bare = made.json["meshes"][-1]
    assert bare["name"] == "bare skin" and made.array(bare["primitives"][0]["indices"]).size == 150
