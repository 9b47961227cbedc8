"""Faces of a character that lie under a garment: laws on a cylinder in a tube, and on a file of primitives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drape.avatar.character import character_in
from drape.avatar.covered import INSIDE_M, MARGIN_M, REACH_M, covered_faces, covered_in_file, ranges_of
from drape.avatar.wearer import save_wearer
from drape.body.model import BodyModel
from drape.files.gltf import GltfFile
from tests.fixtures.characters import bare_wearer, character

RADIUS_M, HALF_M, STEP_M = 0.1, 0.2, 0.01  # of the tube of cloth, and between its rings


def cylinder(radius_m: float, half_m: float, step_m: float) -> tuple[np.ndarray, np.ndarray]:
    """An open cylinder about y, its faces outwards."""
    rings, around = round(2 * half_m / step_m) + 1, max(8, round(2 * np.pi * radius_m / step_m))
    angle, height = np.meshgrid(np.arange(around) * 2 * np.pi / around, np.linspace(-half_m, half_m, rings))
    vertices = np.stack([radius_m * np.sin(angle), height, radius_m * np.cos(angle)], axis=-1).reshape(-1, 3)
    low = (np.arange(rings - 1)[:, None] * around + np.arange(around)).reshape(-1)
    right = low - low % around + (low % around + 1) % around
    above = low + around, right + around
    faces = [np.stack([low, right, above[1]], axis=1), np.stack([low, above[1], above[0]], axis=1)]
    return vertices, np.concatenate(faces)


CLOTH = cylinder(RADIUS_M, HALF_M, STEP_M)


def test_what_is_under_cloth_and_off_its_hems_is_covered():
    skin, faces = cylinder(RADIUS_M - 0.01, 2 * HALF_M, STEP_M)
    found = covered_faces(skin, faces, [CLOTH])
    furthest = np.abs(skin[faces, 1]).max(axis=1)
    # What the hem leaves bare begins at the hem, or a step of the skin's own points below it.
    assert found[furthest < HALF_M - MARGIN_M - 2 * STEP_M].all()
    assert not found[furthest > HALF_M - 0.9 * MARGIN_M].any()


@pytest.mark.parametrize("radius_m", [RADIUS_M + INSIDE_M + 0.005, RADIUS_M + REACH_M + 0.01])
def test_what_is_over_the_cloth_is_not_covered(radius_m: float):
    assert not covered_faces(*cylinder(radius_m, 0.5 * HALF_M, STEP_M), [CLOTH]).any()


def test_a_wide_tube_covers_nothing():
    wide = cylinder(0.03 + REACH_M + 0.01, HALF_M, STEP_M)
    assert not covered_faces(*cylinder(0.03, 2 * HALF_M, STEP_M), [wide]).any()


def test_a_large_face_counts_whole_though_its_corners_are_covered():
    """Corners lie under the two ends of a tube with a gap, through which the middle is seen."""
    low, high = (CLOTH[0] + [0.0, y, 0.0] for y in (-0.3, 0.3))
    cloth = np.concatenate([low, high]), np.concatenate([CLOTH[1], CLOTH[1] + len(low)])
    triangle = np.array([[0.0, -0.3, 0.09], [0.02, -0.3, 0.09], [0.0, 0.3, 0.09]])
    assert not covered_faces(triangle, np.array([[0, 1, 2]]), [cloth]).any()
    assert covered_faces(triangle * [1.0, 0.1, 1.0], np.array([[0, 1, 2]]), [CLOTH]).all()


def test_an_outfit_covers_what_one_of_its_layers_covers():
    skin, faces = cylinder(RADIUS_M - 0.01, 2 * HALF_M, STEP_M)
    low, high = ((CLOTH[0] + [0.0, y, 0.0], CLOTH[1]) for y in (-0.2, 0.2))
    each = [covered_faces(skin, faces, [one]) for one in (low, high)]
    assert np.array_equal(covered_faces(skin, faces, [low, high]), each[0] | each[1])
    assert each[0].any() and each[1].any() and not (each[0] & each[1]).any()


def test_runs_are_told_by_their_begin_and_length():
    chosen = np.array([True, True, False, True, False, False, True])
    assert ranges_of(chosen).tolist() == [[0, 2], [3, 1], [6, 1]]
    assert ranges_of(np.zeros(4, dtype=bool)).shape == (0, 2)


def test_faces_are_told_as_triangles_of_the_file(body: BodyModel, tmp_path: Path):
    payload = character(body)
    read, wearer = character_in(GltfFile(payload)), bare_wearer()
    cloth = cylinder(0.45, 0.3, 0.03)  # arms pass through it, the trunk is too far inside
    centred = cloth[0] + wearer.vertices.mean(axis=0), cloth[1]
    surface, none = (wearer.vertices, wearer.faces), np.zeros(len(wearer.faces), dtype=bool)
    covered, own = covered_in_file(save_wearer(wearer, tmp_path), *surface, [centred], none, MARGIN_M)
    (primitive,) = own
    assert primitive.primitive.triangles == len(body.faces) and read.triangle is not None
    runs = [np.arange(begin, begin + count) for begin, count in primitive.ranges]
    assert np.array_equal(np.concatenate(runs), read.triangle[covered]) and covered.any()
