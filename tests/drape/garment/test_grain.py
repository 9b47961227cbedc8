"""Grain and panels from uv: what is a flattening, and which way its warp runs."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.rest_state import grain_along
from drape.errors import InputError
from drape.garment.grain import CornerUv, corner_uv, panel_unit, read_grain
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, random_rotation, tube

AROUND, ALONG, RADIUS_M, HEIGHT_M = 48, 10, 0.1, 0.3


def unrolled(unit_m: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A tube and its uv: cut open behind its last column, rolled out to ``unit_m`` metres per unit."""
    vertices, faces = tube(AROUND, ALONG, radius_m=RADIUS_M, height_m=HEIGHT_M)
    column, level = faces % AROUND, faces // AROUND
    column = np.where((column == 0) & (column.max(axis=1, keepdims=True) > 1), AROUND, column)
    side = 2.0 * RADIUS_M * np.sin(np.pi / AROUND)
    places = np.stack(np.meshgrid(np.arange(AROUND + 1) * side, np.arange(ALONG + 1) * HEIGHT_M / ALONG), axis=2)
    return vertices, faces, places.reshape(-1, 2) / unit_m, level * (AROUND + 1) + column


def test_unrolled_tube_has_its_warp_along_v_wherever_it_lies(rng):
    vertices, faces, uv, uv_faces = unrolled(unit_m=2.5)
    turn = random_rotation(rng)
    lying = vertices @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).T  # along x, as sleeves are
    for placed, axis in ((vertices, [0.0, 1.0, 0.0]), (lying, [1.0, 0.0, 0.0]), (vertices @ turn.T, turn[:, 1])):
        grain = read_grain(placed, vertices, faces, corner_uv(uv, uv_faces, len(faces)))
        assert grain.from_uv.all()
        assert_allclose(grain.warp, np.broadcast_to(axis, grain.warp.shape), rtol=0.0, atol=1e-9)
        assert_allclose(grain.scale_m, 2.5, rtol=1e-9, atol=0.0)
    assert grain.share == pytest.approx(1.0)
    # Its panels are its triangles.
    lengths = np.linalg.norm(np.stack(meshes.corner_edges(vertices, faces), axis=1), axis=2)
    assert_allclose(2.5 * np.linalg.norm(grain.panel_edges, axis=2), lengths, rtol=1e-9, atol=0.0)
    weft = 2.5 * grain.panel_edges[0, 0]  # round the tube
    assert_allclose(weft, [0.0, lengths[0, 0]], rtol=0.0, atol=1e-9)


def test_an_island_on_its_side_is_turned_and_a_bias_cut_is_not():
    vertices, faces, uv, uv_faces = unrolled()
    for degrees, along in ((90.0, [0.0, 1.0, 0.0]), (-90.0, [0.0, 1.0, 0.0]), (45.0, None)):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        grain = read_grain(vertices, vertices, faces, corner_uv(uv @ [[c, s], [-s, c]], uv_faces, len(faces)))
        climb = np.abs(grain.warp[:, 1])
        assert_allclose(climb, 1.0 if along else np.cos(np.pi / 4.0), rtol=0.0, atol=1e-9)


def test_a_mirrored_island_has_the_same_warp():
    vertices, faces, uv, uv_faces = unrolled()
    plain, mirrored = (
        read_grain(vertices, vertices, faces, corner_uv(uv * [side, 1.0], uv_faces, len(faces))) for side in (1.0, -1.0)
    )
    assert mirrored.from_uv.all()
    assert_allclose(np.abs((plain.warp * mirrored.warp).sum(axis=1)), 1.0, rtol=0.0, atol=1e-9)


def test_the_seam_is_where_the_uv_are_cut():
    vertices, faces, uv, uv_faces = unrolled()
    grain = read_grain(vertices, vertices, faces, corner_uv(uv, uv_faces, len(faces)))
    ends = meshes.hinges(faces)[:, :2]
    assert_array_equal(grain.seam, (ends % AROUND == 0).all(axis=1))
    assert grain.seam.sum() == ALONG


