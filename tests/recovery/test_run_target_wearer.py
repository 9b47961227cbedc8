"""A garment without a body is set upright and turned to look ahead by its openings alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.garment.files.mesh import GarmentMesh, plain_mesh
from recovery.run import __main__ as command
from recovery.run.target import facing, inside_wearer, turn_about, up_axis
from tests.drape.cloth.cloth_shapes import round_tube
from tests.recovery.test_run_cut import worn


@pytest.mark.parametrize("name", ["tshirt", "longsleeve", "dress", "trousers", "skirt"])
def test_openings_tell_the_up_axis(name):
    mesh = worn(name)
    assert up_axis(mesh) == "y"
    x, y, z = mesh.vertices.T
    assert up_axis(replace(mesh, vertices=np.stack([x, -z, y], axis=1))) == "z"


@pytest.mark.parametrize("name", ["tshirt", "dress", "trousers"])
@pytest.mark.parametrize("degrees", [80.0, -70.0])
def test_a_garment_is_turned_until_its_limbs_lie_side_by_side(name, degrees):
    mesh = worn(name)
    assert facing(mesh) is mesh
    found = facing(turn_about(mesh, np.radians(degrees)))
    assert "degrees to look along +z" in found.notes[-1]
    middle = mesh.vertices.mean(axis=0)
    assert_allclose(found.vertices - found.vertices.mean(axis=0), mesh.vertices - middle, rtol=0, atol=0.02)


def low_back() -> GarmentMesh:
    """The catalogue's tank with a neckline that is lower behind: cloth is cut out of its back."""
    tank = worn("tank")
    middle = tank.vertices[tank.faces].mean(axis=1)
    hollow = (np.abs(middle[:, 0]) < 0.07) & (middle[:, 1] > 0.3) & (middle[:, 2] < 0.0)
    return tank.take_faces(~hollow)


@pytest.mark.parametrize(
    ("mesh", "delivered", "front", "turns"),
    [
        pytest.param("tank", 180.0, "auto", True, marks=pytest.mark.long),
        ("trousers", 180.0, "auto", True),
        ("low back", 0.0, "auto", False),
        pytest.param("low back", 180.0, "auto", True, marks=pytest.mark.long),
        ("low back", 0.0, "turned", True),
        pytest.param("tank", 180.0, "kept", False, marks=pytest.mark.long),
    ],
)
def test_the_body_that_fits_inside_tells_front_from_back(mesh, delivered, front, turns):
    """A neckline that is lower behind, as many are, does not turn a garment on its own."""
    one = low_back() if mesh == "low back" else worn(mesh)
    one = plain_mesh(mesh, turn_about(one, np.radians(delivered)).vertices, one.faces)
    found, _ = inside_wearer(one, front=front)
    assert any("turned by 180 degrees" in note for note in found.notes) == turns
    moved = np.abs(found.vertices - found.vertices.mean(axis=0) - one.vertices + one.vertices.mean(axis=0)).max()
    assert (moved > 0.1) == turns


def test_what_openings_do_not_tell_stays():
    skirt = worn("skirt")
    assert facing(skirt) is skirt
    bag = plain_mesh("bag", *round_tube([0.2, 0.2, 1e-3], [0.0, 0.3, 0.4], 12))
    one = bag.take_faces(bag.vertices[bag.faces][:, :, 1].max(axis=1) > 0.0)
    assert up_axis(one) == "y" and facing(one) is one


def test_the_shape_of_the_body_may_begin_with_a_minus():
    given = command.parse(["t.obj", "--out", "out", "--betas", "-1,0.5", "--no-garment"])
    assert command.read_betas(given.betas).tolist() == [-1.0, 0.5]
