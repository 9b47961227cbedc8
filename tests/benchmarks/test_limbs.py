"""Limbs are told to be inside their sleeves and legs, and beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import limbs
from drape.body.model import BodyModel
from tests.fixtures.garments import shipped


def tube(radius_m: float, sides: int = 24, rings: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] and faces of an open tube along x, from -1 to 1."""
    angle = np.arange(sides) * 2.0 * np.pi / sides
    circle = np.stack([np.zeros(sides), radius_m * np.cos(angle), radius_m * np.sin(angle)], axis=1)
    vertices = np.concatenate([circle + np.array([x, 0.0, 0.0]) for x in np.linspace(-1.0, 1.0, rings)])
    a = np.arange(sides * (rings - 1))
    b = a - a % sides + (a + 1) % sides
    faces = np.concatenate([np.stack([a, b, a + sides], axis=1), np.stack([b, b + sides, a + sides], axis=1)])
    return vertices, faces


def test_a_plane_cuts_a_tube_in_one_closed_line_of_its_girth():
    vertices, faces = tube(0.1)
    (found,) = limbs.loops(vertices, faces, np.array([0.2, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))
    line = found.contour(vertices)
    assert line.length_m == pytest.approx(2.0 * 24 * 0.1 * np.sin(np.pi / 24), rel=1e-2)
    assert np.abs(line.points[:, 0] - 0.2).max() < 1e-12
    assert limbs.loops(vertices, faces, np.array([2.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])) == []
    half = faces[(vertices[faces][..., 1] > 0.0).all(axis=1)]  # a gutter has no closed line
    assert limbs.loops(vertices, half, np.array([0.2, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])) == []


@pytest.mark.parametrize(("name", "held"), [("tshirt", "arm"), ("trousers", "leg"), ("skirt", "")])
def test_sleeves_and_legs_are_found_and_skirts_are_none(name: str, held: str, body: BodyModel):
    garment, joints = shipped(name), body.joints_template
    found = limbs.limb_loops(garment, joints)
    assert set(found) == ({f"left {held}", f"right {held}"} if held else set())
    if held:
        vertices = garment.vertices.astype(np.float64)
        assert limbs.share_inside(vertices, joints, found) == 1.0
        turned = vertices + 0.3 * np.array([0.0, held == "arm", held == "leg"])
        assert limbs.share_inside(turned, joints, found) == 0.0


def test_sleeves_that_hang_beside_the_arms_are_seen_at_rest(body: BodyModel):
    garment, joints = shipped("longsleeve"), body.joints_template
    sleeve = np.abs(garment.vertices[:, 0]) > 0.3
    lowered = garment.vertices.copy()
    lowered[sleeve, 1] -= 0.12
    found = limbs.limb_loops(replace(garment, vertices=lowered), joints)
    assert found and limbs.share_inside(lowered.astype(np.float64), joints, found) < 0.2


def test_a_sleeve_far_beside_its_arm_is_an_opening_without_a_limb(body: BodyModel):
    garment, joints = shipped("tshirt"), body.joints_template
    faces, worn = garment.faces.astype(np.int64), garment.vertices.astype(np.float64)
    assert sorted(part for part, _ in limbs.limb_openings(worn, faces, joints)) == ["left arm", "right arm"]
    sleeve = worn[:, 0] > 0.25
    beside = np.where(sleeve[:, None], worn - [0.0, 0.4, 0.0], worn)
    told = dict(limbs.limb_openings(beside, faces, joints))
    assert told["none"] is None and "left arm" not in told
    held = limbs.limb_loops(replace(garment, vertices=beside.astype(np.float32)), joints)
    assert limbs.share_inside(beside, joints, held) < 1.0


def test_area_is_that_of_the_cloth():
    garment = shipped("tshirt")
    at_rest = garment.vertices[: garment.vertex_count].astype(np.float64)
    assert limbs.area_over_rest(1.1 * at_rest, garment) == pytest.approx(1.21)
