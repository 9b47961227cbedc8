"""Mesh topology and geometry: laws, closed forms, numpy against torch."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import MeshError
from drape.geometry import mesh_graphs, meshes
from tests.drape.cloth.cloth_shapes import equilateral, grid, random_rotation, tube
from tests.drape.geometry.geometry_shapes import box, icosphere
from tests.fixtures.laws import each

SHAPES = {  # mesh, Euler characteristic, boundary loops
    "grid": (grid(), 1, 1),
    "equilateral": (equilateral(5, 4), 1, 1),
    "tube": (tube(), 0, 2),
    "box": (box(), 2, 0),
    "sphere": (icosphere(2), 2, 0),
}
for_each_shape = each(shape=SHAPES)


@for_each_shape
def test_edges_and_hinges_fulfil_euler(shape):
    (vertices, faces), characteristic, loop_count = shape
    edges, uses = meshes.edge_uses(faces)
    hinges = meshes.hinges(faces)
    loops = meshes.boundary_loops(faces)
    assert len(vertices) - len(edges) + len(faces) == characteristic
    assert len(loops) == loop_count
    assert len(hinges) == len(edges) - sum(len(loop) for loop in loops)
    assert 3 * len(faces) == len(edges) + len(hinges) == uses.sum()
    sides = {tuple(sorted((face[k], face[k - 1]))) for face in faces.tolist() for k in range(3)}
    assert_array_equal(edges, sorted(sides))
    assert_array_equal(meshes.boundary_edges(faces), edges[uses == 1])
    assert_array_equal(meshes.boundary_vertices(faces), np.unique(np.concatenate([*loops, np.zeros(0, int)])))


@for_each_shape
def test_a_hinge_names_its_two_faces(shape):
    (_, faces), _, _ = shape
    hinges, sides = meshes.hinges(faces), meshes.hinge_faces(faces)
    first, second = np.sort(faces[sides[:, 0]], axis=1), np.sort(faces[sides[:, 1]], axis=1)
    assert_array_equal(np.sort(hinges[:, [0, 1, 2]], axis=1), first)
    assert_array_equal(np.sort(hinges[:, [0, 1, 3]], axis=1), second)
    assert (sides[:, 0] != sides[:, 1]).all()


def test_hinge_normals_of_a_flat_sheet_agree():
    vertices, faces = grid()
    i, j, k, l = vertices[meshes.hinges(faces)].transpose(1, 0, 2)
    one, other = np.cross(j - i, k - i), np.cross(l - i, j - i)
    assert (one[:, 2] > 0.0).all()
    assert (other[:, 2] > 0.0).all()


def test_three_faces_on_an_edge_give_two_hinges():
    faces = np.array([[0, 1, 2], [0, 1, 3], [1, 0, 4]])
    assert len(meshes.hinges(faces)) == 2


def test_no_faces_have_no_edges():
    assert meshes.unique_edges(np.zeros((0, 3), dtype=int)).shape == (0, 2)


def test_boundary_loops_follow_the_orientation_longest_first():
    vertices, faces = tube(around=12, along=5)
    loops = meshes.boundary_loops(faces)
    assert sorted(map(sorted, (loop.tolist() for loop in loops))) == [list(range(12)), list(range(60, 72))]
    directed = set(map(tuple, meshes.half_edges(faces)[:, :2].tolist()))
    for loop in loops:
        assert all(pair in directed for pair in zip(loop.tolist(), np.roll(loop, -1).tolist(), strict=True))
    vertices, faces = grid(3, 3)
    both = np.concatenate([faces + len(vertices), grid(2, 2)[1]])  # the small one's indices are among 0..8
    assert [len(loop) for loop in meshes.boundary_loops(both)] == [12, 8]


def test_boundaries_that_touch_in_a_vertex_use_every_edge_once():
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    assert sum(len(loop) for loop in meshes.boundary_loops(faces)) == 6


def test_connected_components_count_pieces_and_loose_vertices():
    _, faces = grid(1, 1)
    labels = mesh_graphs.connected_components(np.concatenate([faces, faces + 4]), 9)
    assert_array_equal(labels, [0, 0, 0, 0, 1, 1, 1, 1, 2])


def test_umbrella_laplacian_annuls_constants_and_linear_maps_on_a_regular_sheet():
    vertices, faces = equilateral(6, 6)
    moved = mesh_graphs.umbrella_laplacian(faces, len(vertices)) @ vertices
    border = np.unique(np.concatenate(meshes.boundary_loops(faces)))
    inner = np.setdiff1d(np.arange(len(vertices)), border)
    assert_allclose(moved[inner], 0.0, rtol=0.0, atol=1e-16)
    assert np.abs(moved[border]).max() > 1e-3
    lonely = mesh_graphs.umbrella_laplacian(faces, len(vertices) + 1)
    assert_allclose(lonely @ np.ones(len(vertices) + 1), 0.0, rtol=0.0, atol=1e-15)


@for_each_shape
def test_subdivision_keeps_area_orientation_and_the_first_vertices(shape):
    (vertices, faces), _, loop_count = shape
    fine_vertices, fine_faces, parents = meshes.subdivide(vertices, faces)
    assert_array_equal(fine_vertices[: len(vertices)], vertices)
    assert_array_equal(parents[: len(vertices)], np.repeat(np.arange(len(vertices))[:, None], 2, axis=1))
    assert_allclose(fine_vertices, vertices[parents].mean(axis=1), rtol=0.0, atol=0.0)
    assert len(fine_vertices) == len(vertices) + len(meshes.unique_edges(faces))
    coarse, fine = meshes.area_vectors(vertices, faces), meshes.area_vectors(fine_vertices, fine_faces)
    assert_allclose(fine.reshape(-1, 4, 3), np.repeat(coarse[:, None] / 4.0, 4, axis=1), rtol=1e-9, atol=1e-18)
    assert len(meshes.boundary_loops(fine_faces)) == loop_count


def test_areas_and_normals_of_a_box():
    vertices, faces = box((0.1, 0.2, 0.3))
    assert_allclose(meshes.face_areas(vertices, faces).sum(), 8.0 * (0.02 + 0.03 + 0.06), rtol=1e-12, atol=0.0)
    normals = meshes.face_normals(vertices, faces)
    centres = vertices[faces].mean(axis=1)
    assert_allclose(np.abs(normals).max(axis=1), 1.0, rtol=1e-12, atol=0.0)
    assert ((normals * centres).sum(axis=1) > 0.0).all()


def test_a_signed_area_is_that_of_the_triangle_and_turns_with_it():
    uv = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0]])
    assert_allclose(meshes.signed_areas(uv, np.array([[0, 1, 2], [0, 2, 1], [0, 1, 1]])), [3.0, -3.0, 0.0], atol=0)


def test_vertex_normals_of_a_sphere_are_radial():
    vertices, faces = icosphere(4)
    assert_allclose(meshes.vertex_normals(vertices, faces), vertices, rtol=0.0, atol=0.02)  # edges of 0.1 rad


def test_vertex_areas_share_out_the_whole_area():
    vertices, faces = tube()
    areas = meshes.vertex_areas(vertices, faces)
    assert_allclose(areas.sum(), meshes.face_areas(vertices, faces).sum(), rtol=1e-12, atol=0.0)
    vertices, faces = equilateral(6, 6, edge_m=0.1)
    inner = np.setdiff1d(np.arange(len(vertices)), np.concatenate(meshes.boundary_loops(faces)))
    assert_allclose(meshes.vertex_areas(vertices, faces)[inner], np.sqrt(0.75) * 0.01, rtol=1e-12, atol=0.0)


def test_normals_turn_with_the_mesh_and_areas_do_not(rng):
    vertices, faces = icosphere(2)
    rotation = random_rotation(rng)
    moved = vertices @ rotation.T + rng.normal(size=3)
    expected = meshes.vertex_normals(vertices, faces) @ rotation.T
    assert_allclose(meshes.vertex_normals(moved, faces), expected, rtol=0.0, atol=1e-12)
    assert_allclose(meshes.face_areas(moved, faces), meshes.face_areas(vertices, faces), rtol=1e-11, atol=0.0)


@pytest.mark.parametrize(
    "function",
    [meshes.face_areas, meshes.face_normals, meshes.vertex_normals, meshes.vertex_areas, meshes.area_vectors],
)
def test_torch_equals_numpy_and_batches_equal_singles(rng, function):
    vertices, faces = tube()
    batch = vertices + 0.01 * rng.normal(size=(2, 3, *vertices.shape))
    reference = function(batch, faces)
    assert reference.shape[:2] == (2, 3)
    assert_allclose(function(batch[1, 0], faces), reference[1, 0], rtol=1e-12, atol=1e-15)
    assert_allclose(function(torch.tensor(batch), faces).numpy(), reference, rtol=1e-12, atol=1e-15)


def test_vertex_normal_gradient_equals_central_differences(rng):
    vertices, faces = tube(6, 2)
    weights, direction = rng.normal(size=(2, *vertices.shape))
    moving = torch.tensor(vertices, requires_grad=True)
    weighted = (meshes.vertex_normals(moving, faces) * torch.tensor(weights)).sum()
    gradient = torch.autograd.grad(weighted, moving)[0].numpy()
    up, down = ((meshes.vertex_normals(vertices + s * direction, faces) * weights).sum() for s in (1e-7, -1e-7))
    assert_allclose((gradient * direction).sum(), (up - down) / 2e-7, rtol=1e-6, atol=1e-8)


def test_degenerate_faces_have_no_normal_and_a_finite_gradient():
    vertices = torch.zeros((3, 3), dtype=torch.float64, requires_grad=True)
    faces = np.array([[0, 1, 2]])
    assert_allclose(meshes.face_normals(vertices, faces).detach().numpy(), 0.0, rtol=0.0, atol=0.0)
    (gradient,) = torch.autograd.grad(meshes.face_areas(vertices, faces).sum(), vertices)
    assert torch.isfinite(gradient).all()


@pytest.mark.parametrize(
    ("faces", "match"),
    [
        (np.zeros((2, 4), dtype=int), "shape"),
        (np.zeros((2, 3)), "integers"),
        (np.array([[0, 1, 4]]), "indices"),
        (np.array([[0, 1, -1]]), "indices"),
    ],
)
def test_wrong_faces_are_refused(faces, match):
    with pytest.raises(MeshError, match=match):
        meshes.check_faces(faces, 4)


def test_faces_are_numbered_by_the_vertices_they_have():
    used, faces = meshes.in_use(np.array([[7, 2, 9], [9, 2, 4]]))
    assert_array_equal(used, [2, 4, 7, 9])
    assert_array_equal(faces, [[2, 0, 3], [3, 0, 1]])
