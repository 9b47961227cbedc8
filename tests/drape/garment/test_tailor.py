"""Garments cut anew for other bodies: clear of their skin, as strained as they were."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.avatar_body import _regressor
from drape.body.model import BodyModel
from drape.files.looks import Looks, Material
from drape.garment.cache import Garment
from drape.garment.clearance import CLEARANCE_M
from drape.garment.rest_pose import LEGS
from drape.garment.tailor import _metric, stretched, tailored, tailored_digest
from drape.garment.trouser_legs import above_shoes
from drape.geometry import meshes
from drape.geometry.closest import nearest_vertices, signed_distance
from tests.fixtures.garments import shipped

LOOKS = Looks((Material((0.2, 0.4, 0.6, 1.0)),), ())


def larger(body: BodyModel, factor: float) -> BodyModel:
    return replace(body, name="larger", digest=f"{factor} {body.digest}", v_template=factor * body.v_template,
                   shapedirs=np.zeros_like(body.shapedirs), standard_digest=body.digest)  # fmt: skip


def test_cloth_that_is_moved_keeps_its_strain():
    random = np.random.default_rng(0)
    before, faces = random.normal(size=(12, 3)), np.arange(12).reshape(-1, 3)
    after = before @ random.normal(size=(3, 3)) + 0.1 * random.normal(size=(12, 3))
    edges = np.eye(2) + 0.2 * random.normal(size=(4, 2, 2))
    made = stretched(edges, before, after, faces)
    columns = [np.swapaxes(each, -1, -2) for each in (edges, made)]
    assert_allclose(_metric(after, faces, columns[1]), _metric(before, faces, columns[0]), rtol=1e-8)
    # A turn changes nothing, and a scale is one of the cloth.
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    assert_allclose(stretched(edges, before, 1.5 * before @ turn, faces), 1.5 * edges, rtol=1e-9)


@pytest.fixture(scope="module")
def cut(tube: Garment, body: BodyModel) -> tuple[Garment, BodyModel]:
    wearer = larger(body, 1.1)
    return tailored(replace(tube, looks=LOOKS), body, wearer), wearer


def test_a_garment_looks_the_same_on_another_body(cut: tuple[Garment, BodyModel]):
    assert cut[0].looks == LOOKS


def test_a_garment_grows_with_its_wearer(cut: tuple[Garment, BodyModel], tube: Garment):
    made, wearer = cut
    assert signed_distance(made.vertices.astype(float), wearer.v_template, wearer.faces).min() >= CLEARANCE_M - 1e-6
    faces = tube.fine_faces.astype(int)
    grown = meshes.face_areas(made.vertices, faces).sum() / meshes.face_areas(tube.vertices, faces).sum()
    assert 1.1 < grown < 1.22  # the gap to the skin stays
    ratio = np.linalg.norm(made.rest_state().edges, axis=-1) / np.linalg.norm(tube.rest_state().edges, axis=-1)
    assert 1.05 < np.median(ratio) < 1.11


def test_its_charts_are_those_it_had_without_a_fold(body: BodyModel):
    dress, wearer = shipped("dress"), larger(body, 1.05)
    made = tailored(dress, body, wearer)
    fit = made.manifest["fit"]
    assert (made.chart_patch == dress.chart_patch).all()
    assert fit["folded_charts"] == fit["folded_chart_triangles"] == 0
    assert fit["point_rmse_m"] < 1.2 * dress.manifest["fit"]["point_rmse_m"]
    mirrored = replace(
        dress, chart_uv=dress.chart_uv * np.array([-1.0, 1.0], dtype=np.float32)
    )  # folded as in the oldest caches
    anew = tailored(mirrored, body, wearer).manifest["fit"]
    assert anew["folded_charts"] == anew["folded_chart_triangles"] == 0


def test_a_patch_that_weighs_most_nowhere_gives_way_to_new_ones(tube: Garment, body: BodyModel):
    weight = tube.chart_weight.copy()
    lost = int(tube.chart_patch[0, weight[0].argmax()])
    weight[(tube.chart_patch == lost) & (weight < 1.0)] *= 1e-3
    weight /= weight.sum(axis=1, keepdims=True)
    made = tailored(replace(tube, chart_weight=weight), body, larger(body, 1.1))
    assert made.patch_count == tube.patch_count and np.isfinite(made.patch_centre).all()
    assert not (made.chart_patch == tube.chart_patch).all()


def test_it_keeps_its_mesh_its_cloth_and_its_name(cut: tuple[Garment, BodyModel], tube: Garment):
    made, wearer = cut
    assert (made.name, made.fabric, made.vertex_count) == (tube.name, tube.fabric, tube.vertex_count)
    assert (made.faces == tube.faces).all() and (made.fine_faces == tube.fine_faces).all()
    assert made.body_digest == wearer.digest and made.digest == tailored_digest(tube, wearer)
    assert_allclose(made.rest_state().hinge_angle, tube.rest_state().hinge_angle, atol=1e-6)


@pytest.fixture(scope="module")
def narrow(body: BodyModel) -> BodyModel:
    """A body whose legs are nearer to each other, with a rig whose hips lie higher in it, and legs begin there."""
    legs = body.weights[:, LEGS["left"] + LEGS["right"]].sum(axis=1)
    vertices = body.v_template.copy()
    vertices[:, 0] *= 1.0 - 0.4 * legs
    joints = body.regressor @ vertices
    joints[[LEGS["left"][0], LEGS["right"][0]], 1] += 0.06
    weights = body.weights[nearest_vertices(vertices - [0.0, 0.06, 0.0], vertices)[1]]
    return BodyModel(
        "narrow", "narrow", vertices, np.zeros_like(body.shapedirs), _regressor(vertices, joints, body), weights,
        body.faces, standard_digest=body.digest,
    )  # fmt: skip


def legs_of(name: str, body: BodyModel, wearer: BodyModel) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """The side of each leg, and of the garment ``name`` cut for ``wearer`` the cloth [m] (n, 3) and the skin [m] (m, 3)
    from half its shin down to its ankle."""
    garment = shipped(name)
    made = tailored(garment, body, wearer).vertices
    bone = body.weights.argmax(axis=1)[nearest_vertices(garment.vertices, body.v_template)[1]]
    for side, bones in ((1.0, LEGS["left"]), (-1.0, LEGS["right"])):
        knee, ankle = wearer.joints_template[bones[1:3], 1]
        skin = wearer.v_template[body.weights[:, bones].sum(axis=1) > 0.5]
        cloth = made[np.isin(bone, bones)]
        cloth, skin = (one[(one[:, 1] > ankle) & (one[:, 1] < 0.5 * (knee + ankle))] for one in (cloth, skin))
        yield side, cloth, skin


def test_slim_trousers_lie_round_each_leg_wherever_a_rig_has_its_hips(body: BodyModel, narrow: BodyModel):
    """A wearer's regressor tells hips of the standard body elsewhere: trousers are no skirt for that."""
    for _, cloth, skin in legs_of("slim_trousers", body, narrow):
        middles = [0.5 * (points[:, 0].min() + points[:, 0].max()) for points in (cloth, skin)]
        assert abs(middles[0] - middles[1]) < 0.01


def test_wide_trousers_do_not_lie_over_the_other_leg(body: BodyModel, narrow: BodyModel):
    for side, cloth, _ in legs_of("trousers", body, narrow):
        assert (side * cloth[:, 0]).min() > 0.0


def test_trousers_end_above_shoes_and_skirts_stay(body: BodyModel, narrow: BodyModel):
    knee, ankle = (body.regressor @ narrow.v_template)[LEGS["left"][1:3], 1]
    for share in (1.0, 0.7):
        shoes_m = knee - share * (knee - ankle)
        made = tailored(shipped("slim_trousers"), body, narrow, shoes_m=shoes_m)
        assert shoes_m + 0.005 < made.vertices[:, 1].min() < shoes_m + 0.04  # and higher, as shins lean
    skirt = shipped("circle_skirt")
    standing, faces = skirt.vertices.astype(float), skirt.fine_faces.astype(int)
    assert above_shoes(standing, faces, body, narrow, float(knee)) is standing
