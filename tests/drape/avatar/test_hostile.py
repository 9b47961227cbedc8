"""Characters that are sent to do harm are refused in a sentence or read, and what is kept of one is small."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from drape.avatar.character import character_in
from drape.avatar.file_skeleton import FileRig, file_rig
from drape.avatar.mapping import map_joints
from drape.avatar.t_pose import to_t_pose
from drape.body.model import BodyModel
from drape.errors import DrapeError
from drape.files.gltf import GltfFile
from drape.files.packed import pack
from tests.fixtures.characters import character
from tests.fixtures.hostile_characters import HALF_PAIR, spoilt_fields, spoilt_wholes

FEW, MANY = 40, 2000  # of the fields' thousands, drawn by a seed


def few_vertices(document: dict[str, Any]) -> None:
    primitive = document["meshes"][0]["primitives"][0]
    del primitive["indices"]
    for accessor in primitive["attributes"].values():
        document["accessors"][accessor]["count"] = 399


@pytest.fixture(scope="module")
def small(body: BodyModel) -> bytes:
    """A few triangles on a person's bones, which VRM names."""
    return character(body, vrm="0", change=few_vertices)


def read(payload: bytes, body: BodyModel) -> FileRig | str:
    """What is kept of a file, or the sentence that refuses it."""
    try:
        file = GltfFile(payload)
        found = character_in(file)
        kept = file_rig(file, found)
        to_t_pose(found, map_joints(found, body).rig)
        return kept
    except DrapeError as error:
        return str(error)


@pytest.mark.parametrize("most", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
def test_whatever_is_wrong_with_a_file_it_is_refused_in_a_sentence_or_read(small: bytes, body: BodyModel, most: int):
    refused = 0
    for name, payload in itertools.chain(spoilt_wholes(small), spoilt_fields(small, most=most)):
        found = read(payload, body)
        if isinstance(found, str):
            refused += 1
            assert found.isprintable() and len(found) < 1200, ascii(name)
        else:
            assert len(pack(found.arrays())) < 600_000, ascii(name)
    assert refused > most / 4


@pytest.mark.parametrize(
    ("spoilt", "said"),
    [
        ({"nodes": [{"name": HALF_PAIR}]}, "nodes[0].name: expected a valid string"),
        ({"scenes": [5]}, "scenes[0]: expected a valid dictionary, got 5"),
        ({"scenes": [{"nodes": 5}]}, "scenes[0].nodes: expected a valid list, got 5"),
        ({"skins": [{}]}, "skins[0].joints: expected a value, got nothing"),
        ({"nodes": [{"scale": [1, 1]}]}, "nodes[0].scale: expected at least 3 items, got a list of 2"),
        ({"extensionsRequired": ["ACME_unknown"]}, "extensionsRequired: expected no required extension"),
    ],
)
def test_a_sentence_names_the_field(small: bytes, body: BodyModel, spoilt: dict[str, Any], said: str):
    found = read(character(body, change=lambda document: document.update(spoilt)), body)
    assert isinstance(found, str) and said in found
