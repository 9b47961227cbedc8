"""Measurements of known shapes and of the body; panels drafted from sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import BodyError
from recovery.pattern import geometry
from recovery.pattern.drafting import BACK, FRONT, Side, draft, mirror
from recovery.pattern.measurements import measure_body, section, tape
from tests.drape.geometry.geometry_shapes import icosphere
from tests.recovery.pattern_setup import default_measurements


def test_the_tape_reads_the_perimeter_of_a_circle_and_spans_hollows():
    ball = icosphere(5, radius_m=0.3)
    points = section(*ball, 1, 0.1)
    assert_allclose(points[:, 1], 0.1, atol=1e-12)
    assert_allclose(tape(points[:, [0, 2]]), 2.0 * np.pi * np.sqrt(0.3**2 - 0.1**2), rtol=1e-3)
    hollow = np.array([(0, 0), (1, 0), (1, 1), (0.5, 0.2), (0, 1)], dtype=float)
    assert_allclose(tape(hollow), 4.0)
    with pytest.raises(BodyError, match="T-pose"):
        tape(section(*ball, 1, 5.0)[:, [0, 2]])


def test_the_body_is_measured_in_the_order_of_a_body():
    body = default_measurements()
    heights = [body.ankle_y, body.knee_y, body.crotch_y, body.hip_y, body.waist_y, body.underarm_y, body.neck_y]
    assert heights == sorted(heights)
    assert 0.6 < body.waist_girth < body.hip_girth < 1.2 and body.waist_girth < body.chest_girth
    assert body.wrist_girth < body.arm_girth < body.thigh_girth < body.hip_girth
    assert body.calf_girth < body.thigh_girth and body.neck_half_width < body.shoulder_x < body.elbow_x < body.wrist_x
    assert_allclose(body.girth_at(body.waist_y), body.waist_girth)


def test_a_larger_body_measures_larger(body):
    larger = measure_body(replace(body, v_template=1.1 * body.v_template))
    for name, value in vars(default_measurements()).items():
        if not isinstance(value, np.ndarray):
            assert_allclose(getattr(larger, name), 1.1 * value, rtol=0.01, atol=0.012)


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
