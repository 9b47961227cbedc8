"""Files come back as they were left, and a broken one is refused with a sentence before it costs anything."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import MeshError, NotFound
from drape.files.formats import sniff
from drape.garment.files import mesh
from drape.garment.files.mesh import read_mesh
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import glb_bytes, obj_text, ply_bytes, stl_bytes

FACES = tube(10, 3)[1]


@pytest.fixture
def vertices(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(40, 3)).astype(np.float32).astype(np.float64)


def test_obj_keeps_order_uv_and_materials():
    text = b"""# a comment
mtllib m.mtl
o thing
v 0 0 0
v 1 0 0 0.5 0.5 0.5
v 1 1 0
v 0 1 \\
 0
v 9 9 9
vt 0 0
vt 1 0
vt 1 1 0
vt 0 1
vn 0 0 1
usemtl blue cloth
f 1/1/1 2/2/1 3/3/1 4/4/1
usemtl red
f -5/1 -4/2 -3/3
s off
"""
    mesh = read_mesh(text, kind="obj")
    assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [9, 9, 9]])
    assert_array_equal(mesh.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])
    assert_array_equal(mesh.uv_faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])
    assert mesh.material_names == ("blue cloth", "red")
    assert_array_equal(mesh.face_material, [0, 0, 1])
    assert "1 polygons triangulated" in mesh.notes


WORLDLY = """mtllib sch\u00f6n.mtl
o one\0name
v 0 0 0 1
v\t1 0 0 .1 .2 .3
v 1 1 0 1 .1 .2 .3 # in colour
ny 1 2 3
ny 1 2 3
vp 0.1 0.2
ms 1
call other.obj 1
csh echo
cstype bezier
curv 0 1 1 2 \\
 3
l 1 2
p 1
usemtl cloth#1
f -3// -2// -1//
usemtl cloth#2 # the other
f 1 2 \\
3 \\"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_obj_is_read_as_the_world_writes_it(encoding: str, newline: str):
    mesh = read_mesh(WORLDLY.replace("\n", newline).encode(encoding), kind="obj")
    assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0]])
    assert_array_equal(mesh.faces, [[0, 1, 2], [0, 1, 2]])
    assert mesh.material_names == ("cloth#1", "cloth#2")
    note, missing = mesh.notes
    assert "statements left out that say nothing of the surface, 10: 2 'ny', 1 'vp'" in note
    assert missing.startswith("warning: 'sch") and missing.endswith("is not beside the mesh: send it in the same zip")


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"banana 1 2 3\n", "line 1: expected an OBJ statement"),
        (b"\xef\xbb\xbf# of nothing\nny 1 2 3\n", "line 2: expected an OBJ statement"),
        (b"ny 1 2 3\nv 0 0 0\n", "no faces"),
        (b"v 0,1 0,2 0,3\n", "with points, not commas"),
        (b"glTF\2\0\0\0" + bytes(range(256)), "a text file"),
    ],
)
def test_obj_without_a_surface_is_refused(payload: bytes, message: str):
    with pytest.raises(MeshError, match=message):
        read_mesh(payload, kind="obj")


def test_obj_of_strange_words_does_not_grow_its_note():
    strange = "".join(f"word{k} 1\n" for k in range(300))
    (note,) = read_mesh(f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{strange}".encode(), kind="obj").notes
    assert "300: 200 'others'" in note
    assert len(note) < 200


def test_obj_indices_may_point_ahead_and_faces_may_lack_uv():
    assert len(read_mesh(b"vt 0.5 0.5\nf 1 2 3\nvn 0 0 1\nv 0 0 0\nv 1 0 0\nv 0 1 0\n").uv) == 0
    mixed = read_mesh(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0.5\nf 1/1 2/1 3/1\nf 1 2 3\n")
    assert_array_equal(mixed.uv_faces[1], [1, 1, 1])
    assert any("without texture coordinates" in note for note in mixed.notes)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("v 0 0", "3 finite numbers"),
        ("v 0 0 x", "3 finite numbers"),
        ("v 0 nan 0", "3 finite numbers"),
        ("v 1_0 0 0", "3 finite numbers"),
        ("f 1 2", "at least 3 corners"),
        ("f 1 2 0", "a vertex index from 1"),
        ("f 1 2 99", "a vertex index up to 3"),
        ("f 1 2 -9", "a vertex index from 1, or from -3"),
        ("f 1/7 2/7 3/7", "a texture coordinate index up to 0"),
        ("f 1/1/1/1 2 3", "corners like"),
        ("f 1.5 2 3", "corners like"),
        ("f 1 2 1" + 30 * "0", "corners like"),
        ("f 1 2 1" + 5000 * "0", "corners like"),
    ],
)
def test_obj_fault_names_its_line(line: str, message: str):
    text = f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{line}\nf 1 2 3\n".encode()
    with pytest.raises(MeshError, match="line 4") as refusal:
        read_mesh(text, kind="obj")
    assert message in str(refusal.value)


@pytest.mark.parametrize("payload", [b"", b"  \n", b"v 0 0 0\n", b"v 0 0 0\0\xff\x00", b"solid\n", b"PK\x03\x04 zip"])
@pytest.mark.parametrize("kind", ["obj", "ply", "stl", "glb", None])
def test_rubbish_is_refused(payload: bytes, kind: str | None):
    with pytest.raises(MeshError):
        read_mesh(payload, kind=kind)


