"""The layout of garments for the packed graph: every chart once, exact sums, index tensors that stay in bounds."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import ArtifactError
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.packed_inputs import CHARTS_PER_TILE, COLUMNS, VERTICES_PER_BLOCK
from drape.graph.packing import PackedGarment, Place, compose_garments, pack_body, pack_garment, tile_charts
from tests.fixtures.garments import tube
from tests.fixtures.poses import random_motion


@pytest.fixture(scope="module")
def feed() -> dict[str, np.ndarray]:
    return garment_feed(tube())


@pytest.fixture(scope="module")
def packed(feed) -> PackedGarment:
    return pack_garment(feed, np.zeros((len(feed["patch_scale"]), 5)))


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(1, 400), st.integers(1, 9))
def test_every_chart_has_a_column_of_its_patch(seed: int, vertices: int, patches: int):
    chart_patch = np.random.default_rng(seed).integers(0, patches, (vertices, 4))
    tiling = tile_charts(chart_patch, patches)
    columns = tiling.column.reshape(-1)
    assert len(np.unique(columns)) == columns.size
    assert_array_equal(tiling.patch[tiling.column // CHARTS_PER_TILE], chart_patch)
    counts = np.bincount(chart_patch.reshape(-1), minlength=patches)
    assert len(tiling.patch) == np.ceil(counts / CHARTS_PER_TILE).sum()  # no tile more than needed
    values = np.random.default_rng(seed).normal(size=(vertices, 4, 2)).astype(np.float32)
    laid = tiling.lay(values).transpose(0, 2, 1).reshape(-1, 2)
    assert_array_equal(laid[columns].reshape(values.shape), values)
    unused = np.setdiff1d(np.arange(len(laid)), columns)
    assert not laid[unused].any()


def test_products_of_tiles_sum_to_the_blend(feed, packed):
    """The vertex stage in float64: sum of w (c + R (y + s jet)) equals the sum of gathered columns."""
    generator = np.random.default_rng(3)
    coefficients = generator.normal(size=(packed.patch_count, 3, COLUMNS))
    tiles = packed.stored["tile_positions"].astype(np.float64)
    product = coefficients[packed.tile_patch] @ tiles  # (Q, 3, 64)
    rows = product.transpose(0, 2, 1).reshape(-1, 3)
    vertices = rows[packed.vertex_charts].sum(axis=0).reshape(-1, 3)
    patch = feed["chart_patch"]
    place = feed["chart_local"] / feed["patch_scale"][patch][..., None]
    entries = np.concatenate([place, feed["chart_basis"]], axis=-1).astype(np.float64)
    want = np.einsum("vk,vkac,vkc->va", feed["chart_weight"].astype(np.float64), coefficients[patch], entries)
    assert_allclose(vertices[: packed.vertex_count], want, rtol=0, atol=1e-6)
    assert_array_equal(
        vertices[packed.vertex_count :], np.broadcast_to(vertices[0], vertices[packed.vertex_count :].shape)
    )
    assert len(vertices) % VERTICES_PER_BLOCK == 0


def test_body_rows_are_what_the_body_poses(packed):
    body = load_body()
    poses, betas = random_motion(3, seed=2)[0], np.linspace(-1.0, 1.0, body.shape_count)
    made = pack_body(body, betas)
    rows = made.rows(poses)
    feed = body_feed(body, poses, np.zeros((3, 3)), betas)
    assert_array_equal(rows["betas"], feed.arrays["betas"])
    assert_allclose(np.broadcast_to(made.root, (3, 3)), feed.root, rtol=0, atol=0)
    assert_array_equal(rows["joint_quaternion"][:, 24], np.broadcast_to([1.0, 0.0, 0.0, 0.0], (3, 4)))
    assert_allclose(np.linalg.norm(rows["joint_quaternion"], axis=-1), 1.0, rtol=0, atol=1e-6)
    assert_allclose(rows["joint_rest"][0], body.rest_joints(betas), rtol=0, atol=1e-6)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 6)), min_size=1, max_size=9))
def test_compositions_point_where_they_should(items):
    made = two_garments()
    places = [Place(0, 0), Place(made[0].patch_count, made[0].tile_count)]
    composition = compose_garments([(made[g], places[g], row) for g, row in items])
    arrays = composition.arrays
    for item, (g, row) in enumerate(items):
        here = composition.patches[item]
        assert_array_equal(arrays["patch_stored"][here], places[g].patch + np.arange(made[g].patch_count))
        assert set(arrays["patch_body"][here]) == {row}
        assert_array_equal(arrays["patch_bone"][here], 24 * row + made[g].heaviest)
        # A vertex's columns lie in tiles of the item's own patches.
        charts = arrays["vertex_charts"].reshape(4, -1)[:, composition.vertices[item]]
        tiles = charts // CHARTS_PER_TILE
        assert ((arrays["tile_patch"][tiles] >= here.start) & (arrays["tile_patch"][tiles] < here.stop)).all()
        stored = arrays["tile_stored"][tiles]
        assert ((stored >= places[g].tile) & (stored < places[g].tile + made[g].tile_count)).all()
        assert charts.shape[1] == made[g].vertex_count
    assert {array.dtype for array in arrays.values()} == {np.dtype(np.int32)}
    assert composition.bytes == sum(array.nbytes for array in arrays.values())


@cache
def two_garments() -> list[PackedGarment]:
    return [_pack(tube()), _pack(tube(), vertices=70)]


def _pack(garment, *, vertices: int | None = None) -> PackedGarment:
    feed = garment_feed(garment)
    for name, value in feed.items():
        feed[name] = value[:vertices] if name.startswith(("chart", "skin")) else value
    return pack_garment(feed, np.zeros((len(feed["patch_scale"]), 2)))


@pytest.mark.parametrize("bad", [-1, 12])
def test_charts_outside_the_patches_are_refused(feed, bad: int):
    charts = feed["chart_patch"].copy()
    charts[5, 2] = bad
    with pytest.raises(ArtifactError, match=r"indices in \[0, 12\)"):
        pack_garment(feed | {"chart_patch": charts}, np.zeros((12, 5)))


@pytest.mark.parametrize("charts", [np.zeros((0, 4), int), np.zeros((5, 3), int), np.zeros(4, int)])
def test_charts_of_another_shape_are_refused(charts: np.ndarray):
    with pytest.raises(ArtifactError, match=r"chart_patch: expected shape \(vertices, 4\)"):
        tile_charts(charts, 3)


def test_constants_of_another_garment_are_refused(feed):
    with pytest.raises(ArtifactError, match="patch_first: expected 12 rows"):
        pack_garment(feed, np.zeros((11, 5)))


@pytest.mark.parametrize("bone", [-1, 24])
def test_bones_that_the_body_lacks_are_refused(feed, bone: int):
    heaviest = feed["patch_heaviest"].copy()
    heaviest[3] = bone
    with pytest.raises(ArtifactError, match=r"patch_heaviest: expected bones in \[0, 24\)"):
        pack_garment(feed | {"patch_heaviest": heaviest}, np.zeros((12, 5)))


def test_an_extra_garment_of_5000_vertices_takes_less_than_three_megabytes():
    """At 100 patches and the shipped width of the first layer, charts spread as in a fitted garment."""
    chart_patch = np.sort(np.random.default_rng(0).integers(0, 100, (5000, 4)), axis=0)
    feed = garment_feed(tube())
    grown = {n: np.resize(v, (100 if n.startswith("patch") else 5000, *v.shape[1:])) for n, v in feed.items()}
    assert pack_garment(grown | {"chart_patch": chart_patch}, np.zeros((100, 640))).bytes < 3e6
