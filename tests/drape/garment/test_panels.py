"""Panels that a file has as pieces of their own, with and without a thickness, and things that lie far from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.garment.cloth_layer import join_sheets
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.outfit import garments_in
from drape.garment.panels import with_sewn_panels
from drape.garment.sheets import pieces_of
from drape.garment.strays import without_strays
from drape.geometry import meshes
from tests.drape.garment.garment_files import shirt

BODY = load_body()
SKIN = BODY.v_template
CLOTH = plain_mesh("shirt", *shirt(BODY, SKIN))
NORMALS = meshes.vertex_normals(CLOTH.vertices, CLOTH.faces)
AREA = float(meshes.face_areas(CLOTH.vertices, CLOTH.faces).sum())


def panels(thick_m: float = 0.0) -> GarmentMesh:
    """The shirt cut into front, back and sleeves, each a piece of its own, and a solid where it is thick.

    The rims lean, so that a smooth way leads over some of them from the outer side to the inner one.
    """
    middles = CLOTH.vertices[CLOTH.faces].mean(axis=1)
    reach = 0.5 * np.abs(CLOTH.vertices[:, 0]).max()
    panel = np.select([middles[:, 0] > reach, middles[:, 0] < -reach, middles[:, 2] > 0.0], [0, 1, 2], 3)
    vertices, faces, count = [], [], 0
    for number in range(4):
        used, own = meshes.in_use(CLOTH.faces[panel == number])
        outside = CLOTH.vertices[used]
        if thick_m:
            rims, first = meshes.boundary_edges(own), len(used)
            inside = outside - thick_m * NORMALS[used] * np.linspace(0.4, 1.0, first)[:, None]
            a, b = rims.T
            rim = np.concatenate([np.stack([a, b, b + first], 1), np.stack([a, b + first, a + first], 1)])
            outside, own = np.concatenate([outside, inside]), np.concatenate([own, own[:, ::-1] + first, rim])
        faces.append(own + count)
        vertices.append(outside + 2e-4 * number)
        count += len(outside)
    return plain_mesh("shirt", np.concatenate(vertices), np.concatenate(faces))


@pytest.mark.parametrize("thick_m", [0.0, 0.001, 0.004])
def test_panels_whose_borders_run_along_each_other_are_one_cloth(thick_m: float):
    mesh = panels(thick_m)
    sheets = join_sheets(mesh)
    sewn, _ = with_sewn_panels(sheets, SKIN)
    area = pieces_of(sewn.vertices, sewn.faces)[1]
    assert area[0] == pytest.approx(AREA, rel=0.02)
    assert area[0] > 0.98 * area.sum()
    assert garments_in(sewn, SKIN, BODY).max() == 0
    assert np.array_equal(sewn.vertices[: len(sheets.vertices)], sheets.vertices)


def test_a_border_with_fewer_vertices_leaves_no_slit():
    """A coarse cloth and a fine one, side by side in a plane: the triangles at the seam are cut at its vertices."""

    def strip(left: float, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
        x, y = np.meshgrid(left + np.linspace(0.0, 0.5, columns), np.linspace(0.0, 0.6, rows), indexing="ij")
        at = np.arange(columns * rows).reshape(columns, rows)
        a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
        faces = np.concatenate([np.stack(one, axis=-1).reshape(-1, 3) for one in ((a, b, c), (a, c, d))])
        return np.stack([x, y, np.full_like(x, 0.3)], axis=-1).reshape(-1, 3), faces

    (coarse, own), (fine, others) = strip(-0.5, 6, 7), strip(0.0, 6, 19)
    uv = np.concatenate([coarse, fine])[:, :2]
    faces = np.concatenate([own, others + len(coarse)])
    mesh = replace(plain_mesh("two", np.concatenate([coarse, fine]), faces), uv=uv, uv_faces=faces)
    sewn, _ = with_sewn_panels(mesh, SKIN)
    loop = meshes.boundary_loops(sewn.faces)
    assert len(loop) == 1
    assert float(meshes.face_areas(sewn.vertices, sewn.faces).sum()) == pytest.approx(0.6)
    placed = np.column_stack([sewn.uv, np.full(len(sewn.uv), 0.3)])
    assert placed[sewn.uv_faces] == pytest.approx(sewn.vertices[sewn.faces])


def test_pieces_without_a_seam_and_single_ones_stay_as_they_are():
    assert with_sewn_panels(CLOTH, SKIN)[0] is CLOTH
    apart = plain_mesh(
        "two",
        np.concatenate([CLOTH.vertices, 0.5 * CLOTH.vertices - np.array([0.0, 0.6, 0.0])]),
        np.concatenate([CLOTH.faces, CLOTH.faces + len(CLOTH.vertices)]),
    )
    assert with_sewn_panels(apart, SKIN)[0] is apart


def test_what_lies_far_away_is_left_out_and_told():
    count = len(CLOTH.vertices)
    button = np.array([[1.0, 100.0, 9.0], [3.0, 100.0, 9.0], [1.0, 102.0, 9.0]])
    vertices = np.concatenate([CLOTH.vertices, button])
    faces = np.concatenate([CLOTH.faces, [[count, count + 1, count + 2]]])
    kept = without_strays(plain_mesh("shirt", vertices, faces))
    assert np.array_equal(kept.vertices, CLOTH.vertices)
    assert np.array_equal(kept.faces, CLOTH.faces)
    assert "101 units away is left out, 1 faces" in kept.notes[-1]
    near = replace(kept, vertices=CLOTH.vertices)
    assert without_strays(near) is near


def test_a_second_garment_far_away_is_no_stray():
    count = len(CLOTH.vertices)
    vertices = np.concatenate([CLOTH.vertices, CLOTH.vertices + np.array([50.0, 0.0, 0.0])])
    both = plain_mesh("shirts", vertices, np.concatenate([CLOTH.faces, CLOTH.faces + count]))
    assert without_strays(both) is both
