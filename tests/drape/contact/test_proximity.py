"""What patches feel of the body: closed forms for a plane, the body itself at rest, arms that come down."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.skeleton import JOINT_NAMES
from drape.contact.proximity import (
    GAP_M,
    OTHER_STEPS,
    UNIT_M,
    PatchSkin,
    Planes,
    body_proximity,
    from_halves,
    held_share,
    in_halves,
    patch_skin,
    planes,
    region_bias_of,
)
from drape.contact.push_tables import outward_directions
from drape.contact.samples import region_centres
from drape.contact.skin import body_skin
from drape.geometry import closest
from drape.geometry.skinning import blend_frames
from drape.graph.feeds import body_feed, garment_feed
from drape.graph.push_feed import KEPT_SHAPES, SkinShapes
from tests.fixtures.garments import default_body
from tests.fixtures.garments import shipped as garment
from tests.fixtures.rounding import moved_by_rounding

BODY = default_body()
ARMS_DOWN = 1.15  # [rad] where no patch has two regions within rounding of each other to choose from
ROW_SIZE = 8
FLOAT64_SHARE = 2.0**-29  # of the rounding of float32


def pose(arms: float) -> np.ndarray:
    """The T-pose with both arms turned down by ``arms`` [rad]."""
    made = np.zeros((1, 24, 3))
    made[0, [JOINT_NAMES.index(f"{side}_shoulder") for side in ("left", "right")], 2] = -arms, arms
    return made


@cache
def lists(kind: str) -> PatchSkin:
    centre, skin = garment(kind).patch_centre.astype(np.float64), body_skin(BODY)
    return patch_skin(centre, outward_directions(centre, skin), skin)


def posed(kind: str, arms: float) -> tuple[np.ndarray, np.ndarray, PatchSkin]:
    """Points (1, K, 7, 3) of the rigidly moved patches of a garment, the body's skin, and the patches' lists."""
    feed = body_feed(BODY, pose(arms), np.zeros((1, 3)), skin=True).arrays
    constants = garment_feed(garment(kind), body=BODY)
    rotation, centre = blend_frames(
        constants["patch_centre"][None], constants["patch_weights"], constants["patch_heaviest"],
        feed["bone_rotation"], feed["bone_translation"], feed["bone_quaternion"],
    )  # fmt: skip
    turn = rotation @ constants["patch_rotation"]
    points = constants["patch_place"] @ turn.swapaxes(-1, -2) + centre[:, :, None]
    return points.astype(np.float32), feed["body_skin"], lists(kind)


def test_a_plane_is_felt_as_its_closed_form():
    distance = np.array([-0.02, 0.0, 0.003, 0.02])
    points = np.stack([np.zeros(4), distance + 0.5, np.zeros(4)], axis=-1)[None, None]
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0])[:, None], (1, 1, 2, 3, 4))
    share = np.stack([np.ones(4), np.full(4, 0.25)])[None, None]
    closeness, force = body_proximity(points, Planes(up, np.full((1, 1, 2, 4), -0.5), share))
    missing = (GAP_M - distance) / UNIT_M
    assert_allclose(closeness[0, 0], np.concatenate([np.tanh(missing), 0.25 * np.tanh(missing)]), rtol=0, atol=1e-12)
    assert_allclose(force[0, 0, :, 1], 1.25 * np.maximum(missing, 0.0), rtol=0, atol=1e-12)
    assert_array_equal(force[0, 0, :, [0, 2]], 0.0)


@pytest.mark.parametrize(
    ("height_m", "way_m", "share", "expected"),
    [
        (0.010, -0.010, 1.0, 1.0),  # comes to the skin
        (0.010, 0.030, 1.0, 1.0),  # goes away
        (-0.020, 0.010, 1.0, 1.0),  # comes out
        (0.010, -0.041, 1.0, 0.015 / 0.042),  # would be 31 mm deep, and is some 4
        (-0.020, -0.009, 1.0, 0.1),  # is deep already
        (0.010, -0.041, 0.25, 1.0),  # below a plane that is hardly there
    ],
)
def test_no_correction_takes_a_point_deep_below_a_plane(height_m, way_m, share, expected):
    """One of three points, and one of two planes, tells for all of the patch."""
    before = np.tile([0.0, 0.5, 0.0], (1, 2, 3, 1))
    before[0, 0, 1, 1] += height_m - 0.1
    after = before.copy()
    after[0, 0, 1, 1] += way_m
    up = np.broadcast_to(np.array([0.0, 1.0, 0.0])[:, None], (1, 2, 2, 3, 3)).copy()
    shares = np.stack([np.zeros((1, 2, 3)), np.full((1, 2, 3), share)], axis=2)
    given = before, after, up, np.full((1, 2, 2, 3), -0.4), shares
    for one, other, *near in (given, [torch.from_numpy(array) for array in given]):
        assert_allclose(held_share(one, other, Planes(*near)), [[expected, 1.0]], rtol=1e-9)


def test_the_own_plane_at_rest_is_the_skin():
    points, skin, own = posed("tank", 0.0)
    near = planes(points, skin, own)
    places = points[0].reshape(-1, 3).astype(np.float64)
    distance = (near.normal[0, :, 0].transpose(0, 2, 1) * points[0]).sum(-1) + near.offset[0, :, 0]
    there = near.share[0, :, 0].ravel() > 0.9
    exact = closest.signed_distance(places + BODY.rest_joints()[0], BODY.v_template, BODY.faces)
    assert there.mean() > 0.7  # the rest are hems and straps away from the skin
    error = np.abs(distance.ravel() - exact)[there]
    assert np.quantile(error, 0.95) < 0.004


def test_other_parts_are_felt_when_an_arm_comes_down_and_not_before():
    far, near = (
        body_proximity(points, planes(points, skin, own))[0]
        for points, skin, own in (posed("tshirt", 0.0), posed("tshirt", ARMS_DOWN))
    )
    other = slice(7, 14)
    assert (far[0, :, other] > 0.1).mean() < 0.02
    assert (near[0, :, other] > 0.1).mean() > 5.0 * max((far[0, :, other] > 0.1).mean(), 1e-3)


def test_torch_and_numpy_feel_the_same():
    """In float64 to its rounding; in float32 each to what rounding the table of samples does to float64.

    Logits are differences of numbers like |b|^2 / h^2, some 2,000 for a hand, so their weights are good to 2,000 halves
    of a unit in the last place, and share and closeness to four digits, in whichever order a processor adds them.
    """
    points, skin, own = posed("tank", ARMS_DOWN)

    def by_numpy(points: np.ndarray, skin: np.ndarray, bias: np.ndarray) -> tuple[np.ndarray, ...]:
        return body_proximity(points, planes(points, skin, replace(own, own_bias=bias)))

    def by_torch(*arrays: np.ndarray) -> list[np.ndarray]:
        points, skin, bias = (torch.from_numpy(array) for array in arrays)
        lists = replace(own.each(torch.from_numpy), own_bias=bias)
        return [x.numpy() for x in body_proximity(points, planes(points, skin, lists))]

    inputs = (points, skin, own.own_bias)
    wide_inputs = [x.astype(np.float64) for x in inputs]
    exact, moved = moved_by_rounding(by_numpy, *inputs)
    assert max(moved) < 1e-3  # no other region is chosen
    found = (by_numpy(*inputs), by_torch(*inputs), by_torch(*wide_inputs))
    for precise, far, one, other, wide in zip(exact, moved, *found, strict=True):
        bound = ROW_SIZE * far  # a logit is a sum of so many products, each of which rounds
        assert one.dtype == other.dtype == np.float32 and wide.dtype == np.float64
        assert_allclose(one, precise, rtol=0, atol=bound)
        assert_allclose(other, precise, rtol=0, atol=bound)
        assert_allclose(wide, precise, rtol=0, atol=bound * FLOAT64_SHARE)


def test_two_samples_fit_in_a_byte():
    other = lists("tank").other
    assert other.dtype == np.uint8 and (other.min(), other.max()) == (0, OTHER_STEPS)
    stored = in_halves(other)
    assert stored.dtype == np.uint8 and stored.nbytes == other.nbytes // 2
    for numbers in (stored.astype(np.float32), torch.from_numpy(stored).float()):
        assert_array_equal(from_halves(numbers), other)


def test_regions_without_another_part_lie_far_below():
    bias = region_bias_of(np.array([0.0, 1.0, OTHER_STEPS]))
    assert_allclose(np.exp(bias), [1e-6, 1.0 / OTHER_STEPS, 1.0], rtol=5e-3)
    assert_array_equal(bias, bias.astype(np.float16))  # as the packed graph stores them


def test_bodies_share_the_rows_of_their_shapes():
    store, rng = SkinShapes(BODY), np.random.default_rng(1)
    betas = rng.normal(size=(2, 10)).astype(np.float32)
    feed = store.feed(betas[[0, 1, 0, 0]])
    assert feed["body_shape"].tolist() == [0, 1, 0, 0] and feed["skin_rows"].shape[0] == 2
    assert_array_equal(feed["skin_rows"][1], store.feed(betas[1:])["skin_rows"][0])
    for i in range(KEPT_SHAPES + 3):
        store.feed(np.full((1, 10), 0.01 * i, dtype=np.float32))
    assert len(store._kept) == KEPT_SHAPES


def test_the_centre_of_a_region_is_the_mean_of_its_samples():
    skin = posed("tank", ARMS_DOWN)[1]
    assert_allclose(region_centres(skin), skin[..., :3].mean(axis=2), rtol=0, atol=1e-6)
