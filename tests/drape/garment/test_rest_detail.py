"""Rest states of garments: body shape and wrinkles are forgotten, creases, seams and hems stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth import rest_state
from drape.errors import MeshError
from drape.garment.grain import corner_uv
from drape.garment.rest_detail import (
    HEM_STIFFENING,
    RestCloth,
    creases,
    distortion,
    doubled_faces,
    rest_of,
    subdivided_like,
)
from drape.garment.rest_pose import subdivide_smooth
from drape.garment.sewing import SewnHinges
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import equilateral, random_rotation, tube
from tests.drape.garment.test_grain import ALONG, AROUND, unrolled
from tests.drape.geometry.geometry_shapes import icosphere

EDGE_M = 0.01


def cloth_of(vertices: np.ndarray, faces: np.ndarray, **given) -> RestCloth:
    """``vertices`` as they were modelled, without uv."""
    given = {"modelled": vertices, "on_corners": None, "doubled": np.zeros(len(faces), bool)} | given
    return RestCloth(vertices, faces, **given)


def sheet(height) -> tuple[np.ndarray, np.ndarray]:
    """A sheet of 40 by 40 cm, at z = ``height`` of x and y [m] from its middle, x along rows of edges."""
    vertices, faces = equilateral(40, 46, edge_m=EDGE_M)
    vertices = vertices - vertices.mean(axis=0)
    vertices[:, 2] = height(vertices[:, 0], vertices[:, 1])
    return vertices, faces


def pleat(length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet with a sharp roof of 45 degrees on each side, ``length_m`` long, along a row of edges."""

    def height(x, y):
        row = EDGE_M * np.sqrt(0.75)
        return np.where(np.abs(x) <= 0.5 * length_m, np.maximum(2.0 * row - np.abs(y), 0.0), 0.0)

    return sheet(height)