def test_unknown_suffix_absent_and_large_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(NotFound):
        read_mesh(tmp_path / "absent.obj")
    (tmp_path / "a.dae").write_bytes(b"<COLLADA>")
    with pytest.raises(MeshError, match="OBJ, GLB, GLTF, PLY, STL, USD, USDA, USDC, USDZ, FBX or ZIP"):
        read_mesh(tmp_path / "a.dae")
    monkeypatch.setattr(mesh, "BYTES_LIMIT", 10)
    (tmp_path / "a.obj").write_bytes(b"v 0 0 0\n" * 9)
    for source in (tmp_path / "a.obj", b"v 0 0 0\n" * 9):
        with pytest.raises(MeshError, match="MiB"):
            read_mesh(source)


def test_too_many_vertices_are_refused(vertices: np.ndarray):
    for payload in (
        obj_text(vertices, FACES),
        ply_bytes(vertices, FACES),
        glb_bytes(np.tile(vertices, (20, 1)), FACES),
    ):
        with pytest.raises(MeshError, match="vertices"):
            read_mesh(payload, vertex_limit=20)


@pytest.mark.parametrize("write", [obj_text, ply_bytes, glb_bytes, stl_bytes])
def test_formats_give_the_same_surface(write, vertices: np.ndarray):
    mesh = read_mesh(write(vertices, FACES))
    assert_allclose(mesh.vertices[mesh.faces], vertices[FACES], rtol=0, atol=1e-6)
    if write is not stl_bytes:  # an STL has no vertices of its own
        assert_allclose(mesh.vertices, vertices, rtol=0, atol=1e-6)
        assert_array_equal(mesh.faces, FACES)


def test_ascii_stl_and_ply_are_read(vertices: np.ndarray):
    import trimesh

    surface = trimesh.Trimesh(vertices, FACES, process=False)
    for kind in ("stl_ascii", "ply"):
        options = {"encoding": "ascii"} if kind == "ply" else {}
        payload = surface.export(file_type=kind, **options)
        mesh = read_mesh(payload if isinstance(payload, bytes) else str(payload).encode())
        assert_allclose(mesh.vertices[mesh.faces], vertices[FACES], rtol=0, atol=1e-5)


def test_glb_seams_are_welded_and_uv_kept(vertices: np.ndarray, rng: np.random.Generator):
    split, uv = vertices[FACES.reshape(-1)], rng.random((FACES.size, 2))
    mesh = read_mesh(glb_bytes(split, np.arange(FACES.size), uv))
    assert len(mesh.vertices) == 40
    assert_allclose(mesh.vertices[mesh.faces], vertices[FACES], rtol=0, atol=1e-6)
    assert_allclose(mesh.uv[mesh.uv_faces].reshape(-1, 2), uv * [1, -1] + [0, 1], rtol=0, atol=1e-6)
    assert mesh.material_names == ("denim",)


def test_glb_nodes_place_their_mesh(vertices: np.ndarray):
    def place(document: dict) -> None:
        document["nodes"] = [{"children": [1], "translation": [1, 2, 3]}, {"mesh": 0, "scale": [-2, 2, 2]}]

    mesh = read_mesh(glb_bytes(vertices, FACES, change=place))
    assert_allclose(mesh.vertices, vertices * [-2, 2, 2] + [1, 2, 3], rtol=0, atol=1e-5)
    assert_array_equal(mesh.faces, FACES[:, ::-1])


def set_entry(*path):
    *keys, last, value = path

    def change(document: dict) -> None:
        at = document
        for key in keys:
            at = at[key]
        at[last] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        set_entry("accessors", 0, "count", 100_000_000),
        set_entry("accessors", 0, {"count": 100_000_000, "type": "VEC3", "componentType": 5126}),
        set_entry("accessors", 0, "count", -5),
        set_entry("accessors", 0, "count", float("inf")),
        set_entry("accessors", 0, "componentType", 5130),
        set_entry("accessors", 0, "bufferView", 7),
        set_entry("accessors", 0, "sparse", {"count": 1}),
        set_entry("bufferViews", 1, "byteOffset", 10_000_000),
        set_entry("bufferViews", 1, "byteOffset", -4),
        set_entry("bufferViews", 0, "byteStride", 1),
        set_entry("buffers", 0, "uri", "file.bin"),
        set_entry("extensionsRequired", ["EXT_shapes"]),
        set_entry("nodes", [{"children": [0], "mesh": 0}]),
        set_entry("nodes", [{"mesh": 3}]),
        set_entry("nodes", [{}]),
        set_entry("meshes", 0, "primitives", 0, "mode", 1),
        set_entry("meshes", "none"),
    ],
)
def test_hostile_glb_is_refused_without_memory(change, vertices: np.ndarray):
    payload = glb_bytes(vertices, FACES, change=change)
    tracemalloc.start()
    with pytest.raises(MeshError):
        read_mesh(payload)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60e6


def test_cut_off_files_are_refused(vertices: np.ndarray):
    for payload in (glb_bytes(vertices, FACES), ply_bytes(vertices, FACES), stl_bytes(vertices, FACES)):
        with pytest.raises(MeshError):
            read_mesh(payload[:-60], kind=sniff(payload).name)
    with pytest.raises(MeshError, match=r"vertices|bytes of data"):
        read_mesh(ply_bytes(vertices, FACES, declared=150_000))
