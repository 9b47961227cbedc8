"""A frame of tier exact: cloth at rest that is apart, from a start that passes through itself or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.errors import MeshError
from drape.exact import frame
from drape.exact.frame import ExactCloth, RestingFrame, exact
from drape.exact.path import WAY_M, Body, follow, pose_between, poses_between
from drape.garment.cache import Garment
from drape.geometry.triangle_pairs import crossing_pairs

POSE = np.zeros((24, 3))
POSE[3] = [0.0, 0.0, 0.15]  # the trunk leans


@pytest.fixture(scope="module")
def sheet(tube: Garment, body: BodyModel) -> ExactCloth:
    betas = np.zeros(body.shape_count)
    return ExactCloth.of(tube, fabric("jersey"), body, betas, tube.vertices - body.rest_joints(betas)[0])


def tangled(sheet: ExactCloth, x: np.ndarray) -> np.ndarray:
    """``x`` (V, 3) with one vertex pushed through the triangle that is farthest up from it among those beside it."""
    x = x.copy()
    vertex = int(x[:, 1].argmin())
    middle = x[sheet.faces].mean(axis=1)
    away = np.linalg.norm(middle[:, [0, 2]] - x[vertex, [0, 2]], axis=1) + np.abs(middle[:, 1] - x[vertex, 1] - 0.08)
    face = sheet.faces[int(away.argmin())]
    normal = np.cross(x[face[1]] - x[face[0]], x[face[2]] - x[face[0]])
    x[vertex] = x[face].mean(axis=0) + 0.004 * normal / np.linalg.norm(normal)
    for ring in sheet.faces[(sheet.faces == vertex).any(axis=1)]:
        for other in ring[ring != vertex]:
            x[other] = x[face].mean(axis=0) - 0.03 * normal / np.linalg.norm(normal) + 0.3 * (x[other] - x[vertex])
    return x


def test_a_start_that_is_apart_comes_to_rest(sheet: ExactCloth):
    lain, told = exact(sheet, np.zeros((24, 3)), sheet.rest)
    assert told.start_crossings == told.crossings == 0 and told.force_share <= 0.01
    assert told.energy_j < told.start_j and 0 < told.steps < 100
    assert_array_equal(lain.x.astype(np.float32), lain.x)  # what is stored is what the next frame comes from


def test_a_start_that_crosses_comes_to_rest_apart(sheet: ExactCloth):
    start = tangled(sheet, sheet.body.carry(sheet.rest, np.zeros((24, 3)), POSE))
    lain, told = exact(sheet, POSE, start)
    assert told.start_crossings > 0 and told.crossings == 0 and told.force_share <= 0.01
    assert len(crossing_pairs(lain.x, sheet.faces)) == 0
    again, _ = exact(sheet, POSE, start)
    assert_array_equal(again.x, lain.x)
    near, told = exact(sheet, POSE, start, RestingFrame(POSE, lain.x, start))
    assert told.crossings == 0 and np.linalg.norm(near.x - lain.x, axis=1).mean() < 0.01


def test_no_frame_ends_above_its_start(sheet: ExactCloth, monkeypatch: pytest.MonkeyPatch):
    start = tangled(sheet, sheet.body.carry(sheet.rest, np.zeros((24, 3)), POSE))
    monkeypatch.setattr(frame, "lead", lambda *_: 2.0 * sheet.rest)  # a way that leads astray
    monkeypatch.setattr(frame, "draw_to", lambda cloth, contact, posed, x, goal, band: x)
    monkeypatch.setattr(frame, "STEPS", 1)
    _, told = exact(sheet, POSE, start)
    assert told.energy_j <= told.start_j and told.start_crossings > 0


def test_a_frame_comes_from_the_one_before_it_unless_only_that_crosses(
    sheet: ExactCloth, monkeypatch: pytest.MonkeyPatch
):
    start = sheet.body.carry(sheet.rest, np.zeros((24, 3)), POSE)
    wrong, came = tangled(sheet, sheet.rest), []

    def follow(cloth, contact, body, x, motion, ends) -> np.ndarray:
        came.append(x)
        assert_allclose(motion, start - sheet.rest)
        return x + motion

    monkeypatch.setattr(frame, "follow", follow)
    monkeypatch.setattr(frame, "STEPS", 1)
    exact(sheet, POSE, start, RestingFrame(np.zeros((24, 3)), sheet.rest, sheet.rest))
    exact(sheet, POSE, start, RestingFrame(np.zeros((24, 3)), wrong, sheet.rest))
    assert len(came) == 1 and came[0] is sheet.rest


def test_cloth_follows_the_motion_that_it_is_given(sheet: ExactCloth):
    motion = np.zeros_like(sheet.rest)
    motion[:, 1] = np.where(sheet.rest[:, 1] < np.median(sheet.rest[:, 1]), -0.004, 0.0)
    still = np.zeros((24, 3))
    x = follow(sheet.cloth, sheet.contact, sheet.body, sheet.rest, motion, (still, still))
    off = np.linalg.norm(x - sheet.rest - motion, axis=1)
    assert (off < 1e-6).mean() > 0.9  # all but what lies in the skin


def test_cloth_that_crosses_at_rest_and_numbers_that_are_none_are_refused(
    sheet: ExactCloth, tube: Garment, body: BodyModel
):
    wrong = tangled(sheet, tube.vertices.astype(np.float64))
    betas = np.zeros(body.shape_count)
    with pytest.raises(MeshError, match=r"pairs of triangles that cross.*tier accurate"):
        ExactCloth.of(replace(tube, vertices=wrong.astype(np.float32)), fabric("jersey"), body, betas, wrong)
    with pytest.raises(MeshError, match="start of a frame"):
        exact(sheet, POSE, np.full_like(sheet.rest, np.nan))


def test_points_on_the_skin_go_with_it(body: BodyModel, rng: np.random.Generator):
    one = Body(body, rng.normal(scale=0.5, size=body.shape_count))
    other = 0.2 * rng.normal(size=(24, 3))
    assert_allclose(one.carry(one.posed(POSE), POSE, other), one.posed(other), atol=1e-9)


def test_poses_on_the_way_are_near_to_each_other(body: BodyModel):
    one, far = Body(body, np.zeros(body.shape_count)), np.zeros((24, 3))
    far[16] = [0.0, 0.0, -1.2]
    pairs = list(poses_between(one, one.posed(np.zeros((24, 3))), np.zeros((24, 3)), far))
    assert_allclose(pairs[0][0], 0.0, atol=1e-12)
    assert_allclose(pairs[-1][1], far, atol=1e-9)
    assert all(np.linalg.norm(one.posed(b) - one.posed(a), axis=1).max() < 1.2 * WAY_M for a, b in pairs)
    assert_allclose(pose_between(POSE, POSE, 0.5), POSE, atol=1e-12)
