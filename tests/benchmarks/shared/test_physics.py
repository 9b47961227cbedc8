"""The physics minimiser on problems whose optimum is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.shared import physics
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere

WEIGHTLESS = replace(material(), gravity_m_s2=0.0)
AWAY = np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def sphere():
    vertices, faces = icosphere(4, radius_m=0.1)
    return vertices, BodyContact(faces, len(vertices))


def test_a_stretched_sheet_far_from_the_body_returns_to_rest(sphere):
    body, contact = sphere
    rest, faces = grid(8, 6, cell_m=0.015)
    cloth = ClothMesh.from_rest(rest, faces)
    start = np.stack([1.2 * rest, [0.9, 1.1, 1.0] * rest]) + AWAY
    bodies = np.stack([body, body])
    optimum = physics.minimise(cloth, WEIGHTLESS, start, contact, bodies, step_limit=1500)
    before, after = (energies.membrane(x, cloth, WEIGHTLESS) for x in (start, optimum.vertices))
    assert (after < 1e-4 * before).all()
    assert (optimum.steps < 1500).all()
    assert (optimum.change < physics.TOLERANCE).all()
    assert (optimum.residual_n < 0.02).all()


def test_a_sheet_on_a_sphere_rests_in_the_gap_where_contact_carries_its_weight(sphere):
    body, contact = sphere
    rest, faces = grid(10, 10, cell_m=0.01)
    cloth = ClothMesh.from_rest(rest, faces)
    flat = (rest - rest.mean(axis=0))[:, [1, 2, 0]] + [0.0, 0.103, 0.0]
    optimum = physics.minimise(cloth, material(), flat[None], contact, body[None], step_limit=1500)
    parts = [
        metrics.static_parts(x, cloth, material(), contact, body[None], height_m=np.array([0.1]))
        for x in (flat[None], optimum.vertices)
    ]
    before, after = (np.stack(list(p.values())).sum() for p in parts)
    assert after < before
    distance = contact.planes(optimum.vertices, body[None]).distance(optimum.vertices)
    assert distance.min() > 0.0
    assert np.median(distance) < 2.0 * material().contact_gap_m


def test_frames_do_not_see_each_other(sphere):
    body, contact = sphere
    rest, faces = grid(6, 6, cell_m=0.01)
    cloth = ClothMesh.from_rest(rest, faces)
    start = np.stack([1.1 * rest, 0.9 * rest]) + AWAY
    bodies = np.stack([body, body])
    both = physics.minimise(cloth, WEIGHTLESS, start, contact, bodies, step_limit=300)
    alone = physics.minimise(cloth, WEIGHTLESS, start[:1], contact, bodies[:1], step_limit=300)
    assert_allclose(both.vertices[0], alone.vertices[0], rtol=0.0, atol=2e-5)


def test_stiffness_bounds_the_diagonal_of_the_hessian(rng):
    rest, faces = grid(4, 4, cell_m=0.015)
    cloth = ClothMesh.from_rest(rest, faces)
    bound = physics.vertex_stiffness(cloth, material())
    step = 1e-4

    def energy(x):
        return energies.membrane(x, cloth, material()) + energies.bending(x, cloth, material())

    for vertex in rng.integers(0, len(rest), size=8):
        for axis in range(3):
            shift = np.zeros_like(rest)
            shift[vertex, axis] = step
            curvature = (energy(rest + shift) + energy(rest - shift) - 2.0 * energy(rest)) / step**2
            assert curvature < 1.5 * bound[vertex]
