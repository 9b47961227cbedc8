"""The service's push-out: its graph against the formula, bodies of any shape and kind, jets, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.contact.projection import CLEARANCE_M, push_in_parts
from drape.contact.skin import body_skin, posed_table
from drape.errors import NotFound
from drape.garment.cache import Garment
from drape.geometry import jets
from drape.geometry.closest import signed_distance
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import pack_push, pushed_jets
from drape.inference.engine import Engine
from drape.stages.batch import Jets, PoseInput
from drape.stages.collision import Pusher
from drape.stages.walk import run
from drape.wire.options import Advanced, DrapeOptions
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.packed import garment
from tests.fixtures.poses import random_motion
from tests.fixtures.tiny_model import tiny_folder as model_folder

POSES, BETAS = random_motion(2, spread_rad=0.35)[0], np.linspace(-1.0, 1.0, 10)
CLEARANCE = np.float32(CLEARANCE_M)


def drawn(whole: Garment, poses: np.ndarray, betas: np.ndarray) -> np.ndarray:
    """Skinned vertices (F, V, 3) float32 relative to the root."""
    body, count = load_body(), whole.vertex_count
    rest = whole.vertices[:count].astype(np.float64)
    rotations, translations = body.bones(poses, None, betas)
    weights = whole.skin_weights(body)[:count].astype(np.float64)
    relative = translations - body.rest_joints(betas)[0]
    return skin_points(np.broadcast_to(rest, (len(poses), *rest.shape)), weights, rotations, relative).astype(
        np.float32
    )


def added(pusher: Pusher, *garments: Garment) -> Pusher:
    for whole in garments:
        pusher.add(whole.digest, garment_feed(whole), whole.vertices[: whole.vertex_count], whole.faces)
    return pusher


def posed_jets(whole: Garment, rng: np.random.Generator) -> Jets:
    jet = rng.normal(size=(len(POSES), whole.patch_count, 27)).astype(np.float32)
    turned = rotvec_to_matrix(rng.normal(size=(len(POSES), whole.patch_count, 3))).astype(np.float32)
    return Jets(jet, turned, turned[..., 0])


@pytest.mark.slow
def test_vertices_and_jets_are_pushed_by_the_graph_as_the_formula_says(rng: np.random.Generator):
    body, whole = load_body(), garment("shorts")
    pusher = added(Pusher(Engine(model_folder(), pushes=True), body), whole)
    feed = pack_push(garment_feed(whole), whole.vertices[: whole.vertex_count], body_skin(body))
    vertices, skin, posed = drawn(whole, POSES, BETAS), posed_table(body, POSES, BETAS), posed_jets(whole, rng)
    alone, got = (pusher.push([whole.digest], vertices, skin, posed=jets) for jets in (None, posed))
    expected = push_in_parts(vertices, skin, feed, CLEARANCE)
    assert got.way_m.max() > 1e-3, "must push for the test to mean something"
    assert_array_equal(got.vertices, alone.vertices)
    assert_allclose(got.vertices, expected.vertices, rtol=0, atol=2e-5)
    assert_allclose(got.way_m, np.linalg.norm(got.vertices - vertices, axis=-1), rtol=0, atol=1e-5)
    want = pushed_jets(posed.jet, posed.rotation, garment_feed(whole)["patch_scale"], expected.coefficients)
    assert got.jet is not None and np.abs(got.jet - jets.full(posed.jet)).max() > 0.01
    assert_allclose(got.jet, want, rtol=0, atol=5e-4)  # of a scale of 5 cm
    assert got.left_m is not None
    assert_allclose(got.left_m, expected.left_m, rtol=0, atol=2e-5)
    most_m = got.way_m.max(axis=1)
    moved = most_m > 0.0
    assert (got.left_m[moved] < most_m[moved]).all() and (got.left_m[moved] > 0.0).all()
    one = pusher.push([whole.digest], vertices[1:], skin[1:])
    assert_array_equal(one.vertices[0], got.vertices[1])


def with_corrections(body: BodyModel, size_m: float) -> BodyModel:
    """``body`` with pose blend shapes that draw its skin outwards where joints bend."""
    generator = np.random.default_rng(5)
    outwards = body.v_template - body.v_template.mean(axis=0)
    outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
    directions = outwards[:, :, None] * generator.uniform(0.0, size_m, size=(1, 1, 207))
    return replace(body, posedirs=directions)


def test_a_body_with_pose_blend_shapes_drapes_and_is_pushed(outfit_settings: Settings):
    """Of a centimetre, as a licensed SMPL file has them: alone, in jets and in layers the cloth comes out of the
    skin that is really there, which the network feels too."""
    body = with_corrections(load_body(), 1e-2)
    corrected, plain = DrapeRuntime(outfit_settings, body=body), DrapeRuntime(outfit_settings)
    poses = random_motion(8, spread_rad=0.25)[0]  # with more, arms are deep inside the chest
    clip = PoseInput(poses, np.zeros((8, 3)), np.zeros(10), np.zeros(8))
    posed = body.posed_vertices(clip.poses, clip.trans, clip.betas)
    assert np.abs(posed - load_body().posed_vertices(clip.poses, clip.trans, clip.betas)).max() > 5e-3
    entry = corrected.garments.get("tube")
    bare, pushed = (
        run(corrected.plan(entry, DrapeOptions(advanced=Advanced(push_out=push))), [clip]) for push in (False, True)
    )
    inside = [
        np.mean([(signed_distance(x, b, body.faces) < 0.0).mean() for x, b in zip(d.world(), posed, strict=True)])
        for d in (bare, pushed)
    ]
    assert inside[0] > 0.01 and inside[1] < 0.6 * inside[0]
    other = run(plain.plan(plain.garments.get("tube"), DrapeOptions(advanced=Advanced(push_out=False))), [clip])
    assert np.abs(other.vertices - bare.vertices).max() > 1e-6, "patches feel the skin that bulges"
    scene = corrected.garments.scene(None, ["tube", "coat"])
    worn = run(corrected.plan(scene, DrapeOptions(advanced=Advanced(push_out=True), geometry="jets")), [clip])
    assert_array_equal(worn.layers[0].vertices, pushed.vertices)
    assert (worn.quality.push_max_m > 1e-3).all() and (worn.quality.left_m > 0.0).all()
    for runtime in (corrected, plain):
        runtime.close()


def test_a_body_with_corrections_that_are_zero_is_the_body_without(outfit_settings: Settings):
    """The two providers of the posed skin, the graph by bones and the body itself, agree."""
    clip = PoseInput(POSES, np.zeros((2, 3)), BETAS, np.zeros(2))
    found = []
    for body in (load_body(), with_corrections(load_body(), 0.0)):
        runtime = DrapeRuntime(outfit_settings, body=body)
        plan = runtime.plan(
            runtime.garments.scene(None, ["tube", "coat"]), DrapeOptions(advanced=Advanced(push_out=True))
        )
        found.append(run(plan, [clip]))
        runtime.close()
    assert_allclose(found[1].vertices, found[0].vertices, rtol=0, atol=5e-5)
    assert_allclose(found[1].skin[..., :4], found[0].skin[..., :4], rtol=0, atol=2e-6)


def test_a_garment_that_is_not_in_store_is_refused():
    pusher = Pusher(Engine(model_folder()), load_body())
    with pytest.raises(NotFound, match="one in store"):
        pusher.push(["it"], np.zeros((1, 3, 3)), posed_table(load_body(), POSES[:1], BETAS))
