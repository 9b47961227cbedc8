"""The JSON beside a sewn mesh: read where it belongs to it, refused where it is broken, and the folds that it makes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.errors import InputError
from drape.garment.files.mesh import GarmentMesh
from drape.garment.grain import corner_uv
from drape.garment.sewing import FreeEdge, Seam, Sewing, near_lines, read_sewing, sewing_beside, sewn_hinges
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid

ROWS = 6


def strip() -> tuple[GarmentMesh, Sewing]:
    """Two panels of 5 by 4 squares of 1 cm, sewn along the column at 4 cm and folded there; the left rim is a hem."""
    vertices, faces = grid(8, ROWS - 1)
    x = np.rint(100.0 * vertices[:, 0])
    right = vertices[faces][..., 0].mean(axis=1) > 0.04
    seam = np.flatnonzero(x == 4)
    # The right panel has rows of its own along the seam, 10 cm farther in uv.
    uv = np.concatenate([vertices[:, :2] + 0.1 * (x > 4)[:, None] * [1.0, 0.0], vertices[seam, :2] + [0.1, 0.0]])
    other = np.arange(len(vertices))
    other[seam] = len(vertices) + np.arange(ROWS)
    uv_faces = np.where(right[:, None], other[faces], faces)
    mesh = GarmentMesh("strip", vertices, faces, uv, uv_faces, ("left", "right"), right.astype(np.int64))
    rows = tuple(seam.tolist())
    rim = tuple(np.flatnonzero(x == 0).tolist())
    sewing = Sewing(
        name="strip",
        fabric="denim",
        mesh="strip.obj",
        uv_unit_m=1.0,
        hem_bending=3.0,
        hem_width_m=0.015,
        panels=("left", "right"),
        seams=(Seam("middle", ("left", "right"), -1.2, rows, (rows, tuple(other[seam].tolist()))),),
        edges=(FreeEdge("hem", "hem", "left", rim, rim), FreeEdge("side", "free", "right", (48, 49), (48, 49))),
    )
    return mesh, sewing


def written(folder: Path, record: object, name: str = "strip.json") -> Path:
    """The path of the mesh that ``record`` lies beside."""
    (folder / name).write_text(json.dumps(record))
    return folder / "strip.obj"


def test_what_is_written_is_read_again(tmp_path):
    _, sewing = strip()
    path = written(tmp_path, sewing.to_json())
    found = sewing_beside(path)
    assert found is not None and found.to_json() == json.loads(json.dumps(sewing.to_json()))


def test_nothing_lies_beside_a_mesh_of_its_own(tmp_path):
    _, sewing = strip()
    assert sewing_beside(tmp_path / "strip.obj") is None
    for other in ({"seconds": 3.0}, [1, 2], "strip"):
        assert sewing_beside(written(tmp_path, other)) is None
    (tmp_path / "strip.json").write_text("no JSON")
    assert sewing_beside(tmp_path / "strip.obj") is None
    written(tmp_path, sewing.to_json())
    assert sewing_beside(tmp_path / "strip.glb") is None  # its vertices are split, so its rows are others


def test_sewings_that_do_not_hold_together_are_refused(tmp_path):
    mesh, sewing = strip()
    with pytest.raises(InputError, match=r"version: expected 1, got 2\. Write the garment again"):
        sewing_beside(written(tmp_path, sewing.to_json() | {"version": 2}))
    record = {key: value for key, value in sewing.to_json().items() if key not in ("format", "version")}
    for spoilt in ({**record, "seams": [{"name": "a"}]}, {**record, "colour": "red"}, {"name": "strip"}):
        with pytest.raises(InputError, match="sewing strip: expected the fields of"):
            read_sewing(spoilt)
    sewing.check(mesh)
    for low in (-1, len(mesh.vertices)):
        with pytest.raises(InputError, match=rf"sewing strip vertices: expected rows .* got {low}\."):
            replace(sewing, edges=(replace(sewing.edges[0], vertices=(low,)),)).check(mesh)
    with pytest.raises(InputError, match="sewing strip uv: expected rows of the mesh, below 60, got 60"):
        replace(sewing, edges=(replace(sewing.edges[0], uv=(60,)),)).check(mesh)


@pytest.mark.parametrize("rounds", [0, 1])
def test_seams_are_folded_and_hems_are_stiff_on_every_subdivision(rounds: int):
    mesh, sewing = strip()
    vertices, faces = mesh.vertices, mesh.faces
    for _ in range(rounds):
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    on_corners = corner_uv(mesh.uv, mesh.uv_faces, len(faces))
    assert on_corners is not None
    found = sewn_hinges(sewing, mesh, np.arange(len(mesh.vertices)), faces, on_corners)
    ends = vertices[meshes.hinges(faces)[:, :2], 0]
    assert_array_equal(found.angle, np.where((np.abs(ends - 0.04) < 1e-9).all(axis=1), -1.2, 0.0))
    assert (found.angle != 0.0).sum() == 5 * 2**rounds
    assert_array_equal(found.stiffening, np.where((ends < 0.015 - 1e-9).all(axis=1), 3.0, 1.0))


def test_rows_count_delivered_vertices_also_those_that_no_face_uses():
    mesh, sewing = strip()
    on_corners = corner_uv(mesh.uv, mesh.uv_faces, len(mesh.faces))
    assert on_corners is not None
    still = sewn_hinges(sewing, mesh, np.arange(len(mesh.vertices)), mesh.faces, on_corners)
    # Two unused vertices first: the file's rows are two higher, and they follow the nearest used ones.
    kept = np.concatenate([[0, 0], np.arange(len(mesh.vertices))])
    shifted = replace(
        sewing, seams=tuple(replace(seam, vertices=[v + 2 for v in seam.vertices]) for seam in sewing.seams)
    )
    found = sewn_hinges(shifted, mesh, kept, mesh.faces + 2, on_corners)
    assert_array_equal(found.angle, still.angle)
    assert_array_equal(found.stiffening, still.stiffening)


def test_a_line_is_near_on_its_own_panel_only():
    points = np.array([[0.0, 0.5], [0.2, 0.5], [0.0, 1.3], [0.0, 0.5]])
    line = np.array([[0.0, 0.0], [0.0, 0.4], [0.0, 1.2]])
    assert_array_equal(near_lines(points, np.array([0, 0, 0, 1]), [(0, line)], 0.15), [True, False, True, False])