@pytest.mark.parametrize("spoil", ["none", "stretched", "random", "collapsed", "two scales"])
def test_uv_that_are_no_flattening_leave_the_grain_vertical(spoil, rng):
    vertices, faces, uv, uv_faces = unrolled()
    if spoil == "none":
        on_corners = None
    else:
        change = {
            "stretched": uv * [1.4, 1.0],
            "random": rng.random(uv.shape),
            "collapsed": 0.0 * uv,
            "two scales": np.where(uv[:, :1] > 0.3, 1.5 * uv, uv),
        }
        on_corners = corner_uv(change[spoil], uv_faces, len(faces))
    grain = read_grain(vertices, vertices, faces, on_corners)
    assert not grain.from_uv.any() and not grain.seam.any()
    assert grain.scale_m == 0.0
    assert_array_equal(grain.warp, grain_along(vertices, faces))


def test_islands_are_judged_one_by_one():
    vertices, faces = grid(8, 6, cell_m=0.02)
    three = np.concatenate([vertices + np.array([x, 0.0, 0.0]) for x in (0.0, 1.0, 2.0)])
    triple = np.concatenate([faces + k * len(vertices) for k in range(3)])
    flat = vertices[:, :2]
    uv = np.concatenate([flat, flat * [1.0, 1.6] + 3.0, flat - 3.0])
    grain = read_grain(three, three, triple, corner_uv(uv, triple, len(triple)))
    assert_array_equal(grain.from_uv, np.repeat([True, False, True], len(faces)))
    assert grain.share == pytest.approx(2.0 / 3.0)


def test_uv_are_carried_to_subdivided_triangles():
    vertices, faces, uv, uv_faces = unrolled()
    fine_uv, fine_uv_faces = uv, uv_faces
    fine, fine_faces = vertices, faces
    for _ in range(2):
        fine_uv, fine_uv_faces, _ = meshes.subdivide(fine_uv, fine_uv_faces)
        fine, fine_faces, _ = meshes.subdivide(fine, fine_faces)
    on_corners = corner_uv(uv, uv_faces, len(fine_faces))
    assert isinstance(on_corners, CornerUv)
    assert_allclose(on_corners.corners, fine_uv[fine_uv_faces], rtol=0.0, atol=1e-15)
    assert set(on_corners.island) == {0}


def test_uv_of_other_triangles_are_not_taken():
    _, faces, uv, uv_faces = unrolled()
    assert corner_uv(uv, uv_faces, len(faces) + 1) is None
    assert corner_uv(np.zeros((0, 2)), np.zeros((0, 3), int), len(faces)) is None


def test_uv_unit_is_found_in_metres_and_checked_where_it_is_given():
    vertices, faces, uv, uv_faces = unrolled(unit_m=2.5)
    grain = read_grain(vertices, vertices, faces, corner_uv(uv, uv_faces, len(faces)))
    metres = read_grain(vertices, vertices, faces, corner_uv(2.5 * uv, uv_faces, len(faces)))
    assert panel_unit(grain, None) is None
    assert panel_unit(metres, None) == 1.0
    assert panel_unit(grain, 2.4) == 2.4
    with pytest.raises(InputError, match=r"uv unit: expected about 2\.5 metres of cloth .* got 1. Correct the unit"):
        read_grain(vertices, vertices, faces, corner_uv(uv, uv_faces, len(faces)), 1.0)
    with pytest.raises(InputError, match=r"uv unit: expected panels as uv, got no uv. Leave"):
        read_grain(vertices, vertices, faces, None, 1.0)


def test_panels_that_are_worn_sheared_are_panels_where_their_unit_is_given():
    vertices, faces, uv, uv_faces = unrolled()
    worn = corner_uv(uv @ [[1.0, 0.0], [0.6, 1.0]], uv_faces, len(faces))
    assert not read_grain(vertices, vertices, faces, worn).from_uv.any()
    grain = read_grain(vertices, vertices, faces, worn, 1.0)
    assert grain.from_uv.all()
    assert_allclose(grain.panel_edges, read_grain(vertices, vertices, faces, worn, 1.1).panel_edges, rtol=0.0, atol=0.0)
