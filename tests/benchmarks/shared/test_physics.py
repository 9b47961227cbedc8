"""The physics minimiser on problems whose optimum is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.shared import physics
from drape.catalog import find_garments, open_garment
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.errors import MeshError
from drape.geometry import meshes
from drape.geometry.skinning import skin_points
from tests.benchmarks.quality.quality_setup import body as standard_body
from tests.benchmarks.shared.plain_descent import plain_descent
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere

WEIGHTLESS = replace(material(), gravity_m_s2=0.0)
AWAY = np.array([0.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def sphere():
    vertices, faces = icosphere(4, radius_m=0.1)
    return vertices, BodyContact(faces, len(vertices))


@pytest.fixture
def early(monkeypatch):
    """Adam hands over after 100 steps, so that both phases run within a second."""
    monkeypatch.setattr(physics, "ADAM_STEPS", 100)


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


def with_needles(share: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet whose diagonals carry a vertex at ``share`` of their length: two needles and two halves per cell."""
    rest, faces = grid(8, 8, cell_m=0.015)
    lower, upper = np.split(faces, 2)
    a, c = lower[:, 0], lower[:, 2]
    new = len(rest) + np.arange(len(a))
    split = [(a, lower[:, 1], new), (new, lower[:, 1], c), (a, new, upper[:, 2]), (new, c, upper[:, 2])]
    between = (1.0 - share) * rest[a] + share * rest[c]
    return np.concatenate([rest, between]), np.concatenate([np.stack(corners, axis=1) for corners in split])


def uneven() -> tuple[np.ndarray, np.ndarray]:
    """A sheet of cells 0.05 to 60 mm wide."""
    rest, faces = grid(8, 8, cell_m=1.0)
    ticks = 0.1 * (np.arange(9) / 8.0) ** 4 + 1e-5 * np.arange(9)
    return np.stack([ticks[rest[:, 0].astype(int)], 0.015 * rest[:, 1], rest[:, 2]], axis=1), faces


def subdivided() -> tuple[np.ndarray, np.ndarray]:
    """Two cells, 1,024 triangles."""
    rest, faces = grid(2, 1, cell_m=0.06)
    for _ in range(4):
        rest, faces, _ = meshes.subdivide(rest, faces)
    return rest, faces


SHEETS = {
    "needles": with_needles(1e-3),
    "doubled vertices": with_needles(1e-5),
    "uneven": uneven(),
    "subdivided": subdivided(),
}


def lying(rest: np.ndarray) -> np.ndarray:
    """The sheet as a start (1, V, 3), within the gap above the sphere."""
    return (rest - rest.mean(axis=0))[None][..., [1, 2, 0]] + [0.0, 0.101, 0.0]


def total_j(vertices, cloth, contact, body):
    height_m = np.zeros(len(vertices), dtype=vertices.dtype)
    parts = metrics.static_parts(vertices, cloth.like(vertices), material(), contact, body, height_m=height_m)
    return np.stack(list(parts.values())).sum(axis=0)


@pytest.mark.parametrize("sheet", SHEETS)
def test_the_energy_ends_below_its_start_on_every_mesh(sphere, sheet, early):
    body, contact = sphere
    rest, faces = SHEETS[sheet]
    cloth = ClothMesh.from_rest(rest, faces)
    flat = lying(rest)
    start = np.concatenate([flat, 1.1 * flat - [0.0, 0.009, 0.0]])
    bodies = np.stack([body, body])
    optimum = physics.minimise(cloth, material(), start, contact, bodies, step_limit=200)
    before, after = (total_j(x, cloth, contact, bodies) for x in (start, optimum.vertices))
    assert (after < before).all()
    assert_allclose(optimum.start_j - optimum.energy_j, before - after, rtol=1e-9, atol=0.0)
    single = [total_j(x.astype(np.float32), cloth, contact, bodies) for x in (start, optimum.vertices)]
    assert (single[1] < single[0]).all()


def test_steps_a_hundred_times_too_long_still_descend(sphere, early, monkeypatch):
    body, contact = sphere
    rest, faces = grid(8, 8, cell_m=0.015)
    cloth = ClothMesh.from_rest(rest, faces)
    monkeypatch.setattr(physics, "STEP", 100.0 * physics.STEP)

    def after(steps):
        start = 1.02 * rest[None] + AWAY
        return physics.minimise(cloth, WEIGHTLESS, start, contact, body[None], step_limit=steps).energy_j[0]

    assert after(300) < 0.1 * after(physics.ADAM_STEPS)


def test_a_garment_that_does_not_come_to_rest_is_refused_by_its_name(sphere, early):
    body, contact = sphere
    rest, faces = with_needles(1e-6)
    cloth = ClothMesh.from_rest(rest, faces)
    with pytest.raises(MeshError, match=r"mesh it anew: its lowest triangle is 1\.5e-05 mm high") as refusal:
        physics.minimise(cloth, material(), 1.1 * lying(rest), contact, body[None], step_limit=200, name="blouse")
    assert refusal.value.name == "blouse"
    assert " N weight) worth " in refusal.value.got
    assert "in pose 0, energy " in refusal.value.got


def test_a_start_without_a_finite_energy_is_refused(sphere):
    body, contact = sphere
    rest, faces = grid(3, 3)
    start = np.stack([rest, rest]) + AWAY
    start[1, 0] = 1e9
    cloth = ClothMesh.from_rest(rest, faces)
    with pytest.raises(MeshError, match="in pose 1, energy"):
        physics.minimise(cloth, WEIGHTLESS, start, contact, np.stack([body, body]), step_limit=100)


def test_the_shipped_t_shirt_ends_no_higher_than_the_plain_descent(early):
    body, pose = standard_body(), np.zeros((1, 24, 3))
    pose[0, [16, 17], 2] = [-0.9, 0.9]  # both arms down
    garment = open_garment(find_garments(["tshirt"])[0], body)
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    cloth, contact, skin = (
        ClothMesh.from_rest(rest, faces),
        BodyContact(body.faces, body.vertex_count),
        body.posed_vertices(pose),
    )
    skinned = skin_points(rest[None], garment.skin_weights.astype(np.float64), *body.bones(pose))
    start = nearest_vertex_push(skinned, skin, np.asarray(contact.normals(skin)))
    plain = plain_descent(cloth, material(), start, contact, skin, step_limit=200)
    optimum = physics.minimise(cloth, material(), start, contact, skin, step_limit=200)
    before, plainly, after = (total_j(x, cloth, contact, skin)[0] for x in (start, plain, optimum.vertices))
    assert plainly < before
    assert after <= plainly + 0.01 * (before - plainly)
