"""The rival push-out: the whole body posed, and two passes by parts."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from benchmarks.speed.skinning_push import CLEARANCE_M, Collider, SkinningPush
from drape.body.assets import load_body
from drape.cloth.contact import BodyContact, nearest_vertex_push
from tests.fixtures.garments import shipped
from tests.fixtures.poses import random_motion


def test_collider_is_the_body():
    body, (poses, _), betas = load_body(), random_motion(2), np.linspace(-1, 1, 10)
    expected = body.posed_vertices(poses, None, betas) - body.rest_joints(betas)[0]
    assert_allclose(Collider(body).posed(poses, betas), expected, rtol=0, atol=1e-6)


def test_two_passes_by_parts_are_the_two_passes_of_the_core(rng):
    body, (poses, _), betas = load_body(), random_motion(2, spread_rad=0.35), np.zeros(10)
    collider = Collider(body)
    posed, surface = collider.posed(poses, betas), BodyContact.of_body(body)
    near = posed[:, rng.choice(body.vertex_count, 500)] + rng.normal(0.0, 0.01, size=(2, 500, 3)).astype(np.float32)
    normals, colliders = np.asarray(surface.normals(posed)), surface.vertices
    whole = nearest_vertex_push(near, posed, normals, CLEARANCE_M, colliders=colliders, passes=2)
    pushed = collider.push(near, poses, betas)
    assert_allclose(pushed, whole, rtol=0, atol=1e-6)
    assert (pushed != near).any() and (pushed == near).all(axis=2).any()


def test_skinning_at_rest_is_the_garment():
    garment, body = shipped("shorts"), load_body()
    skinned = SkinningPush(garment, body).skin(np.zeros((1, 24, 3)))[0]
    rest = garment.vertices[: garment.vertex_count] - body.joints_template[0]
    assert_allclose(skinned, rest, rtol=0, atol=1e-6)
