"""The subdivided mesh as a delivered one: where its vertices lie, and what it is on_corners and made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.errors import ArtifactError
from drape.garment.cache import Garment
from drape.garment.fine import corner_weights, fine_garment, has_finer
from drape.garment.rest_mesh import with_unused
from drape.geometry import meshes
from tests.fixtures.garments import coarse_tube, tube

COARSE = coarse_tube()


def on_corners(garment: Garment) -> np.ndarray:
    """Texture coordinates (F, 3, 2) of the corners of every triangle."""
    return np.asarray(garment.uv, dtype=np.float64)[garment.uv_faces]


def test_what_is_fine_enough_is_its_own_fine_mesh():
    assert not has_finer(tube()) and fine_garment(tube()) is tube()
    assert_array_equal(corner_weights(tube()).toarray(), np.eye(tube().vertex_count))


def test_the_fine_mesh_begins_with_the_delivered_vertices_and_keeps_paint_and_materials():
    fine = fine_garment(COARSE)
    assert has_finer(COARSE) and not has_finer(fine) and fine_garment(fine) is fine
    assert fine.digest != COARSE.digest and fine.vertex_count == len(COARSE.vertices)
    assert fine.vertices is COARSE.vertices
    assert_array_equal(fine.faces, COARSE.fine_faces)
    assert fine.uv.dtype == COARSE.uv.dtype and len(fine.uv_faces) == len(fine.faces) == 4 * len(COARSE.faces)
    whole, parts = on_corners(COARSE), on_corners(fine).reshape(-1, 4, 3, 2)
    assert_allclose(parts[:, 3].mean(axis=1), whole.mean(axis=1), rtol=0, atol=1e-6)  # the middle part
    for corner in range(3):
        assert_allclose(parts[:, corner, 0], whole[:, corner], rtol=0, atol=1e-6)
        assert_allclose(parts[:, corner, 1], 0.5 * (whole[:, corner] + whole[:, (corner + 1) % 3]), rtol=0, atol=1e-6)
    assert_array_equal(fine.face_material.reshape(-1, 4), np.repeat(COARSE.face_material[:, None], 4, axis=1))


def test_without_paint_there_is_none():
    plain = replace(COARSE, uv=np.zeros((0, 2), np.float32), uv_faces=np.zeros((0, 3), np.int32))
    assert not fine_garment(plain).uv.size and not fine_garment(plain).uv_faces.size


def test_weights_place_fine_vertices_in_delivered_triangles():
    weights = corner_weights(COARSE)
    points = COARSE.vertices.astype(np.float64)
    assert_allclose(weights @ points[: COARSE.vertex_count], points, rtol=0, atol=1e-7)  # the tube's are midpoints
    assert (np.diff(weights.indptr) <= 3).all()
    vertices, faces, _ = meshes.subdivide(points, COARSE.fine_faces)  # a second round
    twice = replace(COARSE, vertices=vertices, fine_faces=faces)
    found = corner_weights(twice)
    assert (np.diff(found.indptr) <= 3).all()
    assert_allclose(found @ points[: COARSE.vertex_count], vertices, rtol=0, atol=1e-7)
    assert len(fine_garment(twice).uv_faces) == 16 * len(COARSE.faces)


def test_unused_vertices_stay_where_they_are():
    count = COARSE.vertex_count
    kept = np.concatenate([np.arange(5), [3], np.arange(5, count)])  # a sixth vertex that no face uses
    faces = np.where(COARSE.faces >= 5, COARSE.faces + 1, COARSE.faces)
    unused = with_unused(COARSE, faces, kept)
    fine = fine_garment(unused)
    assert fine.vertex_count == len(COARSE.vertices) + 1 and not np.isin(5, fine.faces)
    found = corner_weights(unused) @ unused.vertices[: unused.vertex_count].astype(np.float64)
    assert_allclose(found, unused.vertices, rtol=0, atol=1e-7)


def test_triangles_that_are_no_subdivision_are_refused():
    turned = COARSE.fine_faces.copy()
    turned[0] = turned[0][[1, 2, 0]]
    for fine_faces in (turned, COARSE.fine_faces[:-1]):
        for asked in (fine_garment, corner_weights):
            with pytest.raises(ArtifactError, match="tube fine_faces: expected a subdivision of faces, got"):
                asked(replace(COARSE, fine_faces=fine_faces))
