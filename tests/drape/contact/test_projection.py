"""The push-out on shipped garments: what it clears, what it leaves, how it moves, and its tables."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.skeleton import JOINT_NAMES
from drape.cloth import metrics
from drape.cloth.contact import BodyContact, nearest_vertex_push
from drape.contact import projection
from drape.contact.projection import (
    CLEARANCE_M,
    PushFeed,
    blend_displacement,
    fit,
    push_in_parts,
    push_out,
    push_out_of_bodies,
)
from drape.contact.push_tables import BLOCK_SIZE, GROUP_SIZE, other_part, push_tables
from drape.contact.skin import body_skin, skin_table
from drape.errors import ArtifactError, MeshError
from drape.garment.cache import Garment
from drape.geometry import closest, jets, meshes
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.skinning import skin_points
from drape.graph.feeds import garment_feed
from drape.graph.push_feed import pack_push, push_feed, pushed_jets
from tests.fixtures.cut_garments import cut_garment
from tests.fixtures.garments import default_body
from tests.fixtures.garments import shipped as garment


@cache
def feed_of(kind: str) -> PushFeed:
    return push_feed(garment(kind), default_body())


def table_of(poses: np.ndarray) -> np.ndarray:
    bones = body_skin(default_body()).on_bones(default_body())
    return skin_table(bones.rows.astype(np.float64), bones.bones, *default_body().bones(poses))


def skinned(kind: str, poses: np.ndarray) -> np.ndarray:
    rest, weights = (
        garment(kind).vertices.astype(np.float64),
        garment(kind).skin_weights(default_body()).astype(np.float64),
    )
    return skin_points(np.broadcast_to(rest, (len(poses), *rest.shape)), weights, *default_body().bones(poses))


def bent(joint: str, rotvec: tuple[float, float, float]) -> np.ndarray:
    poses = np.zeros((1, 24, 3))
    poses[0, JOINT_NAMES.index(joint)] = rotvec
    return poses


def depths(vertices: np.ndarray, posed: np.ndarray) -> np.ndarray:
    return closest.signed_distance(vertices, posed, default_body().faces)


def stretches(kind: str, vertices: np.ndarray) -> np.ndarray:
    edges = meshes.unique_edges(garment(kind).fine_faces.astype(np.int64))
    return meshes.edge_lengths(vertices, edges) / meshes.edge_lengths(garment(kind).vertices.astype(np.float64), edges)


@pytest.mark.parametrize(("make", "kind"), [(cut_garment, "tank"), (garment, "trousers")], ids=["cut tank", "trousers"])
def test_a_clear_garment_is_left_where_it_is(make: Callable[[str], Garment], kind: str):
    whole = make(kind)
    vertices = whole.vertices.astype(np.float64)[None]
    pushed = push_out(vertices, table_of(np.zeros((1, 24, 3))), push_feed(whole, default_body()))
    assert np.abs(pushed - vertices).max() < 1e-9


@pytest.mark.parametrize(("kind", "limit_m"), [("tank", 0.0004), ("longsleeve", 0.0018)])
def test_a_sewn_garment_with_sleeves_or_a_bust_is_hardly_moved(kind: str, limit_m: float):
    """It is 6.5 mm clear of the skin, not everywhere of the planes that stand for it: 0.36 and 1.65 mm measured."""
    vertices = garment(kind).vertices.astype(np.float64)[None]
    pushed = push_out(vertices, table_of(np.zeros((1, 24, 3))), feed_of(kind))
    assert 0.0 < np.linalg.norm(pushed - vertices, axis=-1).max() < limit_m


def test_cloth_drawn_into_the_body_comes_out_to_the_clearance():
    body, vertices = default_body(), garment("tank").vertices.astype(np.float64)
    found = closest.closest_point(vertices, body.v_template, body.faces)
    normals = meshes.face_normals(body.v_template, body.faces)[found.face]
    inside = (found.point - 0.006 * normals)[None]
    assert (depths(inside[0], body.v_template) < 0.0).mean() > 0.95
    pushed = push_out(inside, table_of(np.zeros((1, 24, 3))), feed_of("tank"), CLEARANCE_M)[0]
    after = depths(pushed, body.v_template)
    assert (after < 0.0).mean() < 0.005
    assert abs(float(np.median(after)) - CLEARANCE_M) < 0.0015


def test_cloth_drawn_through_the_other_leg_is_not_torn():
    """Beyond its middle the nearest skin of the other leg is the far side, and neighbours part company."""
    body, poses = default_body(), bent("left_hip", (0.0, 0.0, -0.08)) + bent("right_hip", (0.0, 0.0, 0.08))
    posed, vertices = body.posed_vertices(poses), skinned("trousers", poses)
    bones = [JOINT_NAMES.index("left_hip"), JOINT_NAMES.index("left_knee")]
    leg = garment("trousers").skin_weights(body)[:, bones].sum(axis=1) > 0.5
    height = body.joints_template[0, 1] - 0.3
    band = vertices[0][leg & (np.abs(vertices[0, :, 1] - height) < 0.05)]
    away = np.linalg.norm(vertices[0] - band[band[:, 0].argmin()], axis=1)
    vertices[0, :, 0] -= 0.12 * np.exp(-((away / 0.08) ** 2)) * leg
    contact = BodyContact(body.faces, body.vertex_count)
    torn = nearest_vertex_push(vertices, posed, np.asarray(contact.normals(posed)))
    kept = push_out_of_bodies(vertices, posed, body_skin(body), feed_of("trousers"))
    plain, worst, ours = (stretches("trousers", x[0]).max() for x in (vertices, torn, kept))
    assert worst > 3.0 * plain, "must tear for the test to mean something"
    assert ours < 0.5 * worst and ours < 2.0 * plain
    assert (depths(kept[0], posed[0]) < 0.0).mean() < 0.7 * (depths(vertices[0], posed[0]) < 0.0).mean()


def test_it_moves_smoothly_with_the_body():
    turns = np.linspace(-1.30, -1.31, 5)
    poses = np.concatenate([bent("left_shoulder", (0.0, 0.0, turn)) for turn in turns])
    vertices = skinned("longsleeve", poses)
    pushed = push_out(vertices, table_of(poses), feed_of("longsleeve"))
    step, plain = (np.linalg.norm(np.diff(x, axis=0), axis=-1) for x in (pushed, vertices))
    moved = np.linalg.norm(pushed - vertices, axis=-1)
    assert moved.max() > 0.01
    # A jump would be as long as the push itself in one of the steps; the arm moves 2 mm in each.
    assert step.max() < 6.0 * plain.max()
    assert np.percentile(step, 99.0) < 2.0 * plain.max()


def test_numpy_and_torch_agree_and_frames_are_independent(rng):
    poses = rng.normal(0.0, 0.3, size=(3, 24, 3))
    vertices, table, feed = skinned("shorts", poses), table_of(poses), feed_of("shorts")
    together = push_out(vertices, table, feed)
    alone = np.concatenate([push_out(vertices[i : i + 1], table[i : i + 1], feed) for i in range(3)])
    assert_allclose(alone, together, rtol=0, atol=1e-12)
    tensors = feed.each(lambda a: torch.from_numpy(a.astype(np.float64) if a.dtype == np.float32 else a))
    in_torch = push_out(torch.from_numpy(vertices), torch.from_numpy(table), tensors, CLEARANCE_M)
    assert_allclose(in_torch.numpy(), together, rtol=0, atol=1e-9)


def test_it_follows_the_body_through_the_world():
    body, poses = default_body(), bent("left_hip", (-1.2, 0.0, 0.0))
    vertices, posed = skinned("shorts", poses), body.posed_vertices(poses)
    skin, feed = body_skin(body), feed_of("shorts")
    here = push_out_of_bodies(vertices, posed, skin, feed)
    assert np.abs(here - vertices).max() > 1e-3
    there = push_out_of_bodies(vertices + 100.0, posed + 100.0, skin, feed)
    assert_allclose(there - 100.0, here, rtol=0, atol=1e-7)


def test_a_smooth_displacement_is_fitted_and_cloth_far_from_a_push_stays():
    whole, feed = garment("tank"), feed_of("tank")
    slots = feed.block_vertex.reshape(-1)
    same = np.broadcast_to(np.array([[0.01], [-0.02], [0.005]]), (1, 3, len(slots)))
    assert_allclose(blend_displacement(fit(same, feed), feed), same, rtol=0.02, atol=1e-4)
    rest = whole.vertices.astype(np.float64)[slots]
    bump = np.exp(-((np.linalg.norm(rest - rest[0], axis=1) / 0.05) ** 2)) * np.array([[[0.0], [0.0], [0.01]]])
    found = blend_displacement(fit(bump, feed), feed)
    assert np.abs(found - bump).max() < 0.006
    far = np.linalg.norm(rest - rest[0], axis=1) > 0.4
    assert_array_equal(blend_displacement(fit(np.where(bump > 1e-3, bump, 0.0), feed), feed)[0, :, far], 0.0)


def test_jets_carry_the_fitted_push_and_what_they_lack_is_told(rng, monkeypatch):
    """Vertices of the corrected jets, by the blend itself, are the drape plus the blend of the fitted displacement."""
    whole, feed, poses = garment("trousers"), feed_of("trousers"), bent("left_hip", (-1.2, 0.0, 0.3))
    constants = garment_feed(whole, fine=True)
    patch, weight = constants["chart_patch"], constants["chart_weight"].astype(np.float64)
    scale, basis = constants["patch_scale"].astype(np.float64), constants["chart_basis"].astype(np.float64)
    rotation = rotvec_to_matrix(rng.normal(size=(1, len(scale), 3)))

    def of_jets(jet: np.ndarray) -> np.ndarray:
        own = jet.reshape(1, -1, 3, 15)[:, patch]  # (F, V, 4, 3, 15)
        place = np.einsum("fvicn,vin->fvic", own, basis) * scale[patch][..., None]
        return np.einsum("vi,fviab,fvib->fva", weight, rotation[:, patch], place)

    vertices = skinned("trousers", poses) - np.array([0.0, 0.0, 0.015])  # drawn into the front of the legs
    pushed = push_in_parts(vertices, table_of(poses), feed)
    assert_array_equal(pushed.vertices, push_out(vertices, table_of(poses), feed))
    carried = blend_displacement(pushed.coefficients, feed)[0].T[feed.vertex_slot]
    assert np.abs(carried).max() > 0.003, "must push for the test to mean something"
    for count in (27, 45):
        jet = 0.1 * rng.normal(size=(1, len(scale), count))
        after = pushed_jets(jet, rotation, scale, pushed.coefficients)
        assert after.shape == (1, len(scale), 45)
        moved = of_jets(after) - of_jets(np.asarray(jets.full(jet)))
        assert_allclose(moved[0], carried, rtol=0, atol=1e-7)  # the tables are float32
    monkeypatch.setattr(projection, "JET_ROUNDS", 1)
    once = push_in_parts(vertices, table_of(poses), feed)
    assert_array_equal(once.vertices, pushed.vertices)  # those of vertices know nothing of the rounds
    carried = blend_displacement(once.coefficients, feed)[0].T[feed.vertex_slot]
    rest = np.linalg.norm(once.vertices[0] - vertices[0] - carried, axis=-1)
    assert_allclose(once.left_m, rest.max(), rtol=0, atol=1e-9)
    assert 0.0 < pushed.left_m[0] < once.left_m[0] < 0.03


def test_cloth_of_jets_comes_out_of_the_body_like_cloth_of_vertices():
    feed, poses = feed_of("trousers"), bent("left_hip", (-1.2, 0.0, 0.3))
    vertices = skinned("trousers", poses) - np.array([0.0, 0.0, 0.015])
    pushed = push_in_parts(vertices, table_of(poses), feed)
    of_jets = vertices + np.swapaxes(blend_displacement(pushed.coefficients, feed), 1, 2)[:, feed.vertex_slot]
    posed, faces = default_body().posed_vertices(poses), default_body().faces
    drape, by_vertices, by_jets = (
        metrics.colliding_triangle_pct(cloth, posed, faces)[0] for cloth in (vertices, pushed.vertices, of_jets)
    )
    assert drape > 1.0, "must collide for the test to mean something"
    assert by_jets < by_vertices + 0.02 * drape


def test_tables_keep_every_vertex_and_know_the_other_parts():
    whole, body = garment("longsleeve"), default_body()
    skin = body_skin(body)
    tables = push_tables(whole.vertices, skin)
    assert tables.block_vertex.shape[1] == BLOCK_SIZE * GROUP_SIZE
    assert_array_equal(tables.block_vertex.reshape(-1)[tables.vertex_slot], np.arange(len(whole.vertices)))
    # A cuff hangs on the forearm, and the trunk is another part to it.
    slot = tables.vertex_slot[int(whole.vertices[:, 0].argmax())] // (BLOCK_SIZE * GROUP_SIZE)
    trunk = np.abs(skin.point[:, 0]) < 0.1
    near = np.linalg.norm(skin.point - whole.vertices[whole.vertices[:, 0].argmax()], axis=1) < 0.06
    other = tables.other[slot].reshape(-1)
    assert (other[trunk] == 255).all() and np.median(other[near]) < 60


def test_the_far_side_of_a_limb_is_not_another_part_but_a_facing_one_is():
    distance, before = np.array([0.02, 0.12, 0.12, 0.12, 0.4]), np.array([0.01, -0.12, 0.0, 0.05, -0.4])
    assert_allclose(other_part(distance, before), [0.0, 0.0, 1.0, 1.0, 1.0])


def test_empty_and_broken_garments_are_refused():
    skin, feed = body_skin(default_body()), garment_feed(garment("tank"))
    for told, broken in (
        ("at least one", np.zeros((0, 3))),
        ("finite", np.full((4, 3), np.nan)),
        ("shape", np.zeros((4, 2))),
    ):
        with pytest.raises(MeshError, match=told):
            push_tables(broken, skin)
    with pytest.raises(ArtifactError, match="as in the feed"):
        pack_push(feed, np.zeros((5, 3)), skin)
