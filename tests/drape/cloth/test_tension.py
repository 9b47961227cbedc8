"""Strain of evenly stretched cloth, and Laplace's law on a cylinder."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import flat_rest, modelled_rest
from drape.cloth.tension import cloth_tension, face_means, face_pressure
from tests.drape.cloth import cloth_shapes

STIFFNESS = (120.0, 80.0, 25.0, 60.0)
AROUND, ALONG, RADIUS_M = 60, 8, 0.12
ROUNDING = 1e-11


def stretched_tube(stretch: float) -> tuple[np.ndarray, ClothMesh]:
    """A tube of ``RADIUS_M`` at rest, wider by ``stretch``."""
    rest, faces = cloth_shapes.tube(AROUND, ALONG, radius_m=RADIUS_M, height_m=0.3)
    return rest * [1.0 + stretch, 1.0, 1.0 + stretch], ClothMesh.of(flat_rest(rest, faces), faces, len(rest))


def inner(values: np.ndarray) -> np.ndarray:
    """The rows of vertices of the tube that do not lie on its borders."""
    return values[AROUND:-AROUND]


def test_an_even_stretch_is_the_strain_of_both_axes(rng):
    rest, faces = cloth_shapes.grid()
    cloth = ClothMesh.of(modelled_rest(rest, faces), faces, len(rest))
    turned = rest * [1.05, 1.03, 1.0] @ cloth_shapes.random_rotation(rng).T + rng.normal(size=3)
    found = cloth_tension(turned, cloth, STIFFNESS, np.ones(len(rest), dtype=bool))
    assert_allclose(found.warp, 0.03, rtol=0.0, atol=ROUNDING)  # y hangs: it is the warp
    assert_allclose(found.weft, 0.05, rtol=0.0, atol=ROUNDING)
    assert_allclose(found.pressure, 0.0, atol=1e-6, err_msg="flat cloth presses nothing")


@pytest.mark.parametrize("stretch", [0.0, 0.06])
def test_a_stretched_cylinder_presses_by_tension_over_radius(stretch: float):
    vertices, cloth = stretched_tube(stretch)
    found = cloth_tension(vertices, cloth, STIFFNESS, np.ones(len(vertices), dtype=bool))
    length = 1.0 + stretch
    # The second Piola-Kirchhoff stress times the stretch is the force per width that is there now.
    tension_n_per_m = STIFFNESS[1] * 0.5 * (length**2 - 1.0) * length
    assert_allclose(inner(found.weft), stretch, rtol=1e-9, atol=ROUNDING)
    assert_allclose(inner(found.warp), 0.0, rtol=0.0, atol=ROUNDING)
    want = tension_n_per_m / (RADIUS_M * length)
    assert_allclose(inner(inner(found.pressure)), want, rtol=(np.pi / AROUND) ** 2, atol=1e-6)


def test_cloth_off_the_skin_hollow_or_slack_presses_nothing():
    vertices, cloth = stretched_tube(0.06)
    touching = np.zeros(len(vertices), dtype=bool)
    assert not cloth_tension(vertices, cloth, STIFFNESS, touching).pressure.any()
    touching[:] = True
    slack, _ = stretched_tube(-0.06)
    assert_allclose(cloth_tension(slack, cloth, STIFFNESS, touching).pressure, 0.0, atol=1e-6)
    inwards = ClothMesh.of(flat_rest(vertices, cloth.faces[:, ::-1]), cloth.faces[:, ::-1], len(vertices))
    assert (face_pressure(1.05 * vertices, inwards, STIFFNESS) <= 1e-6).all()
    assert not cloth_tension(1.05 * vertices, inwards, STIFFNESS, touching).pressure.any()


def test_means_of_a_constant_are_the_constant_and_weigh_by_area():
    _, cloth = stretched_tube(0.0)
    assert_allclose(face_means(np.full((2, len(cloth.faces)), 3.0), cloth), 3.0, rtol=1e-12)
    values = np.arange(float(len(cloth.faces)))
    assert_allclose(face_means(values, cloth) @ cloth.vertex_area, values @ cloth.face_area, rtol=1e-12)
