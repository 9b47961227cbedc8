"""Bodies in a garment's file: alone they are refused in words, with a garment they are left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.garment.body_pieces import without_bodies
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake import intake
from drape.garment.registration import posed_by
from drape.garment.wearer_fields import known_parameters
from drape.geometry import meshes
from tests.drape.garment.garment_files import obj_text, shirt, skirt

BODY = load_body()
SKIN = posed_by(BODY, known_parameters(BODY, "man", 0.6, 0.3))  # arms as no known body has them
SHIRT = shirt(BODY, SKIN)
Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
SIDEWAYS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def ball(middle: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """An octahedron, subdivided twice."""
    vertices = np.concatenate([np.eye(3), -np.eye(3)])
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]])
    for _ in range(2):
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    return middle + radius * vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces


def file_of(*pieces: tuple[np.ndarray, np.ndarray]) -> GarmentMesh:
    return plain_mesh("file", *in_one(*pieces))


def in_one(*pieces: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    before = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [faces + start for (_, faces), start in zip(pieces, before, strict=False)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


@pytest.mark.parametrize(("turn", "scale"), [(np.eye(3), 1.0), (Z_UP, 100.0), (SIDEWAYS, 39.37), (-np.eye(3), 1.0)])
def test_a_body_alone_is_refused_as_a_body(turn, scale):
    mesh = plain_mesh("body", scale * SKIN @ turn.T, BODY.faces)
    with pytest.raises(MeshError, match="looks like a body") as refused:
        without_bodies(mesh, BODY)
    assert "without the body" in refused.value.cure


def test_a_body_in_pieces_of_texture_is_a_body():
    split = plain_mesh("body", SKIN[BODY.faces].reshape(-1, 3), np.arange(3 * len(BODY.faces)).reshape(-1, 3))
    with pytest.raises(MeshError, match="looks like a body"):
        without_bodies(split, BODY)


@pytest.mark.parametrize(("turn", "scale"), [(np.eye(3), 1.0), (Z_UP, 100.0)])
def test_a_garment_on_its_body_is_kept_without_the_body_and_its_eyes(turn, scale):
    head = SKIN[BODY.weights.argmax(axis=1) == JOINT_NAMES.index("head")]
    eye = ball(0.5 * (head.min(axis=0) + head.max(axis=0)), 0.012)
    button = ball(SHIRT[0][SHIRT[0][:, 2].argmax()] + [0.0, 0.0, 0.006], 0.006)
    mesh = file_of((SKIN, BODY.faces), SHIRT, eye, button)
    kept = without_bodies(replace(mesh, vertices=scale * mesh.vertices @ turn.T), BODY)
    alone = file_of(SHIRT, button)
    np.testing.assert_array_equal(kept.faces, alone.faces)
    np.testing.assert_allclose(kept.vertices, scale * alone.vertices @ turn.T, rtol=1e-12)
    assert f"looks like a body is left out, {len(BODY.faces) + len(eye[1]):,} faces" in kept.notes[-1]


def walls(vertices: np.ndarray, faces: np.ndarray, thickness_m: float) -> tuple[np.ndarray, np.ndarray]:
    """The garment as a closed solid, as tools that give cloth a thickness write it."""
    count, rim = len(vertices), meshes.boundary_edges(faces)
    inner = vertices - thickness_m * meshes.vertex_normals(vertices, faces)
    sides = np.concatenate([np.c_[rim, rim[:, 1] + count], np.c_[rim[:, 0], rim + count][:, [0, 2, 1]]])
    return np.concatenate([vertices, inner]), np.concatenate([faces, faces[:, ::-1] + count, sides[:, ::-1]])


def test_garments_are_no_bodies():
    ball_m = ball(np.zeros(3), 0.3)
    for piece in (SHIRT, skirt(BODY), walls(*SHIRT, 0.004), ball_m):
        mesh = file_of(piece)
        assert without_bodies(mesh, BODY) is mesh


def test_an_intake_takes_the_garment_from_its_body():
    whole = in_one((SKIN, BODY.faces), SHIRT)
    made = intake(obj_text(*whole), name="shirt", kind="obj")
    assert len(made.vertices) >= len(SHIRT[0])
    assert len(made.faces) == len(SHIRT[1])
    assert any("looks like a body" in note for note in made.manifest["notes"])
