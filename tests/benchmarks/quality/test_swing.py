"""The benchmark of swing: its clip, and its simulator against a fall without a body."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from benchmarks.quality.swing import FPS, Moving, _slowed, spin
from benchmarks.shared.newton import Cloth
from drape.body.assets import load_body
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.swing.step import AIR_KG_M3
from tests.drape.swing.swing_setup import strip


def test_the_body_turns_as_it_is_told():
    clip = spin(FPS, 4.5, 1.0)
    yaw = np.unwrap(clip.poses[:, 0, 1])
    assert_allclose(yaw[-1] / (2.0 * np.pi), 0.5 * 0.75 + 1.25 + 0.5 * 0.3, rtol=1e-2)
    assert_allclose(np.diff(yaw)[45:70] * FPS, 2.0 * np.pi, rtol=1e-6)
    assert (np.diff(yaw)[:14] == 0.0).all() and (np.diff(yaw)[-40:] == 0.0).all()


def test_cloth_far_from_a_body_falls():
    body = load_body()
    rest, faces = strip(0.1)
    mesh, material = ClothMesh.from_rest(rest, faces), Material()
    ahead = rest + np.array([3.0, 0.0, 0.0])
    step = Moving(
        Cloth.of(mesh, material, None),
        BodyContact(body.faces, body.vertex_count),
        body.posed_vertices(np.zeros((1, 24, 3)))[0],
        ahead,
        target=ahead,
        n_per_m=mesh.vertex_mass(material) * FPS**2,
    ).run(20, 1e-6)
    assert step.at_rest
    assert_allclose(step.x, ahead - np.array([0.0, 9.81 / FPS**2, 0.0]), atol=1e-5)


def test_air_slows_what_moves_across():
    rest, faces = strip(0.1)
    mesh, material = ClothMesh.from_rest(rest, faces), Material()
    along = np.tile([0.0, 1.0, 0.0], (len(rest), 1))
    assert_allclose(_slowed(along, rest, mesh, material, 0.0), along)
    across = np.tile([0.0, 0.0, 2.0], (len(rest), 1))
    slow = AIR_KG_M3 / 0.2 * 2.0 / FPS
    assert_allclose(_slowed(across, rest, mesh, material, 0.0), across / (1.0 + slow))
    assert_allclose(_slowed(along, rest, mesh, material, 3.0), along / (1.0 + 3.0 / FPS))
