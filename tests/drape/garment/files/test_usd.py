"""Garments in USD: what is drawn is read, in the unit and axis that the file states; all else is refused in words."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import MeshError
from drape.files.formats import sniff
from drape.garment.files.mesh import read_mesh

sdf = pytest.importorskip("pxr.Sdf", reason="No usd-core: `pip install usd-core`.")
utilities = pytest.importorskip("pxr.UsdUtils")

SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)]


def text(body: str, head: str = "") -> bytes:
    return f"#usda 1.0\n({head})\n{body}".encode()


def mesh(name: str = "Shirt", more: str = "", corners: str = "0, 1, 2, 3, 1, 4, 2", counts: str = "4, 3") -> str:
    points = ", ".join(map(str, SQUARE))
    return (
        f'def Mesh "{name}"\n{{\n  point3f[] points = [{points}]\n  int[] faceVertexCounts = [{counts}]\n'
        f"  int[] faceVertexIndices = [{corners}]\n{more}\n}}\n"
    )


def read(payload: bytes, **options):
    return read_mesh(payload, name="shirt", **options)


def test_polygons_become_fans_and_every_kind_of_file_is_known_by_its_bytes(tmp_path: Path):
    payload = text(mesh())
    (tmp_path / "a.usda").write_bytes(payload)
    layer = sdf.Layer.FindOrOpen(str(tmp_path / "a.usda"))
    layer.Export(str(tmp_path / "a.usdc"))
    utilities.CreateNewUsdzPackage(str(tmp_path / "a.usdc"), str(tmp_path / "a.usdz"))
    for suffix in ("usda", "usdc", "usdz"):
        held = (tmp_path / f"a.{suffix}").read_bytes()
        assert sniff(held).name == suffix
        found = read(held)
        assert_array_equal(found.faces, [[0, 1, 2], [0, 2, 3], [1, 4, 2]])
        assert_allclose(found.vertices, SQUARE)
        assert found.notes == ("1 polygons triangulated",)


def test_unit_axis_and_place_are_those_that_the_file_states():
    moved = '  double3 xformOp:translate = (0, 0, 100)\n  uniform token[] xformOpOrder = ["xformOp:translate"]'
    found = read(text(mesh(more=moved), 'metersPerUnit = 0.01\n upAxis = "Z"'))
    assert_allclose(found.vertices[2], [0.01, 1.0, -0.01])
    assert found.notes[1:] == ("the file states its unit: 0.01 m", "turned from z up to y up")


def test_a_unit_in_which_nothing_is_worn_is_warned_of_and_does_not_count():
    """Centimetres are stated of metres: a garment of 2 cm was no garment."""
    found = read(text(mesh(), "metersPerUnit = 0.01"))
    assert_allclose(found.vertices, SQUARE)
    assert found.notes[1].startswith("warning: the file states its unit, 0.01 m, in which it all lies within 2 cm")


@pytest.mark.parametrize(
    "more",
    [
        '  uniform token orientation = "leftHanded"',
        '  float3 xformOp:scale = (-1, 1, 1)\n  uniform token[] xformOpOrder = ["xformOp:scale"]',
    ],
)
def test_a_mesh_of_the_other_hand_is_turned(more: str):
    def normal_z(payload: bytes) -> float:
        found = read(payload)
        a, b, c = found.vertices[found.faces[0]]
        return float(np.cross(b - a, c - a)[2])

    left = normal_z(text(mesh(more=more)))
    # A mirror keeps what is outside; the other hand says that the winding is the other way round.
    assert np.sign(left) == (-1.0 if "leftHanded" in more else 1.0) * np.sign(normal_z(text(mesh())))


@pytest.mark.parametrize(
    ("values", "interpolation"),
    [
        ("(0, 0), (1, 0), (1, 1), (0, 1), (2, 0)", "vertex"),
        ("(0,0),(1,0),(1,1),(0,1),(1,0),(2,0),(1,1)", "faceVarying"),
    ],
)
def test_texture_coordinates_come_by_corner(values: str, interpolation: str):
    more = f'  texCoord2f[] primvars:st = [{values}] (interpolation = "{interpolation}")'
    found = read(text(mesh(more=more)))
    assert_allclose(found.uv[found.uv_faces], found.vertices[found.faces][:, :, :2])


def test_coordinates_of_a_type_that_nobody_knows_count_as_none():
    unknown = "  tEXCoord2f[] primvars:st = [(0, 0)]\n"
    assert not len(read(text(mesh(more=unknown))).uv_faces)


def test_only_what_is_drawn_counts_and_materials_keep_their_names():
    hidden = mesh("Hidden", '  token visibility = "invisible"') + mesh("Proxy", '  uniform token purpose = "proxy"')
    bound = '  rel material:binding = </Denim>\n  prepend apiSchemas = ["MaterialBindingAPI"]'
    bound = mesh("Legs", "  rel material:binding = </Denim>").replace(
        '"Legs"', '"Legs" (prepend apiSchemas = ["MaterialBindingAPI"])'
    )
    found = read(text(hidden + bound + 'def Material "Denim"\n{\n}\n'))
    assert len(found.faces) == 3 and found.material_names == ("Denim",)


@pytest.mark.parametrize(
    ("payload", "match"),
    [
        (text('def "A" (references = @/etc/other.usda@)\n{\n}\n'), "one file that holds everything.*other.usda"),
        (text('def "A" (payload = @./other.usda@)\n{\n}\n'), "one file that holds everything"),
        (text('def Xform "A"\n{\n}\n'), "a mesh that is drawn"),
        (text(mesh(corners="0, 1, 2, 3, 1, 4, 9")), "corners below 5.*0 to 9"),
        (text(mesh(counts="4, 2")), "three and more corners"),
        (b"#usda 1.0\ndef Mesh {", "a readable USD file"),
        (b"PXR-USDC" + bytes(80), "a readable USD file"),
    ],
)
def test_what_is_no_garment_is_refused(payload: bytes, match: str):
    with pytest.raises(MeshError, match=match):
        read(payload)


def test_too_many_vertices_and_prims_are_refused(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(MeshError, match="at most 4 vertices"):
        read(text(mesh()), vertex_limit=4)
    monkeypatch.setattr("drape.garment.files.usd.MOST_PRIMS", 1)
    with pytest.raises(MeshError, match="at most 1 prims"):
        read(text(mesh("A") + mesh("B")))


def test_without_the_package_its_name_is_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "pxr.Sdf", None)
    with pytest.raises(MeshError, match="pip install usd-core"):
        read(text(mesh()))


def test_spoilt_bytes_are_a_mesh_or_a_refusal(tmp_path: Path):
    (tmp_path / "a.usda").write_bytes(text(mesh()))
    sdf.Layer.FindOrOpen(str(tmp_path / "a.usda")).Export(str(tmp_path / "a.usdc"))
    whole, draw, refused = (tmp_path / "a.usdc").read_bytes(), np.random.default_rng(0), 0
    for number in range(60):
        spoilt = bytearray(whole[: draw.integers(len(whole))] if number % 3 == 0 else whole)
        for at in draw.integers(len(spoilt), size=1 + number % 5):
            spoilt[at] = draw.integers(256)
        try:
            read(bytes(spoilt), kind="usdc")
        except MeshError:
            refused += 1
    assert refused > 20
