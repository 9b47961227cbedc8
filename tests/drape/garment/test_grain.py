"""Grain and panels from uv: what is a flattening, and which way its warp runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.rest_state import grain_along
from drape.errors import InputError
from drape.garment.grain import CornerUv, Grain, corner_uv, panel_unit, read_grain
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, random_rotation, tube
from tests.fixtures.laws import each

AROUND, ALONG, RADIUS_M, HEIGHT_M = 48, 10, 0.1, 0.3


def unrolled(unit_m: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A tube and its uv: cut open behind its last column, rolled out to ``unit_m`` metres per unit."""
    vertices, faces = tube(AROUND, ALONG, radius_m=RADIUS_M, height_m=HEIGHT_M)
    column, level = faces % AROUND, faces // AROUND
    column = np.where((column == 0) & (column.max(axis=1, keepdims=True) > 1), AROUND, column)
    side = 2.0 * RADIUS_M * np.sin(np.pi / AROUND)
    places = np.stack(np.meshgrid(np.arange(AROUND + 1) * side, np.arange(ALONG + 1) * HEIGHT_M / ALONG), axis=2)
    return vertices, faces, places.reshape(-1, 2) / unit_m, level * (AROUND + 1) + column


def grain_of(change: Callable[[np.ndarray], np.ndarray] | None = None, *, unit_m: float = 1.0, given_m=None) -> Grain:
    """The grain of the tube whose uv are ``change`` of the unrolled ones."""
    vertices, faces, uv, uv_faces = unrolled(unit_m)
    uv = uv if change is None else change(uv)
    return read_grain(vertices, vertices, faces, corner_uv(uv, uv_faces, len(faces)), given_m)


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
    for degrees, climb in ((90.0, 1.0), (-90.0, 1.0), (45.0, np.cos(np.pi / 4.0))):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        grain = grain_of(lambda uv, turn=((c, s), (-s, c)): uv @ turn)
        assert_allclose(np.abs(grain.warp[:, 1]), climb, rtol=0.0, atol=1e-9)


def test_a_mirrored_island_has_the_same_warp():
    plain, mirrored = grain_of(), grain_of(lambda uv: uv * [-1.0, 1.0])
    assert mirrored.from_uv.all()
    assert_allclose(np.abs((plain.warp * mirrored.warp).sum(axis=1)), 1.0, rtol=0.0, atol=1e-9)


def test_the_seam_is_where_the_uv_are_cut():
    grain, ends = grain_of(), meshes.hinges(unrolled()[1])[:, :2]
    assert_array_equal(grain.seam, (ends % AROUND == 0).all(axis=1))
    assert grain.seam.sum() == ALONG


NO_FLATTENING = {
    "stretched": lambda uv: uv * [1.4, 1.0],
    "random": lambda uv: np.random.default_rng(1).random(uv.shape),
    "collapsed": lambda uv: 0.0 * uv,
    "two scales": lambda uv: np.where(uv[:, :1] > 0.3, 1.5 * uv, uv),
    "none": lambda uv: uv[:0],
}


@each(spoil=NO_FLATTENING)
def test_uv_that_are_no_flattening_leave_the_grain_vertical(spoil):
    vertices, faces, uv, uv_faces = unrolled()
    spoilt = spoil(uv)
    on_corners = corner_uv(spoilt, uv_faces, len(faces)) if len(spoilt) else None
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
    vertices, faces, _, _ = unrolled()
    assert panel_unit(grain_of(unit_m=2.5), None) is None
    assert panel_unit(grain_of(), None) == 1.0
    assert panel_unit(grain_of(unit_m=2.5), 2.4) == 2.4
    with pytest.raises(InputError, match=r"uv unit: expected about 2\.5 metres of cloth .* got 1. Correct the unit"):
        grain_of(unit_m=2.5, given_m=1.0)
    with pytest.raises(InputError, match=r"uv unit: expected panels as uv, got no uv. Leave"):
        read_grain(vertices, vertices, faces, None, 1.0)


def test_panels_that_are_worn_sheared_are_panels_where_their_unit_is_given():
    found, grain, other = (grain_of(lambda uv: uv @ [[1.0, 0.0], [0.6, 1.0]], given_m=m) for m in (None, 1.0, 1.1))
    assert not found.from_uv.any() and grain.from_uv.all()
    assert_array_equal(grain.panel_edges, other.panel_edges)
