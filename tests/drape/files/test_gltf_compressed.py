"""Packed glTF: Draco, meshopt and quantised places come out as they went in, and what is wrong is refused."""

from __future__ import annotations

import base64
import json
from types import ModuleType

import DracoPy
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import MeshError
from drape.files import gltf_compressed
from drape.garment.files.mesh import read_mesh
from tests.drape.garment.garment_files import FACES, UV, VERTICES, as_gltf, glb_bytes


def meshoptimizer() -> ModuleType:
    return pytest.importorskip("meshoptimizer", reason="pip install meshoptimizer, which needs a compiler")


def buffers_of(parts: list[bytes]) -> tuple[list[dict], bytes]:
    views, content = [], b""
    for part in parts:
        views.append({"buffer": 0, "byteOffset": len(content), "byteLength": len(part)})
        content += part + b"\0" * (-len(part) % 4)
    return views, content


def inline(content: bytes) -> list[dict]:
    return [{"byteLength": len(content), "uri": "data:;base64," + base64.b64encode(content).decode()}]


def draco_gltf() -> dict:
    packed = DracoPy.encode(
        VERTICES.astype(np.float32),
        FACES.astype(np.uint32),
        quantization_bits=16,
        tex_coord=UV.astype(np.float64),
        preserve_order=True,
    )
    held = {
        DracoPy.AttributeType(one["attribute_type"]).name: one["unique_id"] for one in DracoPy.decode(packed).attributes
    }
    document = json.loads(as_gltf(glb_bytes(VERTICES, FACES, UV), inside=True)[0])
    document["bufferViews"], content = buffers_of([packed])
    document["buffers"] = inline(content)
    for accessor in document["accessors"]:
        del accessor["bufferView"]
    told = {"bufferView": 0, "attributes": {"POSITION": held["POSITION"], "TEXCOORD_0": held["TEX_COORD"]}}
    document["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": told}
    document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return document


def test_draco_is_unpacked():
    mesh = read_mesh(json.dumps(draco_gltf()).encode())
    assert_array_equal(mesh.faces, FACES)
    step = np.ptp(VERTICES, axis=0).max() / 2**16
    assert_allclose(mesh.vertices, VERTICES, atol=step)
    assert_allclose(mesh.uv[mesh.uv_faces][:, :, 0], UV[FACES][:, :, 0], atol=1e-4)


@pytest.mark.parametrize("change", ["payload", "count", "object", "attribute"])
def test_draco_that_is_wrong_is_refused(change: str):
    document = draco_gltf()
    told = document["meshes"][0]["primitives"][0]["extensions"]
    if change == "payload":
        document["bufferViews"][0]["byteOffset"] = 8
        document["bufferViews"][0]["byteLength"] -= 8
    elif change == "count":
        document["accessors"][0]["count"] += 1
    elif change == "object":
        told["KHR_draco_mesh_compression"] = []
    else:
        told["KHR_draco_mesh_compression"]["attributes"] = "none"
    with pytest.raises(MeshError):
        read_mesh(json.dumps(document).encode())


def meshopt_gltf() -> dict:
    """Places in steps of 16 bits (KHR_mesh_quantization), all of it packed."""
    low, extent = VERTICES.min(axis=0), np.ptp(VERTICES, axis=0).max()
    steps = np.zeros((len(VERTICES), 4), np.uint16)
    steps[:, :3] = np.round((VERTICES - low) / extent * 65535)
    document = json.loads(as_gltf(glb_bytes(VERTICES, FACES, UV), inside=True)[0])
    rows = meshoptimizer().encode_vertex_buffer(steps.view(np.float32), len(steps), 8)
    uv = meshoptimizer().encode_vertex_buffer(UV, len(UV), 8)
    index = meshoptimizer().encode_index_buffer(FACES.reshape(-1).astype(np.uint32), FACES.size, len(VERTICES))
    views, content = buffers_of([rows, index, uv])
    told = [(len(steps), 8, "ATTRIBUTES"), (FACES.size, 4, "TRIANGLES"), (len(UV), 8, "ATTRIBUTES")]
    document["bufferViews"] = [
        {
            "buffer": 1,
            "byteLength": count * stride,
            "extensions": {"EXT_meshopt_compression": view | {"count": count, "byteStride": stride, "mode": mode}},
        }
        for view, (count, stride, mode) in zip(views, told, strict=True)
    ]
    document["bufferViews"][0]["byteStride"] = 8
    document["accessors"][0] |= {"componentType": 5123, "normalized": True}
    document["nodes"][0] |= {"translation": low.tolist(), "scale": [float(extent)] * 3}
    document["buffers"] = [*inline(content), {"byteLength": 10**6, "extensions": {"EXT_meshopt_compression": {}}}]
    document["extensionsRequired"] = ["EXT_meshopt_compression", "KHR_mesh_quantization"]
    return document


def test_meshopt_and_quantized_places_are_unpacked():
    mesh = read_mesh(json.dumps(meshopt_gltf()).encode())
    step = np.ptp(VERTICES, axis=0).max() / 65535
    corners = mesh.vertices[mesh.faces]
    # The coder may begin a triangle with another corner.
    assert_allclose(np.sort(corners.mean(axis=1), axis=0), np.sort(VERTICES[FACES].mean(axis=1), axis=0), atol=step)
    assert len(mesh.uv) == len(UV)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("count", 10**9), ("count", None), ("byteStride", 6), ("byteStride", 0), ("mode", "ODD"), ("mode", {}),
        ("filter", "OCTAHEDRAL "), ("filter", {}), ("filter", "QUATERNION "), ("byteOffset", -1), ("byteLength", 10**7),
        ("byteOffset", 5), ("buffer", 9),
    ],
)  # fmt: skip
def test_meshopt_that_is_wrong_is_refused(key: str, value: object):
    document = meshopt_gltf()
    document["bufferViews"][0]["extensions"]["EXT_meshopt_compression"][key] = value
    with pytest.raises(MeshError):
        read_mesh(json.dumps(document).encode())
    document["bufferViews"][0]["extensions"]["EXT_meshopt_compression"] = 3
    with pytest.raises(MeshError, match="an object"):
        read_mesh(json.dumps(document).encode())


def test_meshopt_filters_undo_what_they_did():
    unit = np.zeros((4, 4), np.int8)
    unit[:, 2] = 127  # octahedral: z is 1
    packed = meshoptimizer().encode_vertex_buffer(unit.view(np.float32), 4, 4)
    told = {"count": 4, "byteStride": 4, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL"}
    found = np.frombuffer(gltf_compressed.meshopt_view(packed, told, "view"), np.int8).reshape(4, 4)
    assert_array_equal(found[:, :3], [[0, 0, 127]] * 4)


def test_short_indices_are_unpacked():
    index = meshoptimizer().encode_index_buffer(FACES.reshape(-1).astype(np.uint32), FACES.size, len(VERTICES))
    told = {"count": FACES.size, "byteStride": 2, "mode": "TRIANGLES"}
    found = np.frombuffer(gltf_compressed.meshopt_view(index, told, "view"), np.uint16)
    assert_array_equal(np.sort(found), np.sort(FACES.reshape(-1)))


def test_without_its_package_a_packed_file_is_refused_with_the_cure(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(__import__("sys").modules, "DracoPy", None)
    with pytest.raises(MeshError, match="pip install dracopy"):
        read_mesh(json.dumps(draco_gltf()).encode())
