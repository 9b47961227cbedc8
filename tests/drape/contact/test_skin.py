"""Skin samples on the body, posed two ways, and the surface that they give."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial import KDTree

from drape.arrays.subnormals import flushed
from drape.contact import field
from drape.contact.blocks import blocks
from drape.contact.projection import AGREEMENT
from drape.contact.samples import CLUSTER_SIZE, REGION_SIZE, sample_table
from drape.contact.skin import ShapedSkin, Skin, body_skin, shaped_skin, skin_samples, skin_table
from drape.errors import BodyError, InputError
from drape.geometry import closest, meshes
from tests.fixtures.garments import default_body
from tests.fixtures.rounding import HALF_ULP


@pytest.fixture(scope="module")
def skin() -> Skin:
    return body_skin(default_body())


def sphere(count: int, radius: float) -> np.ndarray:
    """``count`` points spread evenly over a sphere about the origin (a golden spiral)."""
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    ring = np.sqrt(1.0 - height**2)
    return radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)


def attend_columns(points: np.ndarray, samples: np.ndarray, normals: np.ndarray) -> field.Surface:
    """The surface at ``points`` (P, 3) of samples (K, 3), none preferred."""
    means = field.attend(
        field.queries(points.T).T[None], sample_table(samples, normals)[None], np.zeros((1, len(samples)))
    )
    return field.surface(points.T, means[0].T)


def test_sums_of_exponentials_are_the_softmax_and_fade_far_away(rng):
    points, samples = 0.05 * rng.normal(size=(20, 3)), 0.05 * rng.normal(size=(30, 3))
    normals = rng.normal(size=samples.shape)
    table, bias = sample_table(samples, normals)[None], -rng.random((1, 30))
    softly = field.attend(field.queries(points.T).T[None], table, bias)
    sums = field.attend_columns(field.query_columns(points.T)[None], table, bias)
    assert_allclose(sums.swapaxes(1, 2), softly, rtol=1e-9, atol=1e-12)
    assert_array_equal(field.attend_columns(field.query_columns(1.0 + points.T)[None], table, bias), 0.0)


@pytest.mark.parametrize("context", [nullcontext, flushed])
def test_means_fade_before_their_weights_are_subnormal(context, rng):
    """Where normals still count, the mean point is that of the softmax, however far the samples are."""
    samples = (np.array([0.2, 0.3, -0.1]) + 0.01 * rng.normal(size=(40, 3))).astype(np.float32)
    way = np.array([[0.6], [0.0], [0.8]])
    points = (samples.mean(axis=0)[:, None] + np.linspace(0.05, 0.15, 2001) * way).astype(np.float32)
    up, bias = np.tile(np.eye(3, dtype=np.float32)[2], (40, 1)), np.zeros((1, 40), dtype=np.float32)
    table = sample_table(samples, up)[None]
    with context():
        means = field.attend_columns(field.query_columns(points)[None], table, bias)[0]
    softly = field.attend(field.queries(points.astype(np.float64)).T[None], table.astype(np.float64), bias)[0].T
    counts = field.surface(points, means).agreement > AGREEMENT[0]
    assert 0.5 < counts.mean() < 0.9
    # A logit sums eight products as large as |x|^2 / h^2, and each rounds; so do weights, and means over the samples.
    rounding = 8.0 * HALF_ULP * float((points**2).sum(axis=0).max()) / field.BANDWIDTH_M**2
    assert_allclose(means[:3, counts], softly[:3, counts], rtol=0, atol=rounding * np.ptp(samples, axis=0).max())


def test_samples_lie_on_the_skin_with_its_normals_and_keep_their_distance(skin: Skin):
    body = default_body()
    found = closest.closest_point(skin.point, body.v_template, body.faces)
    assert_allclose(np.linalg.norm(found.point - skin.point, axis=1), 0.0, rtol=0, atol=1e-9)
    nearest = KDTree(body.v_template).query(skin.point)[1]
    agreement = (skin.normal * meshes.vertex_normals(body.v_template, body.faces)[nearest]).sum(axis=1)
    assert np.median(agreement) > 0.98 and (agreement > 0.5).mean() > 0.98
    # Regions that are not full repeat a sample; all others are at least a spacing apart in place or facing.
    once = np.unique(skin.point.round(9), axis=0)
    assert len(once) > 0.98 * skin.count
    assert 0.010 < np.median(KDTree(once).query(once, k=2)[0][:, 1]) < 0.025


def test_regions_and_clusters_are_compact(skin: Skin):
    for size, limit_m in ((REGION_SIZE, 0.06), (CLUSTER_SIZE, 0.04)):
        groups = skin.point.reshape(-1, size, 3)
        assert np.median(np.linalg.norm(groups - groups.mean(axis=1, keepdims=True), axis=-1).max(axis=1)) < limit_m


def test_samples_are_the_same_every_time(skin: Skin):
    again = skin_samples(default_body())
    assert (again.point == skin.point).all() and abs(again.operator - skin.operator).max() == 0


def test_bones_pose_samples_as_body_vertices_do(skin: Skin, rng):
    body = default_body()
    poses, betas = rng.normal(0.0, 0.5, size=(2, 24, 3)), rng.normal(size=body.shape_count)
    point, normal = skin.posed(body.posed_vertices(poses, None, betas))
    bones = skin.on_bones(body, betas)
    table = skin_table(bones.rows.astype(np.float64), bones.bones, *body.bones(poses, None, betas))
    assert_allclose(table[..., :3].reshape(point.shape), point, rtol=0, atol=1e-6)
    # Rows are stored as float32; where a fold makes the tangents parallel, the normal loses digits.
    away = np.linalg.norm(table[..., 4:7].reshape(normal.shape) - normal, axis=-1)
    assert np.quantile(away, 0.99) < 1e-5
    assert_allclose(table[..., 3], (table[..., :3] ** 2).sum(axis=-1), rtol=1e-12, atol=0)
    assert_allclose(table[..., 7], (table[..., :3] * table[..., 4:7]).sum(axis=-1), rtol=0, atol=1e-12)


def test_a_table_of_bodies_of_many_shapes_is_that_of_the_bones_of_each(rng):
    body = default_body()
    betas = rng.normal(size=(4, body.shape_count))
    betas[[0, 2]] = 0.0
    poses = 0.3 * rng.normal(size=(4, 24, 3))
    bones = [body.bones(poses[n : n + 1], None, betas[n]) for n in range(4)]
    rotations, translations = (np.concatenate(parts) for parts in zip(*bones, strict=True))
    table = shaped_skin(body).table(rotations, translations, betas)
    for n, (rotation, translation) in enumerate(bones):
        own = body_skin(body).on_bones(body, betas[n])
        alone = skin_table(own.rows, own.bones, rotation.astype(np.float32), translation.astype(np.float32))
        assert_allclose(table[n], alone[0], rtol=0, atol=2e-4)
    plain = shaped_skin(body).table(*bones[1], betas[:1])
    assert not np.allclose(table[1], plain[0], atol=1e-3), "the shape matters"


def test_a_character_has_rows_of_its_one_shape():
    body = default_body()
    character = replace(body, digest="character", shapedirs=np.zeros_like(body.shapedirs))
    one, all_shapes = ShapedSkin(character), shaped_skin(body)
    assert_array_equal(one.rows, all_shapes.rows[:1])
    assert_array_equal(one.of(np.zeros((2, 10))), all_shapes.of(np.zeros((2, 10))))


def test_pose_blend_shapes_and_other_bodies_are_refused(skin: Skin):
    body = default_body()
    corrected = replace(body, posedirs=np.zeros((body.vertex_count, 3, 207)))
    with pytest.raises(BodyError, match="pose blend shapes"):
        skin.on_bones(corrected)
    with pytest.raises(InputError, match="vertices"):
        skin.posed(np.zeros((1, 7, 3)))


def test_a_plane_is_exact(rng):
    samples = rng.uniform(-0.05, 0.05, size=(60, 3)) * [1.0, 1.0, 0.0]
    points = rng.uniform(-0.03, 0.03, size=(9, 3))
    found = attend_columns(points, samples, np.tile([0.0, 0.0, 1.0], (60, 1)))
    assert_allclose(found.distance, points[:, 2], rtol=0, atol=1e-12)
    assert_allclose(found.normal, np.tile([[0.0], [0.0], [1.0]], (1, 9)), rtol=0, atol=1e-12)
    assert_allclose(found.agreement, 1.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("radius", [0.04, 0.1])
def test_a_sphere_has_no_error_of_second_order(radius: float):
    spacing = 0.3 * radius
    samples = sphere(round(4.0 * np.pi * radius**2 / spacing**2), radius)
    ways = sphere(200, 1.0)
    for height in (-0.006, 0.0, 0.006):
        found = attend_columns((radius + height) * ways, samples, samples / radius)
        # One term alone is off by h^2 / 2R or more: 2.5 mm on the smaller sphere.
        assert np.abs(found.distance - height).max() < 0.12 * spacing**2 / radius
        assert ((found.normal.T * ways).sum(axis=1) > 0.97).all()


def test_beside_the_samples_and_between_two_faces_it_is_told(rng):
    disc = rng.uniform(-0.02, 0.02, size=(80, 3)) * [1.0, 1.0, 0.0]
    up = np.tile([0.0, 0.0, 1.0], (80, 1))
    beside = attend_columns(np.array([[0.07, 0.0, 0.01]]), disc, up)
    assert 0.04**2 < beside.beside_m2[0] < 0.06**2
    both = np.concatenate([disc, disc + np.array([0.0, 0.0, 0.01])])
    between = attend_columns(np.array([[0.0, 0.0, 0.005]]), both, np.concatenate([up, -up]))
    assert between.agreement[0] < 0.1


def test_the_field_is_smooth_and_the_same_in_torch(rng):
    samples = sphere(300, 0.06)
    points = 0.065 * sphere(20, 1.0)
    step = 1e-6 * rng.normal(size=points.shape)
    ahead, behind = (attend_columns(points + sign * step, samples, samples / 0.06) for sign in (1.0, -1.0))
    x = torch.from_numpy(points).requires_grad_()
    table = torch.from_numpy(sample_table(samples, samples / 0.06))[None]
    means = field.attend(field.queries(x.mT).mT[None], table, torch.zeros(1, 300, dtype=torch.float64))
    found = field.surface(x.mT, means[0].mT)
    numpy_found = attend_columns(points, samples, samples / 0.06)
    assert_allclose(found.distance.detach(), numpy_found.distance, rtol=0, atol=1e-12)
    (slope,) = torch.autograd.grad(found.distance.sum(), x)
    assert_allclose((slope.numpy() * step).sum(axis=1), 0.5 * (ahead.distance - behind.distance), rtol=1e-5, atol=1e-12)


def test_blocks_hold_every_point_once_and_keep_the_sides_of_a_sheet_apart(rng):
    sheet = rng.uniform(0.0, 0.3, size=(90, 3)) * [1.0, 1.0, 0.0]
    points = np.concatenate([sheet, sheet - [0.0, 0.0, 0.01]])
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 90, axis=0)
    found = blocks(points, normals, 8)
    assert found.shape == (23, 8)
    assert (np.unique(found) == np.arange(180)).all()
    assert np.ptp(points[found][:, :, 2], axis=1).max() < 0.02
    assert blocks(points[:0], normals[:0], 8).shape == (0, 8)


def test_ramp_rises_and_falls():
    value = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    assert_allclose(field.ramp(value, 0.0, 1.0), [0.0, 0.0, 0.5, 1.0, 1.0])
    assert_allclose(field.ramp(value, 1.0, 0.0), [1.0, 1.0, 0.5, 0.0, 0.0])


def test_the_largest_places_are_found(rng):
    scores = rng.normal(size=(4, 3, 20))
    found = np.sort(field.largest(scores, 5), axis=-1)
    assert (found == np.sort(np.argsort(-scores, axis=-1)[..., :5], axis=-1)).all()
    assert (np.sort(field.largest(torch.from_numpy(scores), 5).numpy(), axis=-1) == found).all()
