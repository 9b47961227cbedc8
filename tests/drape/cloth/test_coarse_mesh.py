"""Coarse cloth: lengths, grain and area stay, lines stay lines, and vectors are carried smoothly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.cloth.coarse_mesh import CREASE_RAD, EDGE_M, coarse_mesh
from drape.cloth.energies import ClothMesh
from drape.cloth.rest_state import RestState, flat_rest
from drape.geometry import meshes
from drape.live.coarse_weights import NEAREST, coarse_weights
from tests.drape.cloth.cloth_shapes import grid, round_tube, tube
from tests.fixtures.garments import shipped


def of_grid(columns: int = 30, rows: int = 24, cell_m: float = 0.01):
    vertices, faces = grid(columns, rows, cell_m=cell_m)
    return vertices, faces, flat_rest(vertices, faces)


def test_a_flat_sheet_keeps_its_outline_area_and_grain():
    vertices, faces, rest = of_grid()
    made = coarse_mesh(rest, vertices, faces, edge_m=0.03)
    assert len(made.vertex) < len(vertices) / 3.5
    few = vertices[made.vertex]
    assert_allclose(np.ptp(few, axis=0), np.ptp(vertices, axis=0), atol=1e-12)
    assert_allclose(made.rest.face_area.sum(), rest.face_area.sum(), rtol=1e-12)
    want = flat_rest(few, made.faces)
    assert_allclose(made.rest.edges, want.edges, atol=1e-9)
    assert len(meshes.boundary_loops(made.faces)) == 1
    assert len(coarse_mesh(rest, vertices, faces, edge_m=0.03, least=240).vertex) == 240
    assert_allclose(
        meshes.face_normals(few, made.faces),
        np.broadcast_to(meshes.face_normals(vertices, faces)[:1], (len(made.faces), 3)),
    )


def test_triangles_are_not_thin_and_edges_about_as_long_as_asked():
    vertices, faces, rest = of_grid(40, 40)
    made = coarse_mesh(rest, vertices, faces, edge_m=0.025)
    cloth = ClothMesh.of(made.rest, made.faces, len(made.vertex))
    assert 0.8 * 0.025 < cloth.mean_edge_m < 1.35 * 0.025
    square = sum(
        (edge**2).sum(axis=1)
        for edge in (made.rest.edges[:, 0], made.rest.edges[:, 1], np.diff(made.rest.edges, axis=1)[:, 0])
    )
    assert (4.0 * np.sqrt(3.0) * made.rest.face_area / square).min() > 0.3, "a triangle of equal sides has 1"


def test_a_vertex_with_too_many_triangles_stays():
    spokes = 30
    around = 2.0 * np.pi * np.arange(spokes) / spokes
    circle = np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1)
    vertices = np.concatenate([np.zeros((1, 3)), 0.02 * circle, 0.04 * circle])
    i, j = 1 + np.arange(spokes), 1 + (np.arange(spokes) + 1) % spokes
    faces = np.concatenate(
        [
            np.stack([0 * i, i, j], axis=1),
            np.stack([i, i + spokes, j + spokes], axis=1),
            np.stack([i, j + spokes, j], axis=1),
        ]
    )
    made = coarse_mesh(flat_rest(vertices, faces), vertices, faces, edge_m=0.03)
    assert made.vertex[0] == 0 and len(made.vertex) < len(vertices)


def test_a_seam_between_two_charts_stays_a_line():
    """The right half has its warp turned: no triangle lies on both sides, and each keeps its own grain."""
    vertices, faces, rest = of_grid(20, 20)
    right = vertices[faces].mean(axis=1)[:, 0] > 0.5 * vertices[:, 0].max()
    edges = rest.edges.copy()
    edges[right] = edges[right] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    made = coarse_mesh(RestState(edges, rest.hinge_angle, rest.stiffening), vertices, faces, edge_m=0.03)
    side = np.sign(np.round(vertices[made.vertex][:, 0] - 0.5 * vertices[:, 0].max(), 9))[made.faces]
    assert ((side >= 0).all(axis=1) | (side <= 0).all(axis=1)).all()
    want = flat_rest(vertices[made.vertex], made.faces).edges
    turned = (side > 0).any(axis=1)
    want[turned] = want[turned] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert_allclose(made.rest.edges, want, atol=1e-9)


def test_cloth_without_panels_has_no_seams_and_keeps_its_lengths():
    """Round a ball vertical warp turns from triangle to triangle, which is no seam: lengths are those of the ball."""
    heights = np.linspace(-0.1, 0.1, 31)
    vertices, faces = round_tube(0.15 * np.sqrt(1.0 - (heights / 0.13) ** 2), heights, 80)
    made = coarse_mesh(flat_rest(vertices, faces), vertices, faces)
    target = made.rest.face_area.sum() / (0.5 * np.sqrt(3.0) * EDGE_M**2)
    assert len(made.vertex) < 1.2 * min(target, len(vertices) / 3.0)
    assert_allclose(made.rest.face_area.sum(), meshes.face_areas(vertices, faces).sum(), rtol=0.01)
    few = vertices[made.vertex[made.faces]]
    across = np.linalg.norm(few[:, 1:] - few[:, :1], axis=2)
    assert_allclose(np.linalg.norm(made.rest.edges, axis=2), across, rtol=0.03)


def test_a_crease_keeps_its_angle_and_cloth_beside_it_is_flat():
    vertices, faces, rest = of_grid(20, 20)
    middle = np.isclose(vertices[:, 0], 0.1)
    hinges = meshes.hinges(faces)
    on = middle[hinges[:, :2]].all(axis=1)
    angle = np.where(on, 2.0 * CREASE_RAD, 0.0)
    made = coarse_mesh(RestState(rest.edges, angle, np.where(on, 2.0, 1.0)), vertices, faces, edge_m=0.03)
    ends = middle[made.vertex[meshes.hinges(made.faces)[:, :2]]].all(axis=1)
    assert ends.sum() > 3
    assert_allclose(made.rest.hinge_angle, np.where(ends, 2.0 * CREASE_RAD, 0.0))
    assert (made.rest.stiffening[ends] == 2.0).all()


@pytest.mark.parametrize("name", ["tshirt", "skirt"])
def test_shipped_garments_keep_area_and_openings(name: str):
    garment = shipped(name)
    vertices, faces = garment.vertices[: garment.vertex_count].astype(np.float64), garment.faces.astype(np.int64)
    rest = garment.delivered_rest()
    made = coarse_mesh(rest, vertices, faces)
    assert len(made.vertex) < len(vertices) / 3.0
    assert_allclose(made.rest.face_area.sum(), rest.face_area.sum(), rtol=5e-3)
    assert len(meshes.boundary_loops(made.faces)) == len(meshes.boundary_loops(faces))


def test_linear_vectors_stay_linear_and_kept_vertices_keep_theirs():
    vertices, faces, rest = of_grid()
    made = coarse_mesh(rest, vertices, faces, edge_m=0.03)
    index, weight = coarse_weights(vertices, faces, made.vertex, 0.03)
    assert index.shape == weight.shape == (len(vertices), NEAREST)
    assert_allclose(weight.sum(axis=1), 1.0, atol=1e-5)
    few = vertices[made.vertex]
    linear = np.einsum("vk,vkc->vc", weight, (few @ np.array([[1.0, 0.2], [0.3, -2.0], [0.5, 0.0]]))[index])
    assert_allclose(linear, vertices @ np.array([[1.0, 0.2], [0.3, -2.0], [0.5, 0.0]]), atol=1e-5)
    wave = np.sin(40.0 * few[:, 0])
    own = (weight * wave[index]).sum(axis=1)[made.vertex]
    assert_allclose(own, wave, atol=2e-3)


def test_a_piece_without_coarse_neighbours_takes_the_nearest_ones():
    first, faces = tube(8, 4, radius_m=0.05, height_m=0.1)
    vertices = np.concatenate([first, first + np.array([0.3, 0.0, 0.0])])
    both = np.concatenate([faces, faces + len(first)])
    kept = np.arange(len(first))
    index, weight = coarse_weights(vertices, both, kept, 0.02)
    assert_allclose(weight[len(first) :, 0], 1.0, atol=1e-6)
    assert (np.abs(weight[len(first) :, 1:]) < 1e-6).all()
    far = np.linalg.norm(vertices[len(first) :, None] - first[None], axis=2)
    assert_allclose(far[np.arange(len(first)), index[len(first) :, 0]], far.min(axis=1))
