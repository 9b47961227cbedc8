"""The features of a fabric: they turn with the grain, and tell cloths apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth import rest_state
from drape.cloth.fabric import Fabric
from drape.cloth.fabric_table import fabric
from drape.errors import ArtifactError
from drape.garment.fabric_features import (
    FABRIC_COUNT,
    encoder_features,
    fabric_features,
    patch_grain,
    rest_grain,
    warp_directions,
)
from drape.geometry import meshes
from tests.fixtures.cut_garments import cut_garment
from tests.fixtures.garments import shipped

DENIM = fabric("denim")
EVEN = Fabric("even", 300.0, 300.0, 75.0, 450.0, 1e-5, 1e-5, 1e-5, 0.2)  # alike all ways
GRAIN = np.array([[1.0, 0.0], [0.0, 1.0], [-0.6, 0.8], [0.1, 0.0]])


def test_grain_says_nothing_of_a_cloth_that_is_alike_all_ways():
    stretched = replace(EVEN, shear_n_per_m=400.0)  # four thirds of the stretch: the reference
    rows = fabric_features(stretched, GRAIN)
    assert_array_equal(rows, np.broadcast_to(rows[:1], rows.shape))


def test_a_quarter_turn_of_the_grain_is_warp_and_weft_exchanged():
    turned = replace(
        DENIM,
        warp_n_per_m=DENIM.weft_n_per_m,
        weft_n_per_m=DENIM.warp_n_per_m,
        bending_warp_j=DENIM.bending_weft_j,
        bending_weft_j=DENIM.bending_warp_j,
    )
    assert_allclose(fabric_features(DENIM, GRAIN), fabric_features(turned, -GRAIN), rtol=1e-6, atol=1e-6)


NUMBERS = [name for name in vars(DENIM) if name.endswith(("_per_m", "_j", "_m2"))]


@pytest.mark.parametrize("field", NUMBERS)
def test_every_number_of_a_fabric_is_told(field: str):
    other = replace(DENIM, **{field: 1.1 * getattr(DENIM, field)})
    assert np.abs(fabric_features(other, GRAIN) - fabric_features(DENIM, GRAIN)).max() > 1e-3


def test_patches_see_the_warp_of_their_own_triangles():
    shirt = cut_garment("tank")  # without panels the warp is the vertical
    vertices, faces = shirt.vertices.astype(np.float64), shirt.fine_faces.astype(np.int64)
    upright = rest_state.grain_along(vertices, faces)
    grain = rest_grain(shirt)
    assert_allclose(patch_grain(shirt, vertices, faces, -upright), grain, rtol=0, atol=1e-6)
    across = np.cross(meshes.face_normals(vertices, faces), upright)
    # Triangles that tilt in a patch are seen shortened, their warp more or less than their weft.
    assert np.abs(patch_grain(shirt, vertices, faces, across) + grain).mean() < 0.05
    length = np.linalg.norm(grain, axis=1)
    assert length.max() <= 1.0 + 1e-6 and np.median(length) > 0.95
    # On a patch that stands upright, the angle is that of the vertical in its frame.
    frame = shirt.patch_rotation.astype(np.float64)
    standing = np.abs(frame[:, 1, 2]) < 0.2
    angle = np.arctan2(frame[:, 1, 1], frame[:, 1, 0])
    wanted = np.stack([np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=1)
    assert np.abs(grain - wanted)[standing].mean() < 0.1


def test_the_warp_of_a_rest_state_is_where_it_was_laid():
    shirt = shipped("tank")
    vertices, faces = shirt.vertices.astype(np.float64), shirt.fine_faces.astype(np.int64)
    warp = rest_state.grain_along(vertices, faces, (0.3, 1.0, 0.2))
    found = warp_directions(rest_state.flat_rest(vertices, faces, warp), vertices, faces)
    assert_allclose(found, warp, rtol=0, atol=1e-9)


def test_encoders_from_before_fabrics_read_nothing_of_them():
    shirt = shipped("tank")
    width = shirt.patch_features.shape[1]
    assert_array_equal(encoder_features(shirt, width, DENIM), shirt.patch_features)
    with_fabric = encoder_features(shirt, width + FABRIC_COUNT, DENIM)
    assert_array_equal(with_fabric[:, width:], fabric_features(DENIM, rest_grain(shirt)))
    own = encoder_features(shirt, width + FABRIC_COUNT, fabric("rib"))
    assert_array_equal(encoder_features(shirt, width + FABRIC_COUNT), own)
    with pytest.raises(ArtifactError, match="patch_features: expected 9 numbers"):
        encoder_features(shirt, 9)
