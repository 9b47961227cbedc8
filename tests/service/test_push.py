"""The service's push-out: the graph where the model has it, numpy elsewhere, bodies of any shape, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import NotFound
from drape.garment.cache import Garment
from drape.geometry import jets
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.push.projection import CLEARANCE_M
from service.engine import Engine
from service.push import PosedJets, Pusher
from tests.fixtures.packed import exported, garment
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import TINY, tube_garment


def drawn(whole: Garment, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """Skinned vertices (F, V, 3) relative to the root."""
    body, count = load_body(), whole.vertex_count
    rest = whole.vertices[:count].astype(np.float64)
    rotations, translations = body.bones(poses, None, betas)
    weights = whole.skin_weights[:count].astype(np.float64)
    relative = translations - body.rest_joints(betas)[0]
    return skin_points(np.broadcast_to(rest, (len(poses), *rest.shape)), weights, rotations, relative)


def added(pusher: Pusher, whole: Garment) -> Pusher:
    pusher.add("it", garment_feed(whole), whole.vertices[: whole.vertex_count], whole.faces)
    return pusher


@pytest.mark.slow
def test_graph_and_numpy_push_alike():
    body, whole = load_body(), garment("shorts")
    engine = Engine(exported()[1])
    by_graph, by_numpy = added(Pusher(engine, body), whole), added(Pusher(engine, body), whole)
    by_numpy._push_in_graph = False
    assert by_graph.in_graph and not by_numpy.in_graph
    poses, _ = random_motion(2, spread_rad=0.35)
    for betas in (np.zeros(10), np.linspace(-1.0, 1.0, 10)):
        vertices = drawn(whole, poses, betas)
        pushed, way = by_graph.push("it", vertices, poses, betas, CLEARANCE_M)
        assert way.max() > 1e-3, "must push for the test to mean something"
        assert_allclose(pushed, by_numpy.push("it", vertices, poses, betas, CLEARANCE_M)[0], rtol=0, atol=2e-5)
        assert_allclose(way, np.linalg.norm(pushed - vertices, axis=-1), rtol=0, atol=1e-5)
        skin = by_graph._table(poses, betas)
        given, _ = by_graph.push("it", vertices, poses, betas, CLEARANCE_M, skin=skin)
        assert_allclose(given, pushed, rtol=0, atol=1e-6)


def test_a_model_without_the_graph_and_a_body_with_corrections_take_numpy(tiny_folder):
    body, poses, betas = load_body(), random_motion(2, spread_rad=0.35)[0], np.zeros(10)
    whole = tube_garment(body)
    engine = Engine(tiny_folder / "models" / TINY)
    plain = added(Pusher(engine, body), whole)
    corrected = added(Pusher(engine, replace(body, posedirs=np.zeros((body.vertex_count, 3, 207)))), whole)
    assert not plain.in_graph and not corrected.in_graph
    vertices = drawn(whole, poses, betas)
    pushed = plain.push("it", vertices, poses, betas, CLEARANCE_M)[0]
    assert np.abs(pushed - vertices).max() > 1e-3
    assert_allclose(corrected.push("it", vertices, poses, betas, CLEARANCE_M)[0], pushed, rtol=0, atol=2e-5)
    alone = plain.push("it", vertices[1:], poses[1:], betas, CLEARANCE_M)[0]
    assert_array_equal(alone[0], pushed[1])


@pytest.mark.slow
def test_jets_carry_the_push_by_graph_and_by_numpy(rng):
    body, whole = load_body(), garment("shorts")
    engine = Engine(exported()[1])
    assert engine.tells_jet_push("push_out") and not engine.tells_jet_push("packed")
    by_graph = added(Pusher(engine, body), whole)
    by_numpy = added(Pusher(engine, replace(body, posedirs=np.zeros((body.vertex_count, 3, 207)))), whole)
    poses, betas, count = random_motion(2, spread_rad=0.35)[0], np.linspace(-1.0, 1.0, 10), whole.patch_count
    vertices, jet = drawn(whole, poses, betas), rng.normal(size=(2, count, 27)).astype(np.float32)
    rotation = rotvec_to_matrix(rng.normal(size=(2, count, 3)))
    posed = PosedJets(jet, rotation)
    got = by_graph.push_jets(["it"], vertices, None, posed, poses, betas, CLEARANCE_M)
    expected = by_numpy.push_jets(["it"], vertices, None, posed, poses, betas, CLEARANCE_M)
    assert got.jet.shape == (2, count, 45) and np.abs(got.jet - jets.full(jet)).max() > 0.01
    assert_allclose(got.jet, expected.jet, rtol=0, atol=5e-4)  # of a scale of 5 cm
    assert_allclose(got.left_m, expected.left_m, rtol=0, atol=2e-5)
    pushed, way = by_graph.push("it", vertices, poses, betas, CLEARANCE_M)
    assert_array_equal(got.vertices, pushed)
    assert_array_equal(got.way_m, way)
    assert (got.left_m < way.max(axis=1)).all() and (got.left_m > 0.0).all()


@pytest.mark.slow
def test_jets_carry_the_push_over_by_graph_and_by_numpy(rng):
    body, inner, outer = load_body(), garment("tank"), garment("shorts")
    engine = Engine(exported()[1])
    poses, betas, keys = random_motion(2, spread_rad=0.2)[0], np.linspace(-1.0, 1.0, 10), ("tank", "shorts")
    pushers = [Pusher(engine, body), Pusher(engine, replace(body, posedirs=np.zeros((body.vertex_count, 3, 207))))]
    for pusher in pushers:
        for key, whole in zip(keys, (inner, outer), strict=True):
            pusher.add(key, garment_feed(whole), whole.vertices[: whole.vertex_count], whole.faces)
    under, vertices = drawn(inner, poses, betas), drawn(outer, poses, betas)
    rotation = rotvec_to_matrix(rng.normal(size=(2, outer.patch_count, 3)))
    posed = PosedJets(np.zeros((2, outer.patch_count, 27), np.float32), rotation)
    got, expected = (p.push_jets(keys, vertices, under, posed, poses, betas, CLEARANCE_M) for p in pushers)
    assert np.abs(got.jet).max() > 0.01, "must push for the test to mean something"
    assert_allclose(got.jet, expected.jet, rtol=0, atol=5e-4)
    assert_allclose(got.left_m, expected.left_m, rtol=0, atol=2e-5)
    pushed, _ = pushers[0].push_over(keys, vertices, under, poses, betas, CLEARANCE_M)
    assert_array_equal(got.vertices, pushed)


def test_a_garment_that_is_not_in_store_is_refused(tiny_folder):
    pusher = Pusher(Engine(tiny_folder / "models" / TINY), load_body())
    with pytest.raises(NotFound, match="one in store"):
        pusher.push("it", np.zeros((1, 3, 3)), np.zeros((1, 24, 3)), np.zeros(10), CLEARANCE_M)
