"""What one bone carries is told from cloth: hats and shoes from hoods, socks, gloves and shirts."""

from __future__ import annotations

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.accessories import accessory_of, carriers_of
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
ANKLE_M = float(BODY.joints_template[JOINT_NAMES.index("left_ankle"), 1])
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


@pytest.mark.parametrize(
    ("shaft_m", "gap_m", "bones"), [(0.06, 0.02, ("left_ankle",)), (0.06, 0.004, ()), (0.3, 0.02, ())]
)
def test_an_open_boot_is_carried_and_a_sock_or_a_long_shaft_is_not(
    shaft_m: float, gap_m: float, bones: tuple[str, ...]
):
    """A boot was draped as cloth, since it is open at the top."""
    leg = FOOT | (of("left_knee") & (BODY.v_template[:, 1] < ANKLE_M + shaft_m))
    assert carriers_of(over(leg, gap_m), BODY.v_template, BODY) == bones


def test_a_sock_for_another_foot_is_no_shoe():
    """It stood off this one, and went through it elsewhere."""
    sock = over(FOOT, 0.004)
    larger = plain_mesh(
        "sock", (sock.vertices - BODY.joints_template[7]) * [1.0, 1.3, 0.8] + BODY.joints_template[7], sock.faces
    )
    assert carriers_of(larger, BODY.v_template, BODY) == ()


def test_a_shoe_with_a_heel_is_carried_with_its_insole_and_a_stocking_is_not():
    """High heels were draped as cloth, since their heels are nearer to the shank."""
    leg = of("left_ankle", "left_foot") | (of("left_knee") & (BODY.v_template[:, 1] < ANKLE_M + 0.05))
    upper, insole, stocking = over(leg, 0.02), over(FOOT, 0.004), over(leg, 0.004)
    closed = closed_at_rims(upper)
    shoe = plain_mesh(
        "shoe",
        np.concatenate([closed.vertices, insole.vertices]),
        np.concatenate([closed.faces, insole.faces + len(closed.vertices)]),
    )
    assert carriers_of(shoe, BODY.v_template, BODY) == ("left_ankle",)
    assert carriers_of(stocking, BODY.v_template, BODY) == ()


def closed_at_rims(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` with its openings closed by fans of faces."""
    vertices, faces = [mesh.vertices], [mesh.faces]
    for number, loop in enumerate(meshes.boundary_loops(mesh.faces)):
        vertices.append(mesh.vertices[loop].mean(axis=0)[None])
        middle = np.full(len(loop), len(mesh.vertices) + number)
        faces.append(np.stack([loop, np.roll(loop, -1), middle], axis=1))
    return plain_mesh(mesh.name, np.concatenate(vertices), np.concatenate(faces))
