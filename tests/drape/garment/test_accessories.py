"""What one bone carries is told from cloth: hats and shoes from hoods, socks, gloves and shirts."""

from __future__ import annotations

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.accessories import accessory_of
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.geometry import meshes

BODY = load_body()
BONE = BODY.weights.argmax(axis=1)


def over(chosen: np.ndarray, *gaps_m: float) -> GarmentMesh:
    """Walls ``gaps_m`` over the skin (V,) that is ``chosen``."""
    faces = BODY.faces[chosen[BODY.faces].all(axis=1)]
    normals = meshes.vertex_normals(BODY.v_template, BODY.faces)
    walls = [BODY.v_template + gap_m * normals for gap_m in gaps_m]
    used, inverse = np.unique(faces, return_inverse=True)
    vertices = np.concatenate([wall[used] for wall in walls])
    return plain_mesh(
        "piece", vertices, np.concatenate([inverse.reshape(-1, 3) + n * len(used) for n in range(len(walls))])
    )


def of(*names: str) -> np.ndarray:
    return np.isin(BONE, [JOINT_NAMES.index(name) for name in names])


HAT = of("head") & (BODY.v_template[:, 1] > BODY.joints_template[JOINT_NAMES.index("head"), 1] + 0.1)
FOOT, HAND = of("left_ankle", "left_foot"), of("right_wrist", "right_hand")


@pytest.mark.parametrize(
    ("mesh", "bone"),
    [
        (over(HAT, 0.01), "head"),
        (over(of("head", "neck"), 0.01), None),
        (over(FOOT, 0.004, 0.012), "left_ankle"),
        (over(FOOT, 0.012), "left_ankle"),
        (over(FOOT, 0.004), None),
        (over(HAND, 0.004), None),
        (over(of("spine1", "spine2", "spine3"), 0.01), None),
    ],
    ids=["hat", "hood", "shoe", "shoe of one wall", "sock", "glove", "top"],
)
def test_bone_that_carries_is_found_and_cloth_has_none(mesh: GarmentMesh, bone: str | None):
    assert accessory_of(mesh, BODY.v_template, BODY) == bone


def test_an_opening_round_the_neck_makes_a_hood():
    neck = BODY.joints_template[JOINT_NAMES.index("head"), 1] - 0.06
    hood = of("head") | (of("neck") & (BODY.v_template[:, 1] > neck - 0.02) & (BODY.v_template[:, 2] < -10.0))
    low = over(hood, 0.01)
    stretched = np.where(low.vertices[:, 1:2] < neck + 0.06, low.vertices - [0.0, 0.08, 0.0], low.vertices)
    assert accessory_of(plain_mesh("hood", stretched, low.faces), BODY.v_template, BODY) is None
