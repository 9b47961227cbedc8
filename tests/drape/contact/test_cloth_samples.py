"""Samples on cloth: on its surface, the same as sparse and as small products, joined, and hidden under other cloth."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.contact.cloth_samples import (
    BEHIND_M,
    COVER_M,
    MEMBERS,
    ClothSamples,
    cloth_samples,
    hidden_samples,
    join_samples,
)
from drape.contact.samples import CLUSTER_SIZE, POSED_REGIONS, REGION_SIZE
from drape.errors import InputError, MeshError
from drape.geometry import closest
from drape.geometry.rotations import rotvec_to_matrix
from tests.drape.cloth import cloth_shapes
from tests.drape.geometry.geometry_shapes import box

RADIUS, HEIGHT = 0.15, 0.4


def tube(radius: float, columns: int = 48, rows: int = 22, height: float = HEIGHT) -> tuple[np.ndarray, np.ndarray]:
    """An open cylinder about the y axis and its middle."""
    vertices, faces = cloth_shapes.tube(columns, rows - 1, radius_m=radius, height_m=height)
    return vertices - [0.0, 0.5 * height, 0.0], faces


@cache
def samples() -> ClothSamples:
    return cloth_samples(*tube(RADIUS))


def test_samples_lie_on_the_cloth_and_look_outwards():
    vertices, faces = tube(RADIUS)
    made = samples()
    assert made.count % (POSED_REGIONS * REGION_SIZE) == 0
    assert_allclose(closest.closest_point(made.point, vertices, faces).distance, 0.0, rtol=0, atol=1e-12)
    across = made.point * [1.0, 0.0, 1.0]
    outward = across / np.linalg.norm(across, axis=1, keepdims=True)
    assert (made.normal * outward).sum(axis=1).min() > 0.98


def test_small_products_and_the_sparse_operator_are_the_same(rng):
    vertices, _ = tube(RADIUS)
    made, moved = samples(), rng.normal(size=tube(RADIUS)[0].shape)
    posed = np.einsum("cnk,cnx->ckx", made.rows, moved[made.member])
    parts = [posed[:, k * CLUSTER_SIZE : (k + 1) * CLUSTER_SIZE].reshape(-1, 3) for k in range(3)]
    assert_allclose(np.concatenate(parts), made.operator @ moved, rtol=0, atol=1e-5 * np.abs(made.rows).max())
    assert made.member.shape[1] == MEMBERS and made.member.max() < len(vertices)


def test_samples_follow_rigid_motion_exactly(rng):
    vertices, _ = tube(RADIUS)
    turn, shift = rotvec_to_matrix(rng.normal(size=3)), rng.normal(size=3)
    point, normal = samples().posed((vertices @ turn.T + shift)[None])
    assert_allclose(point[0], samples().point @ turn.T + shift, rtol=0, atol=1e-9)
    assert_allclose(normal[0], samples().normal @ turn.T, rtol=0, atol=1e-9)


def test_a_fine_mesh_takes_no_more_members_and_gives_the_same_surface():
    vertices, faces = tube(RADIUS, columns=190, rows=80)
    fine = cloth_samples(vertices, faces)
    assert fine.member.shape[1] == MEMBERS
    assert 0.8 < fine.count / samples().count < 1.25
    radius = np.linalg.norm(fine.point[:, [0, 2]], axis=1)
    assert_allclose(radius, RADIUS, rtol=0, atol=1e-4)
    assert (fine.normal[:, [0, 2]] * fine.point[:, [0, 2]]).sum(axis=1).min() / RADIUS > 0.95


def test_joined_samples_are_those_of_their_meshes(rng):
    inner, outer = samples(), cloth_samples(*tube(0.2, rows=10))
    count = len(tube(RADIUS)[0])
    moved = rng.normal(size=(2, count + len(tube(0.2, rows=10)[0]), 3))
    both = join_samples([inner, outer])
    first = inner.posed(moved[:, :count])
    second = outer.posed(moved[:, count:])
    for got, a, b in zip(both.posed(moved), first, second, strict=True):
        assert_allclose(got, np.concatenate([a, b], axis=1), rtol=0, atol=1e-12)
    chosen = both.of_regions(np.array([3, 0]))
    index = np.concatenate([np.arange(36, 48), np.arange(12)])
    assert_allclose(chosen.posed(moved)[0], both.posed(moved)[0][:, index], rtol=0, atol=1e-12)
    assert_array_equal(chosen.spacing_m, both.spacing_m[index])
    with pytest.raises(InputError, match="at least one"):
        join_samples([])


def test_cloth_hides_what_lies_under_it_and_nothing_beside_it():
    over, faces = tube(RADIUS + 0.02, height=0.2)
    hidden = hidden_samples(samples(), over, faces)
    height = np.abs(samples().point[:, 1])
    assert hidden[height < 0.095].all() and not hidden[height > 0.105].any()
    assert not hidden_samples(samples(), *tube(RADIUS + COVER_M + 0.01)).any()
    assert not hidden_samples(samples(), *tube(RADIUS - BEHIND_M - 0.01)).any()
    assert hidden_samples(samples(), *tube(RADIUS - 0.5 * BEHIND_M))[height < 0.18].all()


def test_the_border_of_a_mesh_is_where_one_triangle_ends():
    vertices, faces = tube(RADIUS)
    inside, above = np.array([[0.0, 0.01, RADIUS + 0.05]]), np.array([[0.0, 0.5 * HEIGHT + 0.01, RADIUS]])
    corner = vertices[-1:] + np.array([0.0, 0.02, 0.0])
    found = closest.closest_point(np.concatenate([inside, above, corner, vertices[:1]]), vertices, faces)
    assert_array_equal(closest.on_border(found, faces), [False, True, True, True])
    corners, closed = box()
    assert not closest.on_border(closest.closest_point(np.zeros((1, 3)), corners, closed), closed).any()


def test_broken_meshes_are_refused():
    vertices, faces = tube(RADIUS)
    with pytest.raises(MeshError, match="faces"):
        cloth_samples(vertices[:5], faces)
