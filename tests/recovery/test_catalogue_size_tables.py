"""Grading: which rows a table keeps, what is held while a size falls, and garments that are not the catalogue's."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.cloth.waistband import waistband
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.sizes import SIZES, field_in_space
from recovery.catalogue.design_drape import QUICK, body_distance, design
from recovery.catalogue.fall import Fall
from recovery.catalogue.size_tables import FULL, choose_points, grade_sizes, round_to, same_triangles
from recovery.pattern.coordinates import control_points
from recovery.pattern.pattern_mesh import mesh_pattern
from recovery.sim.skin_contact import GridDistance
from tests.fixtures.garments import shipped
from tests.recovery.pattern_setup import default_measurements


def test_rows_are_added_where_the_field_is_missed_until_it_is_not():
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 3))
    values = np.stack([np.sin(2.0 * points[:, 0]), points[:, 1] ** 2], axis=1)
    found = {
        most: choose_points(points, values, field_in_space, step=1e-4, within=0.05, most=most, apart=0.1)
        for most in (20, 400)
    }
    assert len(found[20]) == 20 < len(found[400]) < 400
    given = field_in_space(points, found[400], round_to(values[found[400]], 1e-4))
    assert np.abs(given - values).max() < 0.05


def test_the_panels_of_a_size_are_those_of_m_on_its_own_control_points():
    body = default_measurements()
    mesh, larger = mesh_pattern(design("skirt", body).pattern, 0.05), design("skirt", body, "XL")
    rest = mesh.rest_at(control_points(larger.pattern).positions)
    assert len(mesh.folded(rest)) == 0
    of_its_own = mesh_pattern(larger.pattern, 0.05)
    for panel in range(len(larger.pattern.panels)):
        extents = [
            np.ptp(each.rest[each.panel == panel] if each is of_its_own else rest[mesh.panel == panel], axis=0)
            for each in (mesh, of_its_own)
        ]
        assert_allclose(*extents, atol=5e-4)  # curves are sampled at other places


@pytest.fixture(scope="module")
def skin() -> GridDistance:
    return body_distance(load_body(), QUICK)


def test_a_waistband_is_held_where_it_is(body: BodyModel, skin: GridDistance):
    made = design("skirt", default_measurements())
    mesh = mesh_pattern(made.pattern, 0.08)
    nodes = mesh.nodes_from(mesh.placed())  # before and behind the body, not yet sewn
    band = waistband(nodes, mesh.faces, body)
    assert band is not None
    fallen = Fall(made, mesh, fabric(made.fabric), skin, held=band.vertex).run(nodes, steps=2, still_m=0.0).nodes
    assert_array_equal(fallen[band.vertex], nodes[band.vertex])
    assert np.linalg.norm(fallen - nodes, axis=1).max() > 1e-3


def test_a_shipped_garment_grows_by_eight_centimetres_a_size_and_its_table_tells_where_it_fell(
    body: BodyModel, skin: GridDistance
):
    """A few steps on a coarse mesh; the panels, whose girths are measured, are those of the sizes all the same."""
    tank, said, options = shipped("tank"), list[str](), replace(FULL, coarse_m=0.05, coarse_steps=3)
    table = grade_sizes("tank", tank, body, default_measurements(), skin, report=said.append, options=options)
    assert_allclose(np.diff([table.measures[size]["chest_m"] for size in SIZES]), 0.08, atol=0.005)
    kept_mm = [float(found[1]) for line in said if (found := re.search(r"kept within ([\d.]+) mm", line))]
    assert len(kept_mm) == 3 and max(kept_mm) < 3.0


def test_triangles_are_the_same_in_any_order(tube: Garment):
    faces = tube.fine_faces
    assert same_triangles(faces, np.roll(faces[::-1], 1, axis=1))
    assert not same_triangles(faces, faces[1:]) and not same_triangles(faces, faces[:, [0, 1, 1]])


def test_a_garment_that_is_not_the_catalogues_is_refused(tube: Garment, body: BodyModel, skin: GridDistance):
    other = replace(tube, name="tank")
    with pytest.raises(InputError, match="garment tank: expected the catalogue's mesh in M"):
        grade_sizes("tank", other, body, default_measurements(), skin, report=print)
