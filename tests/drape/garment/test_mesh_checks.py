"""One fault per mesh: it is refused by its name, or cured and noted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import MeshError
from drape.garment import mesh_checks
from drape.garment.avatars import Avatar, phenotype_avatar, standard_avatar
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.mesh_checks import check_arrays, check_mesh, check_surface, orient_outward, place_on_avatar
from drape.geometry import meshes
from tests.drape.garment.garment_files import shirt
from tests.drape.geometry.geometry_shapes import box

BODY = load_body()
AVATAR = phenotype_avatar({"gender": 0.2}, BODY)
CLOTH = plain_mesh("shirt", *shirt(BODY, AVATAR.vertices))


def on_avatar(mesh: GarmentMesh, avatar: Avatar = AVATAR, **asked: Any) -> GarmentMesh:
    return check_mesh(place_on_avatar(check_surface(mesh), avatar, **asked), avatar)


def with_faces(*extra: list[int]) -> GarmentMesh:
    return plain_mesh("shirt", CLOTH.vertices, np.concatenate([CLOTH.faces, np.array(extra)]))


def test_sound_garment_passes_unchanged():  # cut from the skin, so its normals point away from it
    checked = on_avatar(CLOTH)
    assert_array_equal(checked.vertices, CLOTH.vertices)
    assert_array_equal(checked.faces, CLOTH.faces)
    assert checked.notes == ("4 openings",)


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (plain_mesh("a", np.zeros((0, 3)), np.zeros((0, 3))), "vertices and faces"),
        (plain_mesh("a", CLOTH.vertices, np.zeros((0, 3))), "vertices and faces"),
        (plain_mesh("a", np.eye(3), [[0, 1, 2]]), "at least 24 vertices"),
        (plain_mesh("a", 0.0 * CLOTH.vertices, CLOTH.faces), "scale is 0"),
        (plain_mesh("a", np.ones((1, 3)), [[0, 0, 0]]), "scale is 0"),
        (
            replace(CLOTH, vertices=np.where(np.arange(len(CLOTH.vertices))[:, None] == 7, np.nan, CLOTH.vertices)),
            "finite",
        ),
        (with_faces([0, 1, len(CLOTH.vertices)]), "indices in"),
        (with_faces([0, 1, -1]), "indices in"),
        (with_faces([*CLOTH.faces[0, :2], len(CLOTH.vertices) - 1]), "2 faces at every edge"),
    ],
)
def test_fault_is_refused_by_name(mesh: GarmentMesh, message: str):
    with pytest.raises(MeshError, match=message):
        on_avatar(mesh)


def test_vertex_limit_is_held():
    with pytest.raises(MeshError, match="at most 100 vertices"):
        check_arrays(CLOTH, vertex_limit=100)
    many = replace(CLOTH, vertices=np.zeros((mesh_checks.VERTEX_LIMIT + 1, 3)))
    with pytest.raises(MeshError, match=f"at most {mesh_checks.VERTEX_LIMIT:,} vertices"):
        check_arrays(many)


def test_bad_faces_are_dropped_with_a_note():
    checked = on_avatar(with_faces(CLOTH.faces[10], [3, 3, 5]))
    assert_array_equal(checked.faces, CLOTH.faces)
    assert "dropped 1 degenerate and 1 duplicated faces" in checked.notes
    with pytest.raises(MeshError, match="faces with an area"):
        on_avatar(plain_mesh("a", CLOTH.vertices, [[0, 0, 1]]))


@pytest.mark.parametrize("unit", ["cm", "dm", "mm", "inch"])
@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("floor", [False, True])
def test_unit_axis_and_floor_are_recognised(unit: str, up: str, floor: bool):
    given = CLOTH.vertices - [0.0, AVATAR.vertices[:, 1].min() if floor else 0.0, 0.0]
    if up == "z":
        given = np.stack([given[:, 0], -given[:, 2], given[:, 1]], axis=1)
    mesh = replace(CLOTH, vertices=given / mesh_checks.UNITS_M[unit])
    checked = on_avatar(mesh)
    assert_allclose(checked.vertices, CLOTH.vertices, rtol=0, atol=1e-9)
    assert f"converted from {unit} to m" in checked.notes
    assert_allclose(on_avatar(mesh, unit=unit, up=up).vertices, checked.vertices, rtol=0, atol=0)


@pytest.mark.parametrize(("option", "value"), [("unit", "yard"), ("up", "x")])
def test_unknown_option_is_refused(option: str, value: str):
    with pytest.raises(MeshError, match=option):
        on_avatar(CLOTH, AVATAR, **{option: value})


def test_garment_elsewhere_is_refused():
    with pytest.raises(MeshError, match="a garment on its avatar"):
        on_avatar(replace(CLOTH, vertices=CLOTH.vertices + np.array([3.0, 0.0, 0.0])))
    with pytest.raises(MeshError, match="a garment on the standard body"):
        on_avatar(CLOTH, standard_avatar(BODY), named=False)


def test_points_below_the_skin_fit_worse_than_as_far_outside():
    normals = meshes.vertex_normals(AVATAR.vertices, AVATAR.faces)
    trunk = BODY.weights[:, 0] > 0.5  # the pelvis
    extent = np.ptp(AVATAR.vertices[trunk], axis=0).max()
    shallow, deep, outside = (
        mesh_checks.misfit((AVATAR.vertices + away_m * normals)[trunk], AVATAR, normals)
        for away_m in (-0.006, -0.03, 0.03)
    )
    assert shallow < 0.01 / extent
    assert deep > 2.5 * outside


def test_equal_units_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(mesh_checks.UNITS_M, "hand", 0.01005)
    with pytest.raises(MeshError, match=r"cm or hand|hand or cm"):
        on_avatar(replace(CLOTH, vertices=CLOTH.vertices * 100.0))


def test_a_handkerchief_is_refused():
    few = CLOTH.faces[:40]
    used, inverse = np.unique(few, return_inverse=True)
    mesh = plain_mesh("a", CLOTH.vertices[used], inverse)
    with pytest.raises(MeshError, match="garment"):
        on_avatar(mesh, unit="m", up="y")


def test_winding_becomes_consistent_and_outward(rng: np.random.Generator):
    turned = rng.random(len(CLOTH.faces)) < 0.3
    uv, uv_faces = rng.random((5, 2)), rng.integers(0, 5, size=CLOTH.faces.shape)
    straight = replace(CLOTH, uv=uv, uv_faces=uv_faces)
    mixed = replace(
        straight,
        faces=np.where(turned[:, None], CLOTH.faces[:, ::-1], CLOTH.faces),
        uv_faces=np.where(turned[:, None], uv_faces[:, ::-1], uv_faces),
    )
    inward = replace(straight, faces=CLOTH.faces[:, ::-1], uv_faces=uv_faces[:, ::-1])
    for mesh in (mixed, inward):
        checked = on_avatar(mesh)
        assert_array_equal(checked.faces, CLOTH.faces)
        assert_array_equal(checked.uv_faces, uv_faces)
        assert any("normals point outward" in note for note in checked.notes)


def test_one_sided_surface_is_refused():
    around = 40
    angle = np.linspace(0.0, 2 * np.pi, around, endpoint=False)
    centre = np.stack([0.3 * np.cos(angle), np.zeros(around), 0.3 * np.sin(angle)], axis=1)
    across = np.stack([np.cos(angle / 2) * np.cos(angle), np.sin(angle / 2), np.cos(angle / 2) * np.sin(angle)], axis=1)
    strip = np.concatenate([centre + 0.1 * across, centre - 0.1 * across])
    faces = []
    for j in range(around):
        a, b = j, (j + 1) % around
        c, d = (a + around, b + around) if b else (a + around, 0)
        b = b if b else around
        faces += [[a, b, c], [b, d, c]]
    with pytest.raises(MeshError, match="two sides"):
        orient_outward(plain_mesh("moebius", strip, faces), AVATAR)


def test_pieces_closed_pieces_and_unused_vertices_are_noted():
    cube, solid = box((0.01, 0.01, 0.01))
    cube = cube + CLOTH.vertices[0] + [0.0, 0.0, 0.04]
    count = len(CLOTH.vertices)
    mesh = plain_mesh(
        "a", np.concatenate([CLOTH.vertices, cube, [[0.0, 9.0, 0.0]]]), np.concatenate([CLOTH.faces, solid + count])
    )
    checked = on_avatar(mesh)
    text = " | ".join(checked.notes)
    assert f"2 pieces with {count}, 8 vertices" in text
    assert "1 closed piece" in text
    assert "1 vertices belong to no face" in text
    assert len(checked.vertices) == len(mesh.vertices)
