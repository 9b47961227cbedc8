"""Buffer views and chunks of glTF that are none are refused by their place."""

from __future__ import annotations

import json

import pytest

from drape.errors import MeshError
from drape.files import gltf
from drape.garment.files.mesh import read_mesh
from tests.drape.garment.garment_files import FACES, UV, VERTICES, as_gltf, glb_bytes


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"extensions": {gltf.MESHOPT: 3}}, r"bufferViews\[0\]: expected an object, got 3"),
        ({"byteOffset": "x"}, r"bufferViews\[0\]: expected whole numbers"),
        ({"byteStride": 0.5}, r"bufferViews\[0\]: expected whole numbers, got 0.5"),
        ({"byteLength": 10**9}, r"bufferViews\[0\]: expected at most \d+ bytes"),
    ],
)
def test_a_buffer_view_that_is_none_is_refused(change: dict, said: str):
    document = json.loads(as_gltf(glb_bytes(VERTICES, FACES, UV), inside=True)[0])
    document["bufferViews"][0] |= change
    with pytest.raises(MeshError, match=said):
        read_mesh(json.dumps(document).encode())


def test_json_that_is_longer_than_any_is_refused_before_it_is_read(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gltf, "JSON_BYTES", 100)
    with pytest.raises(MeshError, match=r"JSON: expected at most 0 MB, got 1 MB"):
        read_mesh(glb_bytes(VERTICES, FACES, UV))
