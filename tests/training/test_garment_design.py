"""Designs: clean cuts, clear of the body, and the openings they should have."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from drape.garment.cache import load_garment
from drape.geometry.closest import signed_distance
from tests.drape.cloth.cloth_shapes import grid
from tests.training.training_setup import body
from training.garment_design import DESIGNS, SIX, SLIVER_SHARE, build_design, main, vary_design
from training.mesh_cut import cut_mesh

OPENINGS = {"tshirt": 4, "longsleeve": 4, "tank": 4, "dress": 4, "trousers": 3, "shorts": 3, "skirt": 2}


def test_a_straight_cut_leaves_the_exact_area_and_a_straight_edge():
    vertices, faces = grid(11, 11, cell_m=1.0 / 11.0)
    kept, kept_faces, carried = cut_mesh(
        vertices, faces, vertices[:, 0] + 0.3 * vertices[:, 1] - 0.537, vertices[:, :1]
    )
    mesh = trimesh.Trimesh(kept, kept_faces, process=False)
    # The line x = 0.537 - 0.3 y cuts off a trapezium of mean width 0.387.
    assert_allclose(mesh.area, 1.0 - (0.537 + 0.237) / 2.0, rtol=2e-2, atol=0)
    assert_allclose(carried[:, 0], kept[:, 0], rtol=0, atol=1e-12)
    assert (kept[:, 0] + 0.3 * kept[:, 1] - 0.537).min() > -1e-9
    assert mesh.is_winding_consistent


@pytest.mark.parametrize("design", DESIGNS.values(), ids=lambda d: d.name)
def test_designs_are_clear_and_have_their_openings(design):
    vertices, faces = build_design(design, body())
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert signed_distance(vertices, body().v_template, body().faces).min() >= 0.006
    assert mesh.euler_number == 2 - OPENINGS[design.name]
    assert mesh.is_winding_consistent
    assert len(trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(faces)))) == 1
    # Outward: normals agree with the direction away from the body.
    ahead = vertices + 0.002 * np.asarray(mesh.vertex_normals)
    near, far = (signed_distance(points, body().v_template, body().faces) for points in (vertices, ahead))
    assert (far > near).mean() > 0.97


def test_building_twice_gives_the_same_mesh():
    first, second = (build_design(SIX[2], body()) for _ in range(2))
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])


def test_variants_differ_but_keep_their_openings():
    rng = np.random.default_rng(1)
    base = trimesh.Trimesh(*build_design(SIX[2], body()), process=False)
    seen = set()
    for _ in range(2):
        design, vertices, faces = vary_design(SIX[2], body(), rng)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.euler_number == base.euler_number
        assert mesh.area_faces.min() > SLIVER_SHARE * mesh.area_faces.mean()
        seen.add(design)
    assert len(seen) == 2


def test_the_command_writes_the_caches_of_the_designs_that_it_is_told(tmp_path, capsys):
    main(["tank", "--out", str(tmp_path)])
    (path,) = tmp_path.iterdir()
    garment = load_garment(path)
    assert garment.manifest["design"]["name"] == "tank" and "tank" in capsys.readouterr().out
    assert (len(garment.uv), garment.rest_edges) == (0, None)
    with pytest.raises(SystemExit):
        main(["toga", "--out", str(tmp_path)])
    assert "got toga" in capsys.readouterr().err
