"""Open contours against closed forms, their places along the body, and linear grading that recovers known sizes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.errors import InputError, MeshError
from drape.garment.contours import (
    Contour,
    Match,
    bone_chains,
    encircles,
    lost_parts,
    match_contours,
    open_contours,
    pierced_parts,
    place_of,
)
from recovery.fit.grading import Graded, contour_edges, grade
from recovery.pattern.bases import skirt, tshirt
from recovery.pattern.coordinates import control_points
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.sewing_pattern import EdgeRef, Pattern
from recovery.pattern.symmetry import find_symmetries
from tests.drape.cloth.cloth_shapes import round_tube
from tests.recovery.pattern_setup import default_measurements


def joints() -> np.ndarray:
    return load_body().joints_template


def sandwich(name: str) -> tuple[PatternMesh, np.ndarray]:
    """A base pattern and its nodes [m], panels flat before and behind the body and joined at the seams."""
    mesh = mesh_pattern({"skirt": skirt, "tshirt": tshirt}[name](default_measurements()), 0.07)
    return mesh, mesh.nodes_from(mesh.placed())


def graded_to(mesh: PatternMesh, nodes: np.ndarray, factor) -> tuple[list[Match], Graded]:
    """The matches with a target that is the drape scaled about the pelvis, and the pattern graded to it."""
    pelvis, source = joints()[0], open_contours(nodes, mesh.faces)
    target = open_contours(pelvis + factor * (nodes - pelvis), mesh.faces)
    matches, left = match_contours(source, target, joints())
    assert left == []
    return matches, grade(mesh, nodes, source, matches, find_symmetries(mesh.pattern))


def sizes(pattern: Pattern, base: Pattern) -> np.ndarray:
    """Width and height (P, 2) of every panel's corners over the base's."""
    now, before = control_points(pattern), control_points(base)
    mine = [before.panel == panel for panel in range(len(base.panels))]
    return np.array([np.ptp(now.positions[rows], axis=0) / np.ptp(before.positions[rows], axis=0) for rows in mine])


def test_the_loops_of_a_tube_have_the_lengths_of_polygons():
    radii, heights, sides = (0.3, 0.25, 0.2), (-0.4, 0.0, 0.3), 24
    hem, waist = open_contours(*round_tube(radii, heights, sides))
    for contour, radius, height in ((hem, 0.3, -0.4), (waist, 0.2, 0.3)):
        assert_allclose(contour.length_m, 2.0 * sides * radius * np.sin(np.pi / sides), rtol=1e-12)
        assert_allclose(contour.centre, [0.0, height, 0.0], atol=1e-12)
        assert len(contour.loop) == sides and (contour.points[:, 1] == height).all()


def test_the_centre_is_the_mean_along_the_loop_however_it_is_cut():
    """A square with one side cut into many: the mean of the vertices would lean towards it."""
    corners = np.array([(0.0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    extra = np.stack([np.linspace(1, 0, 12)[1:-1], np.ones(10), np.zeros(10)], axis=1)
    ring = np.concatenate([corners[:3], extra, corners[3:]])
    vertices = np.concatenate([ring, [[0.5, 0.5, 0.1]]])
    count = len(ring)
    (contour,) = open_contours(vertices, np.array([[k, (k + 1) % count, count] for k in range(count)]))
    assert_allclose(contour.centre, [0.5, 0.5, 0.0], atol=1e-12)
    assert_allclose(contour.length_m, 4.0, rtol=1e-12)


def test_a_closed_mesh_has_no_contour_and_a_broken_one_is_refused():
    vertices = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    assert open_contours(vertices, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])) == []
    with pytest.raises(MeshError, match="vertices"):
        open_contours(vertices[:, :2], np.array([[0, 1, 2]]))
    with pytest.raises(MeshError, match="finite"):
        open_contours(vertices * np.nan, np.array([[0, 1, 2]]))


def ring(centre, normal, radius: float) -> Contour:
    """A round contour."""
    normal = np.asarray(normal, dtype=np.float64) / np.linalg.norm(normal)
    first = np.cross(normal, [0.3, 0.2, 0.9])
    first /= np.linalg.norm(first)
    angle = 2.0 * np.pi * np.arange(20) / 20
    arms = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * np.cross(normal, first)
    points = np.asarray(centre) + radius * arms
    return Contour(np.arange(20), points, 2 * np.pi * radius, np.asarray(centre, dtype=np.float64))


def test_places_are_told_by_the_bones_that_pass_through():
    at = dict(zip(JOINT_NAMES, joints(), strict=True))
    chains = bone_chains(joints())
    waist = place_of(ring(0.7 * at["pelvis"] + 0.3 * at["neck"], (0, 1, 0), 0.15), chains)
    assert waist.part == "trunk"
    assert_allclose(waist.along_m, 0.3 * np.linalg.norm(at["neck"] - at["pelvis"]), rtol=1e-12)
    assert waist.direction[1] > 0.9
    # A hem round both legs continues the trunk downward; one round a leg belongs to the leg.
    knees = 0.5 * (at["left_knee"] + at["right_knee"])
    hem = place_of(ring(knees, (0, 1, 0), 0.3), chains)
    assert hem.part == "trunk"
    assert_allclose(hem.along_m, -np.linalg.norm(knees - at["pelvis"]), rtol=1e-12)
    leg = place_of(ring(at["left_knee"], (0, 1, 0), 0.09), chains)
    assert leg.part == "left_leg"
    assert_allclose(leg.along_m, np.linalg.norm(at["left_knee"] - at["left_hip"]), rtol=1e-12)
    cuff = place_of(ring(0.5 * (at["right_elbow"] + at["right_shoulder"]), (1, 0, 0), 0.08), chains)
    assert cuff.part == "right_arm" and cuff.direction[0] < -0.9
    nothing = place_of(ring(at["left_elbow"] + [0, 0.5, 0], (0, 0, 1), 0.1), chains)
    assert nothing.part is None


def test_a_line_that_enters_and_leaves_is_not_encircled():
    contour = ring((0, 0, 0), (0, 1, 0), 0.1)
    through = np.array([(0.02, -1.0, 0.0), (0.02, 1.0, 0.0)])
    assert encircles(contour, through) and encircles(contour, through[::-1])
    back = np.array([(0.02, -1.0, 0.0), (0.02, 1.0, 0.0), (-0.03, 1.0, 0.01), (-0.03, -1.0, 0.01)])
    assert not encircles(contour, back)
    assert not encircles(contour, through + np.array([0.2, 0.0, 0.0]))


def test_contours_find_their_counterparts_and_holes_are_left():
    at = dict(zip(JOINT_NAMES, joints(), strict=True))
    source = [ring(at["pelvis"] + [0, y, 0], (0, 1, 0), radius) for y, radius in ((-0.35, 0.3), (0.15, 0.14))]
    hole = ring(at["pelvis"] + [0.2, -0.2, 0.2], (1, 0, 1), 0.03)
    target = [
        hole,
        ring(at["pelvis"] + [0, 0.1, 0], (0, 1, 0), 0.15),
        ring(at["pelvis"] - [0, 0.5, 0], (0, 1, 0), 0.36),
    ]
    matches, left = match_contours(source, target, joints())
    assert [(m.source, m.target) for m in matches] == [(0, 2), (1, 1)] and left == [0]
    assert_allclose([m.length_ratio for m in matches], [0.36 / 0.3, 0.15 / 0.14])
    assert_allclose([m.move_m for m in matches], [-0.15, -0.05], atol=0.005)  # bones are not quite upright
    with pytest.raises(InputError, match="2 openings round the trunk"):
        match_contours(source, target[:2], joints())
    with pytest.raises(InputError, match="base garment"):
        match_contours([hole], target, joints())


def test_the_contours_of_a_skirt_are_its_free_edges():
    mesh, nodes = sandwich("skirt")
    for contour, number in zip(open_contours(nodes, mesh.faces), (0, 3), strict=True):  # hem and waist
        assert set(contour_edges(mesh, contour)) == {EdgeRef(panel, number) for panel in ("front", "back")}


@pytest.mark.parametrize("name", ["skirt", "tshirt"])
@pytest.mark.parametrize("scale", [0.93, 1.07])
def test_a_target_that_is_the_drape_scaled_gives_the_scale_back(name, scale):
    mesh, nodes = sandwich(name)
    matches, graded = graded_to(mesh, nodes, scale)
    assert_allclose([m.length_ratio for m in matches], scale, rtol=1e-9)
    assert_allclose(sizes(graded.pattern, mesh.pattern), scale, atol=0.02)
    assert_allclose(graded.widths, scale, atol=0.02)
    assert_allclose(graded.heights, scale, atol=0.02)
    assert_allclose(0.1 * graded.tapers, 0.0, atol=0.03)  # over the 10 cm of a sleeve's half
    assert graded.misfit < 0.01
    again = find_symmetries(graded.pattern)
    assert len(again.between) == len(find_symmetries(mesh.pattern).between)
    assert max(s.error_m for s in (*again.between, *again.within)) < 1e-9


def test_one_that_is_longer_only_is_lengthened_only():
    _, graded = graded_to(*sandwich("skirt"), np.array([1.0, 1.1, 1.0]))
    assert_allclose(graded.heights, 1.1, atol=0.015)
    assert_allclose(graded.widths, 1.0, atol=0.005)


def test_a_target_of_another_size_altogether_is_refused():
    mesh, nodes = sandwich("skirt")
    source = open_contours(nodes, mesh.faces)
    matches, _ = match_contours(source, source, joints())
    wrong = [match._replace(length_ratio=100.0) for match in matches]
    with pytest.raises(InputError, match="unit"):
        grade(mesh, nodes, source, wrong, find_symmetries(mesh.pattern))


def test_a_limb_whose_bones_go_through_the_cloth_is_lost_though_its_cuff_is_round_it():
    """A sleeve round the arm, and one that slipped off: between its ends, both round the arm, it lies below the arm."""
    body = joints()
    shoulder, wrist = (body[JOINT_NAMES.index(f"left_{name}")] for name in ("shoulder", "wrist"))
    nodes, faces = round_tube((0.08, 0.08, 0.08, 0.08, 0.08), (-0.2, -0.1, 0.0, 0.1, 0.2))
    way = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    side = np.cross(way, [0.0, 0.0, 1.0])
    sleeve = 0.5 * (shoulder + wrist) + nodes @ np.array([side, way, np.cross(side, way)])
    assert lost_parts(sleeve, faces, body, ["left_arm", "left_arm"]) == ()
    slipped = sleeve - 0.15 * (np.abs(nodes[:, 1:2]) < 0.05) * np.array([0.0, 1.0, 0.0])
    assert lost_parts(slipped, faces, body, ["left_arm", "left_arm"]) == ("left_arm",)
    assert lost_parts(slipped, faces, body, ["trunk"]) == ("trunk",)
    assert pierced_parts(sleeve, faces, body) == () and pierced_parts(slipped, faces, body) == ("left_arm",)


def test_a_neck_or_a_hem_that_is_sewn_shut_is_gone_through():
    """A lid across the trunk, between pelvis and head, and one across both thighs."""
    body, square = joints(), np.array([(-0.3, 0.0, -0.3), (-0.3, 0.0, 0.3), (0.3, 0.0, 0.3), (0.3, 0.0, -0.3)])
    lid = np.array([[0, 1, 2], [0, 2, 3]])
    for name, above_m, parts in (("neck", -0.05, ("trunk",)), ("left_knee", 0.05, ("left_leg", "right_leg"))):
        height = body[JOINT_NAMES.index(name), 1] + above_m
        assert pierced_parts(square + np.array([0.0, height, 0.0]), lid, body) == parts
