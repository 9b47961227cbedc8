"""Garments over others: the outer one clears the inner one, two forms of one formula, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.cloth import metrics
from drape.contact.cloth_samples import join_samples
from drape.contact.projection import CLEARANCE_M, push_out_of_bodies
from drape.contact.samples import sample_table
from drape.contact.skin import body_skin
from drape.errors import ArtifactError, InputError
from drape.garment.cache import Garment
from drape.geometry.skinning import skin_points
from drape.graph.layer_feed import LayerFeed, check_layers, inner_garment, layer_feed, push_over
from tests.fixtures.cut_garments import cut_garment
from tests.fixtures.garments import shipped
from tests.fixtures.layers import through_pct


@cache
def garment(kind: str) -> Garment:
    """The shipped garment of that name, "cut tank" the smooth one of before, without folds."""
    if kind.startswith("cut "):
        return cut_garment(kind.removeprefix("cut "))
    return shipped(kind)


@cache
def feed_of(inner: str, outer: str) -> LayerFeed:
    return layer_feed(garment(outer), [garment(inner)], load_body())


def skinned(kind: str, poses: np.ndarray) -> np.ndarray:
    whole = garment(kind)
    rest = whole.vertices[: whole.vertex_count].astype(np.float64)
    weights = whole.skin_weights(load_body())[: whole.vertex_count].astype(np.float64)
    return skin_points(np.broadcast_to(rest, (len(poses), *rest.shape)), weights, *load_body().bones(poses))


def bent() -> np.ndarray:
    """A lifted leg, and arms away from the trunk."""
    poses = np.zeros((1, 24, 3))
    poses[0, JOINT_NAMES.index("left_hip")] = (-0.7, 0.0, 0.0)
    poses[0, JOINT_NAMES.index("right_shoulder")] = (0.0, 0.0, 0.6)
    return poses


def table_of(posed: np.ndarray) -> np.ndarray:
    skin = body_skin(load_body())
    return sample_table(*skin.posed(posed)).reshape(len(posed), skin.region_count, -1, 8)


# A fold of the sewn tank stands 25 mm before its front, too far for the shirt: 0.72 % of it stay behind.
PAIRS = [("cut tank", "cut longsleeve", 0.5), ("tank", "longsleeve", 0.8)]


@pytest.mark.parametrize(("below", "over", "limit_pct"), PAIRS)
@pytest.mark.parametrize("poses", [np.zeros((1, 24, 3)), bent()])
def test_the_outer_garment_comes_out_of_the_inner_one(poses: np.ndarray, below: str, over: str, limit_pct: float):
    """At rest tank and shirt lie within millimetres, the one before the other in some places."""
    inner, outer, faces = skinned(below, poses), skinned(over, poses), garment(below).faces.astype(np.int64)
    posed = load_body().posed_vertices(poses)
    before = through_pct(outer, inner, faces)
    pushed = push_over(outer, inner, table_of(posed), feed_of(below, over))
    assert before.min() > 10.0, "must be through for the test to mean something"
    assert through_pct(pushed, inner, faces).max() < limit_pct
    assert metrics.colliding_triangle_pct(pushed, posed, load_body().faces).max() < 0.1
    # Sleeves hang on nothing that the tank covers: they stay where the body alone would leave them.
    cuff = np.abs(garment(over).vertices[: outer.shape[1], 0]) > 0.45
    assert np.linalg.norm(pushed - outer, axis=-1)[0, cuff].max() < 0.004


def test_it_is_the_push_out_of_one_surface_that_body_and_cloth_are():
    poses = bent()
    inner, outer, posed = skinned("tank", poses), skinned("longsleeve", poses), load_body().posed_vertices(poses)
    feed, skin, cloth = feed_of("tank", "longsleeve"), body_skin(load_body()), inner_garment(garment("tank")).samples
    seen = join_samples([skin, cloth]).of_regions(feed.region.reshape(-1))
    whole = push_out_of_bodies(outer, np.concatenate([posed, inner], axis=1), seen, feed.push, CLEARANCE_M)
    assert np.abs(whole - outer).max() > 0.005
    assert_allclose(push_over(outer, inner, table_of(posed), feed), whole, rtol=0, atol=2e-6)  # rows are float32


# The same fold, and shorts that end under it: 1.49 %.
@pytest.mark.parametrize(("cut", "limit_pct"), [("cut ", 0.5), ("", 1.6)])
def test_three_layers_count_their_vertices_one_after_the_other(cut: str, limit_pct: float):
    body, (tank, shorts, shirt) = load_body(), (f"{cut}{name}" for name in ("tank", "shorts", "longsleeve"))
    feed = layer_feed(garment(shirt), [garment(tank), garment(shorts)], body)
    members = feed.cloth_member.reshape(-1)
    first = garment(tank).vertex_count
    assert members.max() < first + garment(shorts).vertex_count
    clusters = inner_garment(garment(tank)).samples.member.shape[0]
    flat = feed.cloth_member.reshape(-1, feed.cloth_member.shape[-1])
    assert flat[:clusters].max() < first <= flat[clusters:].min()
    assert set(feed.flat()) >= {"region", "cloth_member", "cloth_rows", "push_other"}
    poses = np.zeros((1, 24, 3))
    table, inner, outer = table_of(body.v_template[None]), skinned(tank, poses), skinned(shirt, poses)
    middle = push_over(skinned(shorts, poses), inner, table, feed_of(tank, shorts))
    under = np.concatenate([inner, middle], axis=1)
    pushed = push_over(outer, under, table, feed)
    for kind, start in ((tank, 0), (shorts, first)):
        below, faces = under[:, start : start + garment(kind).vertex_count], garment(kind).faces.astype(np.int64)
        assert through_pct(pushed, below, faces).max() < limit_pct


def test_outfits_that_make_no_sense_are_refused():
    tank, body = garment("tank"), load_body()
    with pytest.raises(InputError, match="two garments or more"):
        check_layers([tank])
    with pytest.raises(InputError, match="tank twice"):
        layer_feed(tank, [garment("shorts"), tank], body)
    stranger = replace(garment("shorts"), body_digest="0" * 64)
    for inner, outer in ((stranger, tank), (tank, stranger)):
        with pytest.raises(ArtifactError, match="as of all layers"):
            layer_feed(outer, [inner], body)
