"""The features of patches: sizes, independence of the patches, hems and positions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.skeleton import JOINT_COUNT
from drape.garment.fitting import rest_garment
from drape.garment.patch_features import BOUNDARY_REACH_M, FREQUENCIES, patch_features, positional_encoding
from drape.geometry import jets
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.garment.rest_garments import PATCH_COUNT, barrel, barrel_garment, side_by_side
from tests.drape.geometry.geometry_shapes import icosphere
from tests.fixtures.garments import default_body

ENCODED = 3 + 6 * len(FREQUENCIES)
SIZES = {
    "position": ENCODED,
    "rotation": 6,
    "weights": JOINT_COUNT,
    "height": jets.HEIGHT_COUNT,
    "body offset": 3,
    "body distance": 1,
    "hem distance": 1,
    "hem nearness": 1,
    "hem direction": 3,
    "scale": 1,
    "joints": 3 * JOINT_COUNT,
}


def part(rows, name):
    """The columns of one part."""
    names = list(SIZES)
    start = sum(SIZES[n] for n in names[: names.index(name)])
    return rows[:, start : start + SIZES[name]]


@pytest.fixture
def given():
    """The arguments of ``patch_features`` for the barrel."""
    rest, garment = barrel(), barrel_garment()
    centre = garment.patch_centre.astype(float)
    seeds = np.array([np.linalg.norm(rest.vertices - c, axis=1).argmin() for c in centre])
    return {
        "centre": centre,
        "rotation": garment.patch_rotation.astype(float),
        "scale": garment.patch_scale.astype(float),
        "jet": garment.patch_jet.astype(float),
        "weights": garment.patch_weights.astype(float),
        "seeds": seeds,
        "vertices": rest.vertices,
        "faces": rest.faces,
        "graph": rest.graph,
        "body": rest.body,
    }


PER_PATCH = ("centre", "rotation", "scale", "jet", "weights", "seeds")


def test_features_have_the_sizes_of_their_parts_and_are_of_order_one(given):
    rows = patch_features(**given)
    assert rows.shape == (PATCH_COUNT, sum(SIZES.values()))
    assert rows.dtype == np.float32
    assert np.isfinite(rows).all()
    assert np.abs(rows).max() < 10.0
    assert_array_equal(part(rows, "weights"), given["weights"].astype(np.float32))


def test_each_patch_is_described_by_itself(given):
    rows = patch_features(**given)
    order = np.random.default_rng(0).permutation(PATCH_COUNT)
    shuffled = patch_features(**{key: value[order] if key in PER_PATCH else value for key, value in given.items()})
    assert_array_equal(shuffled, rows[order])
    some = patch_features(**{key: value[:3] if key in PER_PATCH else value for key, value in given.items()})
    assert_allclose(some, rows[:3], rtol=1e-6, atol=1e-6)


def test_features_are_smooth_in_the_place_of_the_patch(given):
    rows = patch_features(**given)
    moved = patch_features(**{**given, "centre": given["centre"] + 1e-5})
    # All but the nearest body vertices and hem vertex, which may change.
    for name in ("position", "joints"):
        assert np.abs(part(moved, name) - part(rows, name)).max() < 1e-3


def test_features_stored_in_a_garment_are_these(given):
    assert_allclose(patch_features(**given), barrel_garment().patch_features, rtol=1e-3, atol=1e-3)


def test_joints_are_seen_from_the_patch_and_saturate(given):
    rows = part(patch_features(**given), "joints").reshape(PATCH_COUNT, JOINT_COUNT, 3)
    offset = given["body"].joints_template[None] - given["centre"][:, None]
    distance = np.linalg.norm(offset, axis=-1)
    assert_allclose(np.linalg.norm(rows, axis=-1), np.tanh(distance / 0.3), rtol=1e-5, atol=0.0)
    world = np.einsum("kab,kjb->kja", given["rotation"], rows)
    assert_allclose((world * offset).sum(-1), np.tanh(distance / 0.3) * distance, rtol=1e-5, atol=0.0)


def test_hem_distance_is_along_the_surface_and_points_there(given):
    rows = patch_features(**given)
    height = given["vertices"][given["seeds"], 1]
    want = np.minimum(height - given["vertices"][:, 1].min(), given["vertices"][:, 1].max() - height)
    assert_allclose(part(rows, "hem distance")[:, 0], 10.0 * want, rtol=0.02, atol=1e-3)
    nearness = np.exp(-((want / 0.08) ** 2))
    assert_allclose(part(rows, "hem nearness")[:, 0], nearness, rtol=0.0, atol=0.05)
    # At the hem the direction leads away from the middle.
    near = nearness > 0.1
    assert near.any()
    world = np.einsum("kab,kb->ka", given["rotation"], part(rows, "hem direction"))
    middle = given["vertices"][:, 1].mean()
    assert (world[near, 1] * (height[near] - middle) > 0.0).all()


def closed_features(vertices, faces):
    """Features of four patches on a mesh before the body, seeded where it reaches farthest."""
    rest = rest_garment(vertices + np.array([0.0, 0.2, 0.5]), faces, default_body())
    seeds = np.array([rest.vertices[:, axis].argmax() for axis in range(3)] + [int(rest.vertices[:, 0].argmin())])
    jet = np.zeros((4, jets.JET_COUNT))
    return patch_features(
        centre=rest.vertices[seeds], rotation=np.tile(np.eye(3), (4, 1, 1)), scale=np.full(4, 0.1), jet=jet,
        weights=rest.binding.weights[seeds], seeds=seeds, vertices=rest.vertices, faces=faces, graph=rest.graph,
        body=rest.body,
    )  # fmt: skip


def test_mesh_without_a_hem_has_one_far_away():
    rows = closed_features(*icosphere(3, radius_m=0.1))
    assert_allclose(part(rows, "hem distance"), 10.0 * BOUNDARY_REACH_M, rtol=1e-6, atol=0.0)
    assert_array_equal(part(rows, "hem direction"), np.zeros((4, 3)))


def test_closed_piece_beside_an_open_one_has_no_hem():
    rows = closed_features(*side_by_side(grid(4, 4), icosphere(2, radius_m=0.1)))
    # The last seed lies on the open grid, the first on the sphere.
    assert_allclose(part(rows, "hem distance")[[0, 3], 0], [10.0 * BOUNDARY_REACH_M, 0.0], rtol=1e-6, atol=1e-6)
    assert np.isfinite(rows).all()


def test_frames_of_fitted_patches_carry_no_arbitrary_sign():
    rest, garment = barrel(), barrel_garment()
    along = rest.body.bone_directions
    assert ((garment.patch_rotation[:, :, 0] * (garment.patch_weights @ along)).sum(axis=1) > 0.0).all()


def test_positional_encoding_holds_points_sines_and_cosines(rng):
    points = rng.normal(size=(5, 3))
    rows = positional_encoding(points)
    assert rows.shape == (5, ENCODED)
    assert_array_equal(rows[:, :3], points)
    waves = rows[:, 3:].reshape(5, len(FREQUENCIES), 2, 3)
    assert_allclose((waves**2).sum(axis=2), 1.0, rtol=0.0, atol=1e-12)
    shifted = positional_encoding(points + 2.0)[:, 3:].reshape(waves.shape)  # two metres hold whole waves
    assert_allclose(shifted, waves, rtol=0.0, atol=1e-12)
