"""Garments in FBX: meshes in metres, y up, with the colours and pictures of their materials; all else in words."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import MeshError
from drape.files.formats import sniff
from drape.garment.files.mesh import GarmentMesh, read_mesh
from tests.drape.garment.files.test_looks import picture, zipped
from tests.fixtures.fbx_writer import fbx_bytes, fbx_of

pytest.importorskip("ufbx", reason="No ufbx: `pip install ufbx`.")

SQUARE = np.array([(0, 0, 0), (100, 0, 0), (100, 100, 0), (0, 100, 0), (200, 0, 0)], dtype=float)
POLYGONS = ((0, 1, 2, 3), (1, 4, 2))
UV = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0), (1, 0), (0.5, 1)], dtype=float)
RED = (200, 30, 20)


def read(payload: bytes, **options) -> GarmentMesh:
    return read_mesh(payload, name="shirt", **options)


def test_polygons_become_fans_in_metres_with_texture_coordinates_by_corner():
    payload = fbx_of(SQUARE, POLYGONS, UV)
    assert sniff(payload).name == "fbx"
    found = read(payload)
    assert_array_equal(found.faces, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])
    assert_allclose(found.vertices, 0.01 * SQUARE, atol=1e-12)
    assert_allclose(found.uv[found.uv_faces].reshape(-1, 2), UV[[0, 1, 2, 0, 2, 3, 4, 5, 6]])
    assert found.notes == ("1 polygons triangulated", "the file states its unit: 0.01 m")


def test_it_is_read_on_windows_which_has_no_limits_of_processes():
    there = "import runpy, sys, numpy, ufbx; sys.platform = 'win32'; sys.modules['resource'] = None; "
    there += "runpy.run_module('drape.files.fbx_process', run_name='__main__')"
    command = [sys.executable, "-c", there]
    ended = subprocess.run(command, input=fbx_of(SQUARE, POLYGONS, UV), capture_output=True, check=True)
    with np.load(io.BytesIO(ended.stdout)) as found:
        assert any(name.endswith(".vertices") for name in found.files)


def test_a_unit_in_which_nothing_is_worn_is_warned_of_and_does_not_count():
    found = read(fbx_of(0.01 * SQUARE, POLYGONS, UV))
    assert_allclose(found.vertices, 0.01 * SQUARE)
    assert found.notes[1].startswith("warning: the file states its unit, 0.01 m, in which it all lies within")


def test_unit_axis_and_place_are_those_that_the_file_states():
    found = read(fbx_of(SQUARE, POLYGONS, UV, unit_cm=100.0, up=2, place=(0.0, 0.0, 3.0)))
    assert_allclose(found.vertices[2], [100.0, 3.0, -100.0], atol=1e-9)
    mirrored = read(fbx_of(SQUARE, POLYGONS, UV, scale=(-1.0, 1.0, 1.0)))
    assert_allclose(mirrored.vertices[1], [-1.0, 0.0, 0.0], atol=1e-12)
    assert_array_equal(mirrored.faces[0], [2, 1, 0])


def test_materials_keep_their_faces_colours_and_pictures():
    inside = picture(RED)
    payload = fbx_of(SQUARE, POLYGONS, UV, material=(1, 0), pictures=(("red.png", inside),))
    found = read(payload)
    assert found.material_names == ("trim", "cloth") or found.material_names == ("cloth", "trim")
    names = [found.material_names[number] for number in found.face_material]
    assert names == ["trim", "trim", "cloth"]
    looks = dict(zip(found.material_names, found.looks.materials, strict=True))
    cloth, trim = looks["cloth"], looks["trim"]
    assert cloth is not None and trim is not None
    assert cloth.pictures == {"base_colour": 0} and cloth.base_colour == (1.0, 1.0, 1.0, 1.0)
    assert_allclose(trim.base_colour, (0.1, 0.5, 0.1, 1.0), atol=1e-6)
    assert len(found.looks.pictures) == 1


def test_a_picture_beside_is_found_in_a_zip_and_a_missing_one_is_told():
    payload = fbx_of(SQUARE, POLYGONS, UV, pictures=(("red.png", b""),))
    found = read(zipped({"shirt.fbx": payload, "tex/red.png": picture(RED)}))
    assert len(found.looks.pictures) == 1
    bare = read(payload)
    assert bare.looks.pictures == () and any("is not beside the mesh" in note for note in bare.notes)


@pytest.mark.parametrize(
    ("payload", "match"),
    [
        (b"Kaydara FBX Binary  \x00\x1a\x00", "a readable FBX file"),
        (b"; FBX 7.4.0 project file\nFBXHeaderExtension: {", "a mesh that is drawn|a readable FBX file"),
        (fbx_bytes([("Objects", [], [])]), "a mesh that is drawn"),
        (fbx_of(np.full((5, 3), np.nan), POLYGONS, UV), "finite vertices"),
    ],
)
def test_what_is_no_garment_is_refused(payload: bytes, match: str):
    with pytest.raises(MeshError, match=match):
        read(payload, kind="fbx")


def test_a_reader_that_ends_or_takes_too_long_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    payload = fbx_of(SQUARE, POLYGONS, UV)
    for words, match in (("kill -SEGV $$", "at which its reader ends"), ("kill -XCPU $$", "takes too long")):
        reader = tmp_path / "reader"
        reader.write_text(f"#!/bin/sh\n{words}\n")
        reader.chmod(0o755)
        monkeypatch.setattr("sys.executable", str(reader))
        with pytest.raises(MeshError, match=match):
            read(payload)
    reader.write_text("#!/bin/sh\nsleep 20\n")
    monkeypatch.setattr("drape.files.fbx.WAIT_S", 0.2)
    with pytest.raises(MeshError, match="no end by then"):
        read(payload)


def test_too_many_vertices_are_refused():
    with pytest.raises(MeshError, match="at most 4 vertices"):
        read(fbx_of(SQUARE, POLYGONS, UV), vertex_limit=4)


def test_without_the_package_what_to_do_is_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drape.files.fbx.find_spec", lambda name: None)
    with pytest.raises(MeshError, match=r"pip install 'patchdrape\[fbx\]'\), or export the mesh as GLB"):
        read(fbx_of(SQUARE, POLYGONS, UV))
