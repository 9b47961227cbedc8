"""The hem and how low it hangs, on meshes whose answer is known and on shipped garments."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.measure.hem import hang_mm, hem_vertices
from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere


def test_a_sheet_hangs_by_what_its_lower_border_sank_weighted_by_length():
    rest, faces = grid(4, 20, cell_m=0.01)
    x = np.where(rest[:, 0] < 0.005, 0.0, rest[:, 0] + 0.04)  # the first of four columns is five times as wide
    rest = rest * [0.0, 1.0, 1.0] + x[:, None] * [1.0, 0.0, 0.0]
    hem = hem_vertices(rest, faces)
    assert set(hem) >= set(np.flatnonzero(rest[:, 1] == 0.0))
    assert rest[hem, 1].max() <= 0.1 * rest[:, 1].max() + 1e-12
    sunk = np.stack([rest, rest - [0.0, 0.03, 0.0], rest])
    assert_allclose(hang_mm(sunk, np.stack([rest] * 3), rest, faces), [0.0, 30.0, 0.0], rtol=0, atol=1e-9)
    # One corner alone: half of the wide edge, and the side's two edges that lie in the hem with it.
    one = rest.copy()
    one[(rest[:, 0] == 0.0) & (rest[:, 1] == 0.0), 1] -= 0.03
    share = (0.025 + 0.005) / (0.08 + 2 * 0.02)
    assert_allclose(hang_mm(one[None], rest[None], rest, faces), [30.0 * share], rtol=1e-9, atol=0.0)
    assert hang_mm(one[None].astype(np.float32), rest[None], rest, faces).dtype == np.float64


def test_a_closed_mesh_has_no_hem():
    rest, faces = icosphere(1, radius_m=0.1)
    assert len(hem_vertices(rest, faces)) == 0
    assert np.isnan(hang_mm(rest[None], rest[None], rest, faces)).all()


@pytest.mark.parametrize(("name", "rims"), [("tshirt", 1), ("trousers", 2), ("dress", 1)])
def test_the_hem_of_a_shipped_garment_is_its_lowest_rims_whole(name, rims):
    garment = open_garment(find_garments([name])[0], load_body())
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    loops = sorted(meshes.boundary_loops(faces), key=lambda loop: rest[loop, 1].mean())
    assert set(hem_vertices(rest, faces)) == set(np.concatenate(loops[:rims]))
    lower = rest[None] - [0.0, 0.012, 0.0]
    assert_allclose(hang_mm(lower, rest[None], rest, faces), 12.0, rtol=1e-9, atol=0.0)
