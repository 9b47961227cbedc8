"""Measurements of known shapes and of the body; base patterns that fit it, sew up and lie outside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.errors import BodyError, InputError
from drape.geometry import meshes
from drape.geometry.closest import closest_point
from recovery.pattern import geometry
from recovery.pattern.bases import BASES, skirt, trousers, tshirt
from recovery.pattern.drafting import BACK, FRONT, Side, draft, mirror
from recovery.pattern.measurements import measure, section, tape
from recovery.pattern.mesh import mesh_pattern
from recovery.pattern.model import Pattern
from recovery.pattern.tops import CAP_EASE
from recovery.run.wearer import shaped_body
from tests.recovery.pattern_setup import default_measurements

OPENINGS = {"tshirt": 4, "dress": 4, "trousers": 3, "shorts": 3, "skirt": 2}


def patterns() -> dict[str, Pattern]:
    body = default_measurements()
    return {
        "tshirt": tshirt(body),
        "dress": tshirt(body, length_m=1.05, flare_m=0.12),
        "trousers": trousers(body),
        "shorts": trousers(body, inseam_m=0.25, hem_girth_m=0.62),
        "skirt": skirt(body),
    }


# --- measurements ----------------------------------------------------------------------------------------------------


def test_the_tape_reads_the_perimeter_of_a_circle_and_spans_hollows():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.3)
    points = section(ball.vertices, ball.faces, 1, 0.1)
    assert_allclose(points[:, 1], 0.1, atol=1e-12)
    assert_allclose(tape(points[:, [0, 2]]), 2.0 * np.pi * np.sqrt(0.3**2 - 0.1**2), rtol=1e-3)
    hollow = np.array([(0, 0), (1, 0), (1, 1), (0.5, 0.2), (0, 1)], dtype=float)
    assert_allclose(tape(hollow), 4.0)
    with pytest.raises(BodyError, match="T-pose"):
        tape(section(ball.vertices, ball.faces, 1, 5.0)[:, [0, 2]])


def test_the_body_is_measured_in_the_order_of_a_body():
    body = default_measurements()
    heights = [body.ankle_y, body.knee_y, body.crotch_y, body.hip_y, body.waist_y, body.underarm_y, body.shoulder_y]
    assert heights == sorted(heights) and body.neck_y > body.shoulder_y
    assert 0.6 < body.waist_girth < body.hip_girth < 1.2 and body.waist_girth < body.chest_girth
    assert body.wrist_girth < body.arm_girth < body.thigh_girth < body.hip_girth
    assert body.calf_girth < body.thigh_girth and body.neck_half_width < body.shoulder_x < body.elbow_x < body.wrist_x
    assert_allclose(body.girth_at(body.waist_y), body.waist_girth)
    # A tape round the neck is a little longer than round its ellipse's axes would allow, never shorter.
    assert body.neck_girth > 4.0 * body.neck_half_width


def test_a_larger_body_measures_larger():
    body = load_body()
    larger = measure(replace(body, v_template=1.1 * body.v_template))
    for name, value in vars(default_measurements()).items():
        if not isinstance(value, np.ndarray):
            assert_allclose(getattr(larger, name), 1.1 * value, rtol=0.01, atol=0.012)


# --- drafting --------------------------------------------------------------------------------------------------------

SIDES = [Side("low", (0.1, 0.0)), Side("curve", (0.5, 0.0), ((0.6, 0.2), (0.5, 0.3))), Side("top", (0.4, 0.4))]


def test_a_drafted_panel_hangs_where_it_was_drawn():
    for rotation, sign in ((FRONT, 1.0), (BACK, -1.0)):
        drafted = draft("one", SIDES, rotation=rotation, z=sign * 0.3)
        world = drafted.panel.placement.apply(drafted.panel.vertices)
        expected = [(sign * x, y, sign * 0.3) for x, y in (side.start for side in SIDES)]
        assert_allclose(world, expected, atol=1e-15)
        assert_allclose(drafted.panel.placement.matrix()[:, 2], [0.0, 0.0, sign], atol=1e-15)
        middle = drafted.panel.placement.apply(geometry.edge_points(drafted.panel, 1, np.array([0.5])))
        bezier = (np.array([0.5, 0]) + 3 * np.array([0.6, 0.2]) + 3 * np.array([0.5, 0.3]) + np.array([0.4, 0.4])) / 8
        assert_allclose(middle[0, :2], [sign * bezier[0], bezier[1]], atol=1e-15)


def test_a_mirrored_draft_is_the_mirror_image_and_runs_the_same_way_round():
    plain = draft("one", SIDES, rotation=FRONT, z=0.0, apart_m=0.05)
    flipped = draft("one", SIDES, rotation=FRONT, z=0.0, flip=True, apart_m=0.05)
    assert_allclose(geometry.area(flipped.panel), geometry.area(plain.panel), rtol=1e-14)
    t = np.linspace(0.0, 1.0, 5)
    for side in ("low", "curve", "top"):
        points = plain.panel.placement.apply(geometry.edge_points(plain.panel, plain.edge(side).edge, t))
        image = flipped.panel.placement.apply(geometry.edge_points(flipped.panel, flipped.edge(side).edge, t[::-1]))
        assert_allclose(image, points * [-1.0, 1.0, 1.0], atol=1e-15)
    assert [side.name for side in mirror(mirror(SIDES))] == [side.name for side in SIDES]


# --- base patterns ---------------------------------------------------------------------------------------------------


def test_seams_of_the_bases_match():
    for pattern in patterns().values():
        geometry.check_pattern(pattern)
        for seam in geometry.seams(pattern):
            is_cap = "sleeve" in seam.stitch.first.panel and seam.stitch.second.panel in ("front", "back")
            assert_allclose(seam.mismatch, -CAP_EASE / (1.0 + 0.5 * CAP_EASE) if is_cap else 0.0, rtol=0, atol=1e-8)
            ends = geometry.stitch_ends(pattern, seam.stitch).sum()
            assert ends < geometry.stitch_ends(pattern, seam.stitch, reverse=True).sum()


def test_left_and_right_are_mirror_images():
    for pattern in patterns().values():
        world = {panel.name: panel.placement.apply(geometry.outline(panel)) for panel in pattern.panels}
        for name, points in world.items():
            other = world[name.replace("left", "right") if "left" in name else name.replace("right", "left")]
            image = points * [-1.0, 1.0, 1.0]
            gap = np.linalg.norm(image[:, None] - other[None], axis=2).min(axis=1)
            assert gap.max() < 1e-3


@pytest.mark.parametrize("name", ["tshirt", "trousers", "skirt"])
def test_a_base_is_sewn_into_a_garment_that_clears_the_body(name):
    pattern = patterns()[name]
    mesh = mesh_pattern(pattern, 0.04)
    assert len(meshes.boundary_loops(mesh.faces)) == OPENINGS[name]
    assert min(mesh.smallest_angles_deg().values()) > 23.0
    body = load_body()
    placed = mesh.placed()
    nearest = closest_point(placed, body.v_template, body.faces)
    normals = meshes.face_normals(body.v_template, body.faces)[nearest.face]
    outside = ((placed - nearest.point) * normals).sum(axis=1)
    assert outside.min() > 0.0 and nearest.distance.min() > 0.02
    # The right side of every triangle looks away from the body.
    look = meshes.face_normals(placed, mesh.panel_faces)[:, 2]
    assert (look * placed[mesh.panel_faces[:, 0], 2] > 0.0).all()


def test_finished_girths_are_the_body_and_its_ease():
    body = default_measurements()
    front = patterns()["tshirt"].panel("front")
    assert_allclose(np.ptp(front.vertices[:, 0]), 0.5 * (body.chest_girth + 0.10), rtol=1e-12)
    pants = patterns()["trousers"]
    lower = {}
    for panel in pants.panels:
        world = panel.placement.apply(panel.vertices)
        by_name = {"hem": 1, "waist": 4} if panel.name in ("front_left", "back_right") else {"hem": 4, "waist": 1}
        for side, number in by_name.items():
            lower[side] = lower.get(side, 0.0) + geometry.edge_length(panel, number)
        assert world[:, 1].min() > body.ankle_y
    assert_allclose(lower["hem"], 2.0 * 0.44, rtol=1e-12)
    assert_allclose(lower["waist"], body.girth_at(body.waist_y - 0.09) + 0.01, rtol=3e-3)
    hem = [geometry.edge_length(panel, 0) for panel in patterns()["skirt"].panels]
    assert_allclose(hem, 2.0 * (0.25 * (body.hip_girth + 0.06) + 0.08), rtol=5e-3)


def test_a_longer_tshirt_is_a_dress_and_shorter_trousers_are_shorts():
    all_patterns = patterns()
    for long, short, panel in (("dress", "tshirt", "front"), ("trousers", "shorts", "front_left")):
        heights = [np.ptp(all_patterns[name].panel(panel).vertices[:, 1]) for name in (long, short)]
        assert heights[0] > heights[1] + 0.3
    sleeves = [all_patterns[name].panel("sleeve_left_front").vertices for name in ("dress", "tshirt")]
    assert_allclose(sleeves[0], sleeves[1])


@pytest.mark.parametrize("shape", [(2.0,), (-2.0,), (0.0, 2.0), (0.0, -2.0, 1.0)])
def test_bases_fit_other_bodies(shape):
    body = measure(shaped_body(load_body(), np.array(shape)))
    for base in BASES.values():
        pattern = base(body)
        geometry.check_pattern(pattern)
        assert max(abs(seam.mismatch) for seam in geometry.seams(pattern)) < 0.02


@pytest.mark.parametrize(
    ("base", "settings", "message"),
    [
        (tshirt, {"length_m": -1.0}, r"length_m: expected a length in \(0, 3\) m"),
        (tshirt, {"length_m": 0.2}, "one below the other"),
        (tshirt, {"length_m": 66.0}, "length_m: expected a length"),
        (tshirt, {"length_m": np.nan}, "length_m: expected a length"),
        (tshirt, {"neck_out_m": 0.2}, "outside the other"),
        (tshirt, {"chest_ease_m": -0.05}, "Add ease"),
        (tshirt, {"sleeve_arm_ease_m": 0.0}, "wider than the arm's"),
        (tshirt, {"sleeve_arm_ease_m": 0.2}, "Lower the armhole"),
        (tshirt, {"sleeve_length_m": 0.05}, "Lengthen the sleeve"),
        (tshirt, {"sleeve_hem_girth_m": 0.05}, "a hem of 0"),
        (tshirt, {"sleeve_hem_m": 0.3}, "--set: expected one of length_m, .*sleeve_hem_girth_m, got sleeve_hem_m"),
        (trousers, {"hip_ease_m": -0.6}, "Add ease"),
        (trousers, {"hem_girth_m": 0.2}, "hem_girth_m: expected at least"),
        (trousers, {"rise_drop_m": 0.3}, "a waist above the hips"),
        (trousers, {"inseam_m": 0.02, "hem_girth_m": 0.3}, "Lengthen the legs"),
        (skirt, {"length_m": 0.1}, "a waist above and a hem below them"),
        (skirt, {"drop_m": 0.4}, "a waist above and a hem below them"),
        (skirt, {"hip_ease_m": -0.1}, "Add ease"),
    ],
)
def test_what_cannot_be_worn_or_made_is_refused_with_its_cure(base, settings, message):
    with pytest.raises(InputError, match=message):
        base(default_measurements(), **settings)
