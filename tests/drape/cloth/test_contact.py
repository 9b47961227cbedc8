"""Contact planes, the push-out baseline and the choice of colliders."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.body.skeleton import JOINT_NAMES
from drape.cloth import contact, energies
from drape.cloth.contact import BodyContact
from drape.cloth.energies import ClothMesh
from drape.cloth.material import material
from drape.errors import InputError
from drape.geometry import closest, meshes
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.geometry.geometry_shapes import icosphere


def bumpy_cloth(rng, *, frames=2, count=400, radius_m=0.5):
    """Points about a sphere, some inside."""
    directions = rng.normal(size=(frames, count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return directions * (radius_m + rng.uniform(-0.01, 0.01, size=(frames, count, 1)))


def test_nearest_vertices_equal_brute_force(rng):
    points, body_vertices = rng.normal(size=(2, 30, 3)), rng.normal(size=(2, 50, 3))
    subset = np.arange(0, 50, 3)
    squared = ((points[:, :, None] - body_vertices[:, None]) ** 2).sum(-1)
    assert (contact.nearest_body_vertices(points, body_vertices) == squared.argmin(-1)).all()
    of_subset = subset[squared[..., subset].argmin(-1)]
    assert (contact.nearest_body_vertices(points, body_vertices, vertices=subset) == of_subset).all()


@pytest.mark.parametrize("name", ["points", "body_vertices"])
def test_wrong_shapes_are_refused(name):
    arrays = {"points": np.zeros((2, 5, 3)), "body_vertices": np.zeros((2, 7, 3))} | {name: np.zeros((7, 3))}
    with pytest.raises(InputError, match=name):
        contact.nearest_body_vertices(**arrays)


def test_plane_distance_on_a_sphere_converges_to_the_radial_distance(rng):
    cloth = bumpy_cloth(rng)
    radial = np.linalg.norm(cloth, axis=-1) - 0.5
    errors = []
    for level in (3, 4, 5):
        vertices, faces = icosphere(level, radius_m=0.5)
        planes = BodyContact(faces, len(vertices)).planes(cloth, np.stack([vertices, vertices]))
        errors.append(np.abs(planes.distance(cloth) - radial).mean())
    assert_allclose(np.array(errors[:-1]) / errors[1:], 4.0, rtol=0.1, atol=0.0)


def test_contact_gradient_equals_central_differences(rng):
    rest, cloth_faces = grid(6, 5, cell_m=0.05)
    mesh = ClothMesh.from_rest(rest, cloth_faces)
    vertices, faces = icosphere(3, radius_m=0.5)
    cloth = (rest - rest.mean(0) + [0.0, 0.0, 0.47])[None]
    planes = BodyContact(faces, len(vertices)).planes(cloth, vertices[None])
    moving = torch.tensor(cloth, requires_grad=True)
    in_torch = energies.contact(planes.like(moving).distance(moving), mesh.like(moving), material())
    (gradient,) = torch.autograd.grad(in_torch.sum(), moving)
    direction = rng.normal(size=cloth.shape)

    def energy(step):
        return energies.contact(planes.distance(cloth + step * direction), mesh, material())

    assert_allclose(in_torch.detach().numpy(), energy(0.0), rtol=1e-12, atol=0.0)
    assert energy(0.0)[0] > 0.0
    slope = (gradient.numpy() * direction).sum()
    assert_allclose(slope, (energy(1e-7) - energy(-1e-7))[0] / 2e-7, rtol=1e-6, atol=0.0)


def test_push_out_reaches_the_clearance_and_leaves_the_rest_alone(rng):
    vertices, faces = icosphere(4, radius_m=0.5)
    sphere = BodyContact(faces, len(vertices))
    posed = np.stack([vertices, vertices])
    cloth = bumpy_cloth(rng)
    before = cloth.copy()
    pushed = contact.nearest_vertex_push(cloth, posed, sphere.normals(posed), 0.002)
    assert_allclose(cloth, before, rtol=0.0, atol=0.0)
    assert sphere.planes(pushed, posed).distance(pushed).min() >= 0.002 - 1e-5
    clear = sphere.planes(cloth, posed).distance(cloth) > 0.002
    assert clear.any() and not clear.all()
    assert_allclose(pushed[clear], cloth[clear], rtol=0.0, atol=0.0)
    inside = np.stack([closest.signed_distance(points, vertices, faces) for points in pushed])
    assert inside.min() > 0.0


def test_colliders_keep_trunk_and_limbs_and_thin_head_hands_and_feet(body):
    chosen = contact.collider_vertices(body)
    assert (np.diff(chosen) > 0).all()
    heaviest = body.weights.argmax(1)
    kept = np.bincount(heaviest[chosen], minlength=24) / np.bincount(heaviest, minlength=24)
    for joint, name in enumerate(JOINT_NAMES):
        if name in ("head", "left_hand", "right_hand", "left_foot", "right_foot"):
            assert 0.02 < kept[joint] < 0.4, name
        else:
            assert kept[joint] > 0.9, name


def test_no_collider_lies_inside_the_mouth(body):
    chosen = contact.collider_vertices(body)
    normals = meshes.vertex_normals(body.v_template, body.faces)
    head = chosen[body.weights[chosen, JOINT_NAMES.index("head")] > 0.5]
    ahead = body.v_template[head] + 0.02 * normals[head]
    assert closest.signed_distance(ahead, body.v_template, body.faces).min() > 0.009


def test_body_contact_holds_a_shell_around_the_body_outside(body):
    bodies = body.posed_vertices(np.zeros((1, 24, 3)))
    contacts = BodyContact.of_body(body)
    trunk = np.flatnonzero(body.weights[:, :10].sum(1) > 0.9)
    shell = (bodies + 0.004 * contacts.normals(bodies))[:, trunk]
    error = np.abs(contacts.planes(shell, bodies).distance(shell) - 0.004)
    assert (error > 0.001).mean() < 0.005  # in narrow folds another vertex is nearer
