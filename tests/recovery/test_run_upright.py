"""A garment without a body is set upright and turned to look ahead by its openings alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.garment.files.mesh import plain_mesh
from recovery.run.upright import facing, up_axis
from tests.drape.cloth.cloth_shapes import round_tube
from tests.recovery.test_run_cut import worn


@pytest.mark.parametrize("name", ["tshirt", "longsleeve", "dress", "trousers", "skirt"])
def test_openings_tell_the_up_axis(name):
    mesh = worn(name)
    assert up_axis(mesh) == "y"
    x, y, z = mesh.vertices.T
    assert up_axis(replace(mesh, vertices=np.stack([x, -z, y], axis=1))) == "z"


@pytest.mark.parametrize("name", ["tshirt", "dress", "trousers"])
@pytest.mark.parametrize("degrees", [90.0, 180.0, -70.0])
def test_a_garment_is_turned_until_its_wearer_looks_ahead(name, degrees):
    mesh = worn(name)
    assert facing(mesh) is mesh
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    aside = replace(mesh, vertices=mesh.vertices @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).T)
    found = facing(aside)
    assert "degrees to look along +z" in found.notes[-1]
    middle = mesh.vertices.mean(axis=0)
    assert_allclose(found.vertices - found.vertices.mean(axis=0), mesh.vertices - middle, rtol=0, atol=0.02)


def test_what_openings_do_not_tell_stays():
    skirt = worn("skirt")
    assert facing(skirt) is skirt
    bag = plain_mesh("bag", *round_tube([0.2, 0.2, 1e-3], [0.0, 0.3, 0.4], 12))
    one = bag.take_faces(bag.vertices[bag.faces][:, :, 1].max(axis=1) > 0.0)
    assert up_axis(one) == "y" and facing(one) is one
