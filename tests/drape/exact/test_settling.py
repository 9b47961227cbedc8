"""Settling: the exact place where the stiffness is the energy's own, never above the start, and memory that helps."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material
from drape.cloth.rest_state import flat_rest
from drape.exact import settling
from drape.exact.newton import Cloth, Descent
from drape.live.whole import stiffness
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere


def cloth_of(name: str) -> tuple[ClothMesh, Material]:
    rest, faces = grid(12, 12, cell_m=0.01)
    return ClothMesh.of(flat_rest(rest, faces), faces, len(rest)), Material.of(fabric(name))


def test_where_the_stiffness_is_the_energys_own_one_round_is_enough():
    cloth, material = cloth_of("satin")
    matrix = stiffness(cloth, material, np.zeros(cloth.vertex_count))
    goal = 1e-2 * np.random.default_rng(2).uniform(-0.5, 0.5, size=(cloth.vertex_count, 3))

    def found(x: np.ndarray) -> settling.State:
        force = matrix @ (x - goal)
        return settling.State(x, 0.5 * float(((x - goal) * force).sum()), force)

    got = settling.settle(found(np.zeros_like(goal)), found, settling.inverse(cloth, material), 1)
    assert_allclose(got.x, goal, rtol=0.0, atol=1e-12)
    assert settling.settle(found(goal), found, settling.inverse(cloth, material), 30).energy <= 1e-20


def test_a_sheet_over_a_ball_settles_lower_with_its_memory_and_never_above_the_start(monkeypatch):
    cloth, material = cloth_of("jersey")
    rest, _ = grid(12, 12, cell_m=0.01)
    body, faces = icosphere(4, radius_m=0.1)
    contact = BodyContact(faces, len(body))
    start = 1.06 * ((rest - rest.mean(axis=0))[:, [1, 2, 0]] + [0.0, 0.105, 0.0])
    energies = []
    for memory in (0.0, settling.MEMORY):
        monkeypatch.setattr(settling, "MEMORY", memory)
        one = Descent(Cloth.of(cloth, material, None), contact, body, start)
        one.settle(100)
        energies.append(one.best.energy)
        assert one.best.energy < one.start_j
    assert energies[1] < energies[0]
    lost = settling.settle(one.best, lambda x: one.evaluate(x)._replace(energy=np.nan), one.cloth.solve, 60)
    assert lost is one.best
