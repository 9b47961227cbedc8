"""Avatars by phenotype, SMPL parameters, mesh and name all arrive in correspondence with the standard body."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.errors import ArtifactError, BodyError, DrapeError, NotFound
from drape.garment import registration
from drape.garment.avatars import load_phenotypes, mesh_avatar, parse_avatar, phenotype_avatar, read_avatar, smpl_avatar
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import obj_text

BODY = load_body()
FEMALE = {"gender": 1.0, "age": 0.667, "muscle": 0.5, "weight": 0.5, "height": 0.5, "proportions": 0.5}


@pytest.mark.long
def test_phenotypes_equal_the_package_anny(rng: np.random.Generator):
    pytest.importorskip("anny", reason="The package anny is not installed: `make setup`.")
    from training.bake_avatars import rest_vertices
    from training.bake_body import sample_anny

    model, _ = sample_anny(1, 0)
    space = load_phenotypes()
    assert space.labels == tuple(model.phenotype_labels)
    low = np.array([row[0] for row in space.anchors])
    drawn = low + (1.0 - low) * rng.random((6, len(space.labels)))
    theirs = rest_vertices(model, drawn, np.unique(model.faces.numpy()))
    ours = np.stack([space.vertices(dict(zip(space.labels, row, strict=True))) for row in drawn])
    assert_allclose(ours, theirs, rtol=0, atol=2e-4)


def test_phenotype_is_interpolated_linearly_between_anchors():
    space = load_phenotypes()
    ends = [space.vertices({"height": value}) for value in (0.0, 1.0)]
    assert_allclose(space.vertices({"height": 0.25}), 0.75 * ends[0] + 0.25 * ends[1], rtol=0, atol=1e-12)
    assert np.ptp(ends[1][:, 1]) > np.ptp(ends[0][:, 1]) + 0.1


@pytest.mark.data
@pytest.mark.parametrize("prefix", ["female", "male"])
def test_phenotype_reproduces_the_avatar_in_the_data(prefix: str, data: Path):
    path = data / "garments" / f"avatar_{prefix}.obj"
    if not path.is_file():
        pytest.skip(f"No garments/avatar_{prefix}.obj in DRAPE_DATA: docs/guide/data.md says where to get it.")
    from_mesh = mesh_avatar(path, BODY)
    from_name = read_avatar(parse_avatar(prefix, beside=path), BODY)
    assert from_mesh.residual_mm == 0.0
    assert_allclose(from_mesh.vertices, from_name.vertices, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("phenotype", "message"),
    [
        ({"gender": 2.0}, "phenotype gender"),
        ({"age": 0.3}, "adults"),
        ({"weight": float("nan")}, "phenotype weight"),
        ({"weight": "heavy"}, "phenotype weight"),
        ({"weight": True}, "phenotype weight"),
        ({"weight": 10**400}, "phenotype weight"),
        ({"haircolour": 0.5}, "phenotype haircolour"),
    ],
)
def test_wrong_phenotype_is_refused(phenotype: dict, message: str):
    with pytest.raises(BodyError, match=message):
        phenotype_avatar(phenotype, BODY)


def test_smpl_parameters_pose_the_standard_body(rng: np.random.Generator):
    pose, betas = rng.normal(scale=0.3, size=(24, 3)), [0.5, -1.0]
    avatar = smpl_avatar({"pose": pose.tolist(), "betas": betas, "trans": [0, 1, 0]}, BODY)
    expected = BODY.posed_vertices(pose[None], np.array([[0.0, 1.0, 0.0]]), np.array(betas))[0]
    assert_allclose(avatar.vertices, expected, rtol=0, atol=1e-12)
    assert avatar.moved
    rest = smpl_avatar({"betas": []}, BODY)
    assert not rest.moved
    assert_allclose(rest.vertices, BODY.v_template, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    "parameters",
    [
        {"pose": [0.0] * 71},
        {"pose": "T"},
        {"betas": [float("inf")]},
        {"betas": [10**400]},
        {"betas": [-1e308]},
        {"trans": [1e300, 0, 0]},
        {"pose": [1e300] * 72},
        {"betas": [0.0] * 30},
        {"trans": [0, 0]},
        {"betas": [], "gender": 1.0},
        {"pose": [[0, 0], [0]]},
    ],
)
def test_wrong_smpl_parameters_are_refused(parameters: dict):
    with pytest.raises(BodyError):
        read_avatar(parameters, BODY)


def test_longest_name_in_the_table_wins(tmp_path: Path):
    table = {"female": FEMALE, "fem": {"gender": 0.9}, "own_": "standard"}
    (tmp_path / "avatars.json").write_text(json.dumps(table))
    assert parse_avatar(None, beside=tmp_path / "femme.obj") == {"gender": 0.9}
    assert parse_avatar(None, beside=tmp_path / "female_tshirt.obj") == FEMALE
    assert parse_avatar(None, beside=tmp_path / "own_dress.obj") == "standard"
    assert parse_avatar(None, beside=tmp_path / "other.obj") is None
    assert parse_avatar("female_", beside=tmp_path / "other.obj") == FEMALE


def test_avatar_is_told_as_text_file_or_dictionary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("DRAPE_DATA", raising=False)
    assert parse_avatar(FEMALE) == FEMALE
    assert parse_avatar(json.dumps(FEMALE)) == FEMALE
    assert parse_avatar("standard") == "standard"
    (tmp_path / "her.json").write_text(json.dumps(FEMALE))
    assert parse_avatar(tmp_path / "her.json") == FEMALE
    for wrong in ("{", "[1]", "nobody", str(tmp_path / "absent.obj")):
        with pytest.raises(DrapeError):
            parse_avatar(wrong)
    (tmp_path / "avatars.json").write_text(json.dumps({"female": FEMALE, "own": FEMALE}))
    with pytest.raises(NotFound, match="or one of female, own, male, got"):  # each name once
        parse_avatar("nobody", beside=tmp_path / "shirt.obj")


@pytest.mark.parametrize("text", ["{", "[]", '{"female": 3}'])
def test_broken_table_is_refused(text: str, tmp_path: Path):
    (tmp_path / "avatars.json").write_text(text)
    with pytest.raises(BodyError, match=r"avatars\.json"):
        parse_avatar(None, beside=tmp_path / "female_tshirt.obj")


def test_damaged_asset_is_refused(tmp_path: Path):
    (tmp_path / "avatars.npz").write_bytes(b"not an npz")
    with pytest.raises(ArtifactError, match="bake_avatars"):
        load_phenotypes(tmp_path / "avatars.npz")


def test_mesh_with_makehumans_vertices_is_taken_vertex_by_vertex(tmp_path: Path):
    named = phenotype_avatar({"gender": 0.3}, BODY)
    assert_array_equal(named.faces, BODY.faces)
    (tmp_path / "avatar.obj").write_bytes(obj_text(100.0 * named.vertices, BODY.faces))
    avatar = mesh_avatar(tmp_path / "avatar.obj", BODY)
    assert "MakeHuman" in avatar.source and "0.01" in avatar.source
    assert_allclose(avatar.vertices, named.vertices, rtol=0, atol=1e-6)


def test_other_mesh_is_registered(rng: np.random.Generator):
    """A body of other topology, shape and pose than ours: half the faces' midpoints are new vertices."""
    shape = phenotype_avatar({"gender": 0.8, "height": 0.3}, BODY).vertices
    order = rng.permutation(len(shape))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    fitted, residual = registration.register_body(shape[order], place[BODY.faces], BODY)
    assert residual < 3.0
    normals = meshes.vertex_normals(shape, BODY.faces)
    torso = BODY.weights[:, [JOINT_NAMES.index(n) for n in ("spine1", "spine2", "spine3", "left_elbow")]].sum(1) > 0.8
    off_surface = np.abs(np.einsum("vc,vc->v", fitted - shape, normals))[torso]
    assert np.quantile(off_surface, 0.95) < 0.006
    assert np.linalg.norm(fitted - shape, axis=1)[torso].mean() < 0.02


def test_unlike_body_is_refused(tmp_path: Path):
    with pytest.raises(BodyError, match="fits to 15 mm"):
        registration.register_body(*tube(40, 39, radius_m=0.4, height_m=1.8), BODY)
    flat = tube(40, 1, radius_m=0.4, height_m=0.05)
    with pytest.raises(BodyError, match="500 vertices"):
        registration.register_body(*flat, BODY)
    (tmp_path / "flat.obj").write_bytes(obj_text(*flat))
    with pytest.raises(BodyError, match="a person"):
        mesh_avatar(tmp_path / "flat.obj", BODY)
