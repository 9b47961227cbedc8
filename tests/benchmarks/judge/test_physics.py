"""The physics minimiser on problems whose optimum is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from benchmarks.judge import physics
from benchmarks.judge.physics import OptimumTask
from drape.catalog import find_garments, open_garment
from drape.cloth import energies, metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material, material
from drape.cloth.rest_state import flat_rest
from drape.cloth.waistband import SLACK_M, STIFFNESS_N_M2
from drape.errors import MeshError
from drape.exact.blended_planes import BlendedPlanes
from drape.exact.linear import Charts
from drape.exact.newton import Cloth, Descent
from drape.geometry import meshes
from drape.geometry.skinning import skin_points
from tests.benchmarks.quality_setup import body as standard_body
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere

WEIGHTLESS = replace(material(), gravity_m_s2=0.0)
AWAY = np.array([0.0, 1.0, 0.0])


def sheet(*cells: int, cell_m: float = 0.01) -> tuple[np.ndarray, ClothMesh]:
    """The rest positions and the constants of a grid."""
    rest, faces = grid(*cells, cell_m=cell_m)
    return rest, ClothMesh.from_rest(rest, faces)


@pytest.fixture(scope="module")
def sphere():
    vertices, faces = icosphere(4, radius_m=0.1)
    return vertices, BodyContact(faces, len(vertices))


def task_of(sphere, cloth, made_of, start, **others) -> OptimumTask:
    """The sheet ``start`` (F, V, 3), or several of them, over spheres."""
    vertices, contact = sphere
    starts = start if isinstance(start, tuple) else (start,)
    return OptimumTask(cloth, made_of, contact, np.stack([vertices] * len(starts[0])), starts, **others)


def test_a_stretched_sheet_far_from_the_body_returns_to_rest(sphere):
    rest, cloth = sheet(8, 6, cell_m=0.015)
    start = np.stack([1.2 * rest, [0.9, 1.1, 1.0] * rest]) + AWAY
    # Without weight no force is small beside it: the steps run out, or none lowers the energy any more.
    optimum = physics.minimise(task_of(sphere, cloth, WEIGHTLESS, start))
    before, after = (energies.membrane(x, cloth, WEIGHTLESS) for x in (start, optimum.vertices))
    assert (after < 1e-8 * before).all()
    assert (optimum.residual_n < 1e-4).all()
    assert not optimum.converged.any()


def lying(rest: np.ndarray, height_m: float = 0.101) -> np.ndarray:
    """The sheet as a start (1, V, 3), within the gap above the sphere."""
    return (rest - rest.mean(axis=0))[None][..., [1, 2, 0]] + [0.0, height_m, 0.0]


@pytest.mark.parametrize("name", ["isotropic", "poplin", "denim"])
def test_a_sheet_on_a_sphere_comes_to_rest_in_the_gap_where_contact_carries_its_weight(sphere, name):
    rest, faces = grid(10, 10, cell_m=0.01)
    made_of = material() if name == "isotropic" else Material.of(fabric(name))
    cloth = ClothMesh.of(flat_rest(rest, faces), faces, len(rest))
    task = task_of(sphere, cloth, made_of, lying(rest, 0.103))
    optimum = physics.minimise(task)
    assert optimum.converged.all()
    weight_n = made_of.gravity_m_s2 * cloth.vertex_mass(made_of).sum()
    assert optimum.residual_n[0] <= 0.01 * weight_n
    assert optimum.energy_j[0] < optimum.start_j[0]
    vertices, contact = sphere
    x = optimum.vertices[0]
    point, normal, _ = BlendedPlanes.of_body(contact, vertices, len(x), made_of.contact_gap_m)(x)
    distance = ((x - point) * normal).sum(axis=1)
    assert distance.min() > 0.0
    depth = np.maximum(made_of.contact_gap_m - distance, 0.0)
    push = 2.0 * made_of.contact_j_m4 * cloth.vertex_area * depth
    assert_allclose((push[:, None] * normal).sum(axis=0), [0.0, weight_n, 0.0], atol=0.1 * weight_n, rtol=0)


def test_frames_do_not_see_each_other_and_give_the_same_bits_again(sphere):
    rest, cloth = sheet(6, 6)
    start = np.concatenate([lying(1.1 * rest), lying(0.9 * rest)])
    both = physics.minimise(task_of(sphere, cloth, material(), start))
    alone = physics.minimise(task_of(sphere, cloth, material(), start[1:]))
    assert_array_equal(both.vertices[1], alone.vertices[0])


def test_a_waistband_holds_what_would_fall(sphere):
    rest, cloth = sheet(6, 6)
    start = rest[None] + AWAY
    top = np.flatnonzero(rest[:, 1] > rest[:, 1].max() - 1e-9)
    band = physics.Waistband(top, np.full(len(top), 0.01), start[:, top])
    hung = physics.minimise(task_of(sphere, cloth, material(), start, waistband=band))
    assert hung.converged[0]
    assert hung.energy_j[0] <= hung.start_j[0]
    way = np.linalg.norm(hung.vertices[0, top] - start[0, top], axis=1)
    pull = STIFFNESS_N_M2 * band.length_m * np.maximum(way - SLACK_M, 0.0)
    assert_allclose(pull.sum(), material().gravity_m_s2 * cloth.vertex_mass(material()).sum(), rtol=0.05, atol=0.0)


def test_of_several_starts_the_lowest_counts(sphere):
    rest, cloth = sheet(6, 6)
    near, far = lying(rest, 0.103), lying(1.5 * rest, 0.103)
    one = physics.minimise(task_of(sphere, cloth, material(), (far,)), step_limit=2)
    two = physics.minimise(task_of(sphere, cloth, material(), (far, near)), step_limit=2)
    assert two.energy_j[0] < one.energy_j[0]
    assert two.start_j[0] < one.start_j[0]
    assert two.energy_j[0] <= two.start_j[0]


def test_stiffness_bounds_the_diagonal_of_the_hessian(rng):
    rest, cloth = sheet(4, 4, cell_m=0.015)
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


def test_a_sheet_beside_the_body_touches_only_what_it_is_near_to():
    body, body_faces = grid(20, 20, cell_m=0.01)  # normals along +z
    contact, skin = BodyContact(body_faces, len(body)), body[None]
    rest, faces = grid(10, 10, cell_m=0.01)
    cloth, of, level = ClothMesh.from_rest(rest, faces), material(), np.zeros(1)
    over, beside = rest[None] + [0.05, 0.05, 0.002], rest[None] + [0.53, 0.05, -0.010]

    def contact_j(parts_of, sheet):
        return parts_of(sheet, cloth, of, contact, skin, height_m=level)["contact"][0]

    per_square = of.contact_j_m4 * cloth.vertex_area.sum()
    for parts_of in (physics.energy_parts, metrics.static_parts):
        assert_allclose(contact_j(parts_of, over), per_square * (of.contact_gap_m - 0.002) ** 2, rtol=1e-9, atol=0.0)
    # A third of a metre beside the border the plane of its vertices cuts through free space.
    nearest_j = per_square * (of.contact_gap_m + 0.010) ** 2
    assert_allclose(contact_j(metrics.static_parts, beside), nearest_j, rtol=1e-9, atol=0.0)
    assert contact_j(physics.energy_parts, beside) == 0.0
    single = physics.energy_parts(beside.astype(np.float32), cloth, of, contact, skin, height_m=level)
    assert single["contact"][0] == 0.0


SHEETS = {
    "needles": with_needles(1e-3),
    "doubled vertices": with_needles(1e-5),
    "uneven": uneven(),
    "subdivided": subdivided(),
}


def total_j(vertices, cloth, contact, body, made_of=None):
    height_m = np.zeros(len(vertices), dtype=vertices.dtype)
    of = made_of or material()
    parts = physics.energy_parts(vertices, cloth.like(vertices), of, contact, body, height_m=height_m)
    return np.stack(list(parts.values())).sum(axis=0)


@pytest.mark.parametrize("sheet", SHEETS)
def test_the_energy_ends_below_its_start_on_every_mesh(sphere, sheet):
    body, contact = sphere
    rest, faces = SHEETS[sheet]
    cloth = ClothMesh.from_rest(rest, faces)
    flat_sheet = lying(rest)
    start = np.concatenate([flat_sheet, 1.1 * flat_sheet - [0.0, 0.009, 0.0]])
    optimum = physics.minimise(task_of(sphere, cloth, material(), start), step_limit=40)
    before, after = (total_j(x, cloth, contact, np.stack([body, body])) for x in (start, optimum.vertices))
    assert (after < before).all()
    assert_allclose(optimum.start_j - optimum.energy_j, before - after, rtol=1e-9, atol=0.0)
    assert np.isfinite(optimum.residual_n).all()


def test_what_does_not_come_near_rest_is_refused_by_its_name(sphere):
    rest, cloth = sheet(8, 8, cell_m=0.015)
    start = 5.0 * lying(rest)
    with pytest.raises(MeshError, match=r"mesh it anew: its lowest triangle is 11 mm high") as refusal:
        physics.minimise(task_of(sphere, cloth, material(), start, name="blouse"), step_limit=0)
    assert refusal.value.name == "blouse"
    assert " N weight) worth " in refusal.value.got
    assert "in pose 0, energy " in refusal.value.got


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_start_without_a_finite_energy_is_refused(sphere):
    rest, faces = grid(3, 3)
    good = np.stack([rest, rest]) + AWAY
    bad = good.copy()
    bad[1, 0] = 1e100
    cloth = ClothMesh.from_rest(rest, faces)
    with pytest.raises(MeshError, match="in pose 1, energy"):
        physics.minimise(task_of(sphere, cloth, WEIGHTLESS, bad), step_limit=5)


def test_a_collapsed_triangle_is_laid_out_where_no_step_leads_down(sphere):
    body, contact = sphere
    rest, faces = grid(6, 6, cell_m=0.01)
    flat_cloth = ClothMesh.of(flat_rest(rest, faces), faces, len(rest))
    start = lying(rest, 0.103)[0]
    start[faces[20, 0]] = 0.5 * (start[faces[20, 1]] + start[faces[20, 2]])
    found = Descent(Cloth.of(flat_cloth, material(), None), contact, body, start)
    assert found._lay_out()
    corners = found.now.x[faces[20]]
    area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    assert area > 0.5 * flat_cloth.face_area[20]
    assert found.best.energy < found.start_j
    assert not found._lay_out()


@pytest.mark.parametrize("made_of", [None, "jersey"])
@pytest.mark.long
def test_the_shipped_t_shirt_comes_to_rest_below_both_starts(made_of):
    body, pose = standard_body(), np.zeros((1, 24, 3))
    pose[0, [16, 17], 2] = [-0.9, 0.9]  # both arms down
    garment = open_garment(find_garments(["tshirt"])[0], body)
    rest, faces = garment.vertices.astype(np.float64), garment.fine_faces.astype(np.int64)
    contact, skin = BodyContact(body.faces, body.vertex_count), body.posed_vertices(pose)
    skinned = skin_points(rest[None], garment.skin_weights(body).astype(np.float64), *body.bones(pose))
    pushed = nearest_vertex_push(skinned, skin, np.asarray(contact.normals(skin)))
    cloth, of = ClothMesh.from_rest(rest, faces), material()
    if made_of is not None:
        cloth, of = ClothMesh.of(garment.rest_state(), faces, len(rest)), Material.of(fabric(made_of))
    task = OptimumTask(
        cloth, of, contact, skin, (pushed, skinned), charts=Charts(garment.chart_patch, garment.chart_weight)
    )
    optimum = physics.minimise(task)
    starts = [total_j(x, cloth, contact, skin, of)[0] for x in task.starts]
    assert total_j(optimum.vertices, cloth, contact, skin, of)[0] < min(starts)
    assert optimum.converged[0]
    assert optimum.residual_n[0] <= 0.01 * of.gravity_m_s2 * cloth.vertex_mass(of).sum()
    # Planes of the nearest body vertices, which stand off the skin, say much the same of what was gained.
    assert abs(optimum.energy_j[0] - optimum.nearest_j[0]) < 0.1 * (optimum.start_j[0] - optimum.energy_j[0])