def cap(radius_m: float, half_angle_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """A part of a sphere about its pole."""
    vertices, faces = equilateral(60, 70, edge_m=EDGE_M)
    flat = (vertices - vertices.mean(axis=0))[:, :2]
    away = np.linalg.norm(flat, axis=1)
    faces = faces[(away[faces] < 0.28).all(axis=1)]
    used, index = np.unique(faces, return_inverse=True)
    flat, away = flat[used], away[used]
    angle = half_angle_rad * away / away.max()
    side = flat / np.maximum(away, 1e-12)[:, None] * np.sin(angle)[:, None]
    return radius_m * np.column_stack([side, np.cos(angle)]), index.reshape(-1, 3)


def test_a_round_sleeve_is_flat_at_rest():
    vertices, faces = tube(24, 20, radius_m=0.06, height_m=0.4)
    state, figures = rest_of(cloth_of(vertices, faces))
    assert np.abs(rest_state.dihedral_angles(vertices, faces)).max() > 0.2
    assert_array_equal(state.hinge_angle, 0.0)
    assert (figures.kept_share, figures.hem_share) == (0.0, 0.0)
    assert (figures.grain, figures.lengths) == ("vertical", "mesh")


def test_a_pressed_pleat_keeps_its_three_lines():
    vertices, faces = pleat(0.5)
    angle, kept = creases(vertices, faces)
    bent = np.abs(rest_state.dihedral_angles(vertices, faces)) > 0.5
    assert bent.sum() > 100
    assert_array_equal(kept, bent)
    state, figures = rest_of(cloth_of(vertices, faces))
    assert_array_equal(state.hinge_angle, np.where(bent, angle, 0.0))
    assert figures.kept_share == pytest.approx(bent.mean())


def test_a_crumple_of_a_few_centimetres_is_forgotten():
    vertices, faces = pleat(0.04)
    assert (np.abs(rest_state.dihedral_angles(vertices, faces)) > 0.5).sum() > 5
    assert not creases(vertices, faces)[1].any()


@pytest.mark.parametrize("height_m", [0.004, 0.01])
def test_soft_wrinkles_are_forgotten(height_m):
    vertices, faces = sheet(lambda x, y: height_m * np.sin(2.0 * np.pi * x / 0.10))
    assert np.abs(rest_state.dihedral_angles(vertices, faces)).max() > 0.08
    assert not creases(vertices, faces)[1].any()


def test_creases_do_not_depend_on_where_the_cloth_lies(rng):
    vertices, faces = pleat(0.5)
    _, kept = creases(vertices @ random_rotation(rng).T + 1.0, faces)
    assert_array_equal(kept, creases(vertices, faces)[1])


def folded_sleeve() -> tuple[np.ndarray, np.ndarray]:
    """A sleeve of 40 cm whose end is folded inwards over 2 cm."""
    vertices, faces = tube(30, 42, radius_m=0.06, height_m=0.42)
    inside = vertices[:, 1] < 0.019
    vertices[inside, 1] = 0.04 - vertices[inside, 1]
    vertices[inside] *= [0.95, 1.0, 0.95]
    return vertices, faces


def test_a_folded_hem_keeps_its_fold_and_is_stiffer():
    vertices, faces = folded_sleeve()
    state, figures = rest_of(cloth_of(vertices, faces))
    ends = meshes.hinges(faces)[:, :2]
    fold = (ends // 30 == 2).all(axis=1)
    assert_array_equal(state.hinge_angle != 0.0, fold)
    assert np.abs(state.hinge_angle[fold]).min() > 2.0
    level = ends // 30
    assert_array_equal(state.stiffening[(level <= 2).all(axis=1)], HEM_STIFFENING)
    assert_array_equal(state.stiffening[(level >= 4).any(axis=1)], 1.0)
    assert 0.0 < figures.hem_share < 0.2


def test_cloth_of_a_material_called_a_cuff_is_double():
    _, faces = tube(12, 5)
    material = np.repeat([0, 1, 2], 40)
    doubled = doubled_faces(("cotton", "Left_Cuff", "chemise"), material, 4 * len(faces))
    assert_array_equal(doubled, np.repeat(material == 1, 4))
    vertices, fine, _ = meshes.subdivide(*tube(12, 5))
    state, _ = rest_of(cloth_of(vertices, fine, doubled=doubled))
    assert_array_equal(state.stiffening == HEM_STIFFENING, doubled[meshes.hinge_faces(fine)].all(axis=1))


def test_materials_of_other_triangles_say_nothing():
    assert not doubled_faces(("hem",), np.zeros(10, int), 25).any()
    assert not doubled_faces((), np.zeros(10, int), 40).any()


def test_modelled_is_the_mesh_as_it_is():
    vertices, faces = folded_sleeve()
    state, figures = rest_of(cloth_of(vertices, faces, modelled=1.3 * vertices), "modelled")
    today = rest_state.modelled_rest(vertices, faces)
    for name in ("edges", "hinge_angle", "stiffening"):
        assert_array_equal(getattr(state, name), getattr(today, name))
    assert figures.kept_share == 1.0


def test_flat_keeps_no_angle_and_the_lengths():
    vertices, faces = folded_sleeve()
    state, figures = rest_of(cloth_of(vertices, faces), "flat")
    assert_array_equal(state.hinge_angle, 0.0)
    assert_array_equal(state.edges, rest_state.modelled_rest(vertices, faces).edges)
    assert figures.kept_share == 0.0


def test_angles_are_those_of_the_cloth_as_delivered():
    vertices, faces = folded_sleeve()
    pushed = vertices * [1.1, 1.0, 1.1]
    pushed[:, 2] += 0.02 * np.sin(40.0 * pushed[:, 1])
    state, _ = rest_of(cloth_of(pushed, faces, modelled=vertices))
    assert_array_equal(state.hinge_angle, rest_of(cloth_of(vertices, faces))[0].hinge_angle)
    assert_array_equal(state.edges, rest_state.modelled_rest(pushed, faces).edges)


def test_seams_of_panels_keep_their_angle():
    vertices, faces, uv, uv_faces = unrolled()
    state, figures = rest_of(cloth_of(vertices, faces, on_corners=corner_uv(uv, uv_faces, len(faces)), resized=True))
    kept = np.flatnonzero(state.hinge_angle)
    assert len(kept) == ALONG
    assert_allclose(np.abs(state.hinge_angle[kept]), 2.0 * np.pi / AROUND, rtol=1e-9, atol=0.0)
    assert (figures.grain, figures.grain_share) == ("uv", pytest.approx(1.0))


def test_sewn_cloth_has_its_makers_angles_and_hems_and_no_creases():
    vertices, faces = pleat(0.5)
    hinges = len(meshes.hinges(faces))
    sewn = SewnHinges(np.zeros(hinges), np.ones(hinges))
    sewn.angle[7], sewn.stiffening[11] = -1.2, 3.0
    band = np.zeros(len(faces), dtype=bool)
    band[:100] = True
    cloth = cloth_of(vertices, faces, sewn=sewn, doubled=band)
    state, figures = rest_of(cloth)
    assert creases(vertices, faces)[1].any()
    assert_array_equal(state.hinge_angle, sewn.angle)
    assert figures.kept_share == 1.0 / hinges
    double = band[meshes.hinge_faces(faces)].all(axis=1)
    assert_array_equal(state.stiffening, np.maximum(sewn.stiffening, np.where(double, HEM_STIFFENING, 1.0)))
    assert not rest_of(cloth, "flat")[0].hinge_angle.any()


def test_lengths_are_those_of_the_panels_unless_the_cloth_was_resized():
    vertices, faces, uv, uv_faces = unrolled(unit_m=3.0)
    on_corners = corner_uv(uv, uv_faces, len(faces))
    worn = cloth_of(1.03 * vertices, faces, modelled=1.03 * vertices, on_corners=on_corners, uv_unit_m=3.0)
    cut = rest_state.modelled_rest(vertices, faces).face_area
    state, figures = rest_of(worn)
    assert figures.lengths == "panels"
    assert_allclose(state.face_area, cut, rtol=1e-9, atol=0.0)
    assert_allclose(rest_of(worn, "flat")[0].face_area, cut, rtol=1e-9, atol=0.0)
    for other in (
        rest_of(replace(worn, resized=True)),
        rest_of(worn, "modelled"),
        rest_of(replace(worn, uv_unit_m=None)),
    ):
        assert other[1].lengths == "mesh"
        assert_allclose(other[0].face_area, 1.03**2 * cut, rtol=1e-9, atol=0.0)


@pytest.mark.parametrize("radius_m", [0.10, 0.15, 0.30])
def test_distortion_of_a_ball_is_that_of_its_stereographic_map(radius_m):
    vertices, faces = cap(radius_m, np.pi / 2.0)
    expected = (1.0 - 0.01 / (4.0 * radius_m**2)) ** -2.0
    assert distortion(vertices, faces) == pytest.approx(expected, rel=0.03)


def test_distortion_of_a_tube_is_none():
    assert distortion(*tube(24, 20, radius_m=0.06, height_m=0.4)) == pytest.approx(1.0, abs=1e-9)


def test_a_ball_cannot_be_laid_flat():
    vertices, faces = cap(0.12, np.pi / 2.0)
    with pytest.raises(MeshError, match=r"rest: expected a garment that lies flat: panels of 20 cm .* got 4\d %"):
        rest_of(cloth_of(vertices, faces), "flat")
    rest_of(cloth_of(vertices, faces), "auto")


def test_a_closed_ball_cannot_be_laid_flat_either():
    with pytest.raises(MeshError, match="lies flat"):
        rest_of(cloth_of(*icosphere(4, radius_m=0.12)), "flat")


def test_delivered_cloth_is_subdivided_as_intake_does():
    vertices, faces = tube(12, 5)
    fine, fine_faces, _ = subdivide_smooth(*subdivide_smooth(vertices, faces)[:2])
    assert_array_equal(subdivided_like(vertices, faces, len(fine_faces)), fine)
