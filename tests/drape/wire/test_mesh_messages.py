"""Meshes as bytes: seams and copies, and what is told in steps is off by 0.01 mm at most."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drape.wire import messages as wire
from drape.wire.mesh_messages import MESH_HEADER_BYTES, STEP_M, pack_body_mesh, pack_mesh

FACES = np.array([[0, 1, 2], [2, 1, 3]])
VERTICES = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 2.0, 0.0], [9.0, 9.0, 9.0]])


def whole(message: bytes, at: int, count: int, lag: int) -> np.ndarray:
    """The ``count`` numbers that begin at byte ``at``."""
    planes = np.frombuffer(message, np.uint8, 4 * count, at).reshape(4, count)
    code = np.ascontiguousarray(planes.T).view("<u4").reshape(-1).astype(np.int64)
    steps = (code >> 1) ^ -(code & 1)
    return np.concatenate([steps[start::lag].cumsum()[:, None] for start in range(lag)], axis=1).reshape(-1)


def fields(message: bytes, name: str) -> dict[str, float]:
    layout = wire.LAYOUTS[name]
    values = wire.record(layout).unpack_from(message)
    return {field: values[i] for i, (field, _, count) in enumerate(layout) if count == 1}


def test_a_vertex_comes_again_for_every_other_texture_coordinate():
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [5.0, 1.0], [6.0, 0.0], [6.0, 1.0]])
    message = pack_mesh(VERTICES, FACES, uv, np.array([[0, 1, 2], [3, 4, 5]]))
    said = fields(message, "MESH")
    assert (said["count"], said["copies"], said["triangles"], said["uv_metres"]) == (5, 2, 2, 2.0)
    at = MESH_HEADER_BYTES
    copies, index = whole(message, at, 2, 1), whole(message, at + 8, 6, 1)
    assert_array_equal(copies, [1, 2])
    assert_array_equal(index, [0, 1, 2, 6, 5, 3])
    coordinates = said["uv_step"] * whole(message, at + 32, 14, 2).reshape(-1, 2)
    assert np.abs(coordinates[index] - uv).max() * said["uv_metres"] <= 0.501 * STEP_M
    assert_array_equal(coordinates[4], 0.0)  # no triangle has it
    assert len(message) == at + 32 + 4 * 14


def test_without_texture_coordinates_there_are_triangles_alone():
    nothing = np.zeros((0, 2)), np.zeros((0, 3), int)
    message = pack_mesh(VERTICES, FACES, *nothing)
    assert fields(message, "MESH")["uv_step"] == 0.0
    assert_array_equal(whole(message, MESH_HEADER_BYTES, 6, 1), FACES.ravel())


@pytest.mark.parametrize("far", [0.0, 1e9])
def test_coordinates_that_are_all_the_same_or_far_away_are_kept_to_a_step(far: float):
    uv = np.full((4, 2), 0.25) if far == 0.0 else np.array([[far, 0.0], [far + 1e4, 0.0], [far, 1e4], [far + 1e4, 1e4]])
    message = pack_mesh(VERTICES, FACES, uv, FACES)
    said = fields(message, "MESH")
    coordinates = said["uv_step"] * whole(message, MESH_HEADER_BYTES + 24, 10, 2).reshape(-1, 2)
    assert np.abs(coordinates[:4] - uv).max() <= 0.501 * said["uv_step"]
    assert (said["uv_metres"] == 0.0) == (far == 0.0)


def test_a_body_is_its_places_bones_and_weights(rng):
    joints, bones = rng.normal(size=(24, 3)), rng.integers(0, 24, (5, 4)).astype(np.uint8)
    weights = -np.sort(-rng.dirichlet(np.ones(4), 5), axis=1)
    message = pack_body_mesh(VERTICES, FACES, joints, bones, weights)
    said = fields(message, "BODY")
    at = wire.record(wire.LAYOUTS["BODY"]).size
    assert_array_equal(whole(message, at, 6, 1), FACES.ravel())
    places = said["step_m"] * whole(message, at + 24, 15, 3)
    assert np.abs(places - VERTICES.ravel()).max() <= 0.501 * STEP_M
    assert_array_equal(whole(message, at + 84, 20, 4), bones.ravel())
    others = said["weight_step"] * whole(message, at + 164, 15, 3).reshape(5, 3)
    assert np.abs(others - weights[:, 1:]).max() <= 0.5 * said["weight_step"]
    assert len(message) == at + 4 * (6 + 15 + 20 + 15)
