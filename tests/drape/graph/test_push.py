"""The push-out by the engine: the readable formula, alone and over others, in float64 and float32."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.contact.projection import CLEARANCE_M, push_in_parts
from drape.contact.skin import body_skin, posed_table
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.layer_feed import layer_feed, push_over_in_parts
from drape.graph.push import PushConstants, push_frames
from drape.graph.push_feed import pack_push
from tests.fixtures.garments import shipped
from tests.fixtures.poses import random_motion

POSES, BETAS = random_motion(2, spread_rad=0.35)[0], np.zeros(10)
# Of the exponential's series; of places up to a metre, of which weights multiply squares by 5000 in the formula.
ROUNDING_M = {np.float64: 1e-7, np.float32: 2e-5}
TYPES = pytest.mark.parametrize("dtype", [np.float64, np.float32])


@cache
def drawn(kind: str) -> np.ndarray:
    """Skinned vertices (F, V, 3) relative to the root."""
    whole, body = shipped(kind), load_body()
    rest = whole.vertices[: whole.vertex_count].astype(np.float64)
    rotations, translations = body.bones(POSES, None, BETAS)
    weights = whole.skin_weights(body)[: whole.vertex_count].astype(np.float64)
    places = np.broadcast_to(rest, (len(POSES), *rest.shape))
    return skin_points(places, weights, rotations, translations - body.rest_joints(BETAS)[0])


def skin() -> np.ndarray:
    return posed_table(load_body(), POSES, BETAS).astype(np.float64)


def in_type(feed, dtype: type):
    return feed.each(lambda array: array.astype(dtype) if array.dtype.kind == "f" else array)


def compared(found, expected, vertices: np.ndarray, dtype: type) -> None:
    pushed, way, coefficients, left_m = found
    assert np.abs(expected.vertices - vertices).max() > 1e-3, "must push for the test to mean something"
    assert_allclose(pushed, expected.vertices, rtol=0, atol=ROUNDING_M[dtype])
    assert_allclose(way, np.linalg.norm(pushed - vertices, axis=-1), rtol=0, atol=ROUNDING_M[dtype])
    assert_allclose(coefficients, expected.coefficients, rtol=0, atol=10.0 * ROUNDING_M[dtype])
    assert_allclose(left_m, expected.left_m, rtol=0, atol=2.0 * ROUNDING_M[dtype])


@TYPES
def test_it_is_the_formula(dtype: type):
    whole = shipped("shorts")
    feed = pack_push(garment_feed(whole), whole.vertices[: whole.vertex_count], body_skin(load_body()))
    vertices, constants = drawn("shorts"), PushConstants.of(in_type(feed, dtype))
    found = push_frames(vertices.astype(dtype), skin().astype(dtype), constants, CLEARANCE_M, jets=True)
    compared(found, push_in_parts(vertices, skin(), in_type(feed, np.float64)), vertices, dtype)
    alone = push_frames(vertices[1:].astype(dtype), skin()[1:].astype(dtype), constants, CLEARANCE_M)
    assert_array_equal(alone[0][0], found[0][1])


@TYPES
def test_it_is_the_formula_over_others(dtype: type):
    feed = layer_feed(shipped("shorts"), [shipped("tank")], load_body())
    vertices, under, constants = drawn("shorts"), drawn("tank"), PushConstants.of(in_type(feed, dtype))
    given, samples, below = (array.astype(dtype) for array in (vertices, skin(), under))
    found = push_frames(given, samples, constants, CLEARANCE_M, under=below, jets=True)
    expected = push_over_in_parts(vertices, under, skin(), in_type(feed, np.float64))
    compared(found, expected, vertices, dtype)
