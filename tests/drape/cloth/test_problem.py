"""Flat arrays: colours that share nothing, springs at rest, and planes that must fit."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.cloth.energies import ClothMesh
from drape.cloth.material import Material
from drape.cloth.problem import problem, stencil
from drape.errors import InputError
from drape.exact.surroundings import surroundings
from tests.drape.cloth.cloth_shapes import grid, tube


@pytest.mark.parametrize("shape", [grid, tube])
def test_no_two_vertices_of_a_colour_share_an_element(shape):
    rest, faces = shape()
    cloth = ClothMesh.from_rest(rest, faces)
    made = problem(cloth, Material())
    assert_array_equal(np.sort(made.order), np.arange(len(rest)))
    graph = stencil(cloth)
    for start, end in zip(made.colour_start[:-1], made.colour_start[1:], strict=True):
        one = made.order[start:end]
        shared = graph[one][:, one].toarray()
        assert_array_equal(shared, np.eye(len(one)))
    assert made.colour_start[-1] == len(rest)


def test_the_rows_of_a_vertex_are_its_triangles_and_hinges():
    rest, faces = tube()
    made = problem(ClothMesh.from_rest(rest, faces), Material(), dtype=np.float64)
    t, h = made.triangles, made.hinges
    for v in range(len(rest)):
        others = t.other[t.start[v] : t.start[v + 1]]
        wanted = {tuple(np.roll(face, -place)[1:]) for face in faces for place in range(3) if face[place] == v}
        assert {tuple(row) for row in others} == wanted
        members = h.member[h.start[v] : h.start[v + 1]]
        assert (h.corner[members // 4, members % 4] == v).all()
        assert len(members) == (h.corner == v).sum()


def test_planes_of_another_count_are_refused():
    rest, faces = grid()
    made = problem(ClothMesh.from_rest(rest, faces), Material())
    with pytest.raises(InputError, match="contact planes: expected points and normals"):
        surroundings(made, rest[1:], rest[1:])
