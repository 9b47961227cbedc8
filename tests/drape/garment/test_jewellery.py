"""Jewellery and watches: which bone carries them, in which reading of a file they lie on a body, and what is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.errors import MeshError
from drape.garment.accessories import carried_rows
from drape.garment.avatars import standard_avatar
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake import intake_mesh
from drape.garment.intake_options import DEFAULT_OPTIONS
from drape.garment.jewellery import check_cloth, jewellery_on, jewellery_wearer
from drape.garment.mesh_checks import place_on_avatar
from drape.garment.registration import posed_by
from drape.garment.unnamed_avatar import worn_by
from drape.garment.wearer_fields import known_parameters
from drape.garment.wearer_reading import Reading
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import shirt

BODY = load_body()
BONE = BODY.weights.argmax(axis=1)
SKIN = BODY.v_template
WOMAN = posed_by(BODY, known_parameters(BODY, "woman", 0.8, 0.0))
TUBE_M = 0.004
PENDANTS = (
    np.concatenate([np.eye(3), -np.eye(3)]),
    np.array([[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]),
)


def joint(skin: np.ndarray, name: str) -> np.ndarray:
    return (BODY.regressor @ skin)[JOINT_NAMES.index(name)]


def hoop(skin: np.ndarray, start: str, end: str, share: float) -> GarmentMesh:
    """A hoop of ``TUBE_M`` round the limb between two joints, at a ``share`` of the way, just over the skin."""
    axis = joint(skin, end) - joint(skin, start)
    middle = joint(skin, start) + share * axis
    axis /= np.linalg.norm(axis)
    near = skin[(np.abs((skin - middle) @ axis) < 0.008) & (np.linalg.norm(skin - middle, axis=1) < 0.075)]
    middle = middle + (near - middle).mean(axis=0) - ((near - middle).mean(axis=0) @ axis) * axis
    radius = np.median(np.linalg.norm(near - middle, axis=1)) + TUBE_M
    across = np.linalg.svd(axis[None])[2][1:]
    turn, round_ = (2.0 * np.pi / count * np.arange(count) for count in (32, 6))
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1) @ across
    wide = radius + TUBE_M * np.cos(round_)[:, None, None]
    points = middle + wide * out + TUBE_M * np.sin(round_)[:, None, None] * axis
    row, column = (one.reshape(-1) for one in np.meshgrid(np.arange(6), np.arange(32), indexing="ij"))
    a, b = 32 * row + column, 32 * row + (column + 1) % 32
    c, d = 32 * ((row + 1) % 6) + column, 32 * ((row + 1) % 6) + (column + 1) % 32
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    return plain_mesh("hoop", points.reshape(-1, 3), faces)


def pearls(at: np.ndarray) -> GarmentMesh:
    points = at[:, None] + 0.004 * PENDANTS[0]
    return plain_mesh("pearls", points.reshape(-1, 3), np.concatenate([PENDANTS[1] + 6 * n for n in range(len(at))]))


def worn_at(mesh: GarmentMesh, skin: np.ndarray, reading: Reading, origin: str) -> GarmentMesh:
    """``mesh`` as a file of that ``reading`` has it, its origin at the root or on the floor."""
    rise = skin[:, 1].min() if origin == "floor" else 0.0
    return replace(mesh, vertices=(mesh.vertices - [0.0, rise, 0.0]) @ reading.turn / reading.scale)


BANGLE = hoop(SKIN, "left_elbow", "left_wrist", 0.85)
CASES = [
    (("left_elbow", "left_wrist", 0.85), Reading("cm", 0.01, "+y", "+z"), "floor", ("left_elbow",)),
    (("right_elbow", "right_wrist", 0.8), Reading("dm", 0.1, "+z", "-y"), "root", ("right_elbow",)),
    (("neck", "head", 0.3), Reading("inch", 0.0254, "+y", "+z"), "floor", ("neck",)),
]


@pytest.mark.parametrize(("limb", "reading", "origin", "bones"), CASES, ids=["bangle", "watch", "choker"])
def test_what_lies_on_the_skin_in_its_file_tells_unit_axes_and_bone(
    limb: tuple[str, str, float], reading: Reading, origin: str, bones: tuple[str, ...]
):
    """They were refused, or put on a head."""
    mesh = hoop(WOMAN, *limb)
    found = jewellery_wearer(worn_at(mesh, WOMAN, reading, origin), BODY)
    assert found is not None and (found.reading, found.origin) == (reading, origin)
    placed = replace(mesh, vertices=found.reading.apply(worn_at(mesh, WOMAN, reading, origin).vertices))
    assert jewellery_on(placed, posed_by(BODY, found.parameters), BODY) == bones


def test_a_bangle_is_carried_by_its_forearm_and_drawn_as_it_came():
    garment = intake_mesh(BANGLE, BODY, digest="0" * 64)
    assert garment.carriers == ("left_elbow",) and len(garment.surface.faces) == len(BANGLE.faces)


def test_on_a_body_that_is_named_it_may_be_small():
    """A garment had 10 cm at least."""
    ring = replace(BANGLE, vertices=1000.0 * BANGLE.vertices)
    np.testing.assert_allclose(
        place_on_avatar(ring, standard_avatar(BODY)).vertices, BANGLE.vertices, rtol=0, atol=1e-9
    )


def test_a_necklace_goes_with_the_chest_though_half_of_it_lies_on_the_neck():
    low = joint(SKIN, "neck")[1]
    near = np.flatnonzero(np.isin(BONE, [JOINT_NAMES.index(name) for name in ("neck", "spine3", "left_collar")]))
    chain = SKIN[near[np.argsort(np.abs(SKIN[near, 1] - low))[:60]]]
    assert jewellery_on(pearls(chain), SKIN, BODY) == ("spine3",)
    assert jewellery_on(pearls(chain + 0.3), SKIN, BODY) == ()
    assert jewellery_on(plain_mesh("shirt", *shirt(BODY, SKIN)), SKIN, BODY) == ()


def test_a_bangle_beside_a_ring_goes_with_its_forearm():
    """It was nearer to the joint of the wrist, and would turn with the hand."""
    rows = carried_rows(BANGLE.vertices, BANGLE.faces, BODY.joints_template, ("left_wrist", "left_elbow"))
    assert set(rows) == {JOINT_NAMES.index("left_elbow")}


def test_a_ring_anywhere_is_refused_in_words_and_cloth_is_not():
    """A bangle was carried by the head of somebody who was found in inches."""
    middle = BANGLE.vertices.mean(axis=0)
    with pytest.raises(MeshError, match="a ring, a chain or a bangle"):
        worn_by(replace(BANGLE, vertices=100.0 * (BANGLE.vertices - middle)), BODY, DEFAULT_OPTIONS)
    vertices, faces = shirt(BODY, SKIN)
    check_cloth(plain_mesh("shirt", vertices, faces))
    unit, walls = tube(24, 12, radius_m=0.2, height_m=0.5)
    inner = unit * [0.95, 1.0, 0.95]
    rims = [loop for loop in meshes.boundary_loops(walls)]
    strips = [np.stack([one, np.roll(one, -1), one + len(unit)], axis=1) for one in rims]
    strips += [np.stack([np.roll(one, -1), np.roll(one, -1) + len(unit), one + len(unit)], axis=1) for one in rims]
    check_cloth(
        plain_mesh("wall", np.concatenate([unit, inner]), np.concatenate([walls, walls[:, ::-1] + len(unit), *strips]))
    )


@pytest.mark.parametrize("unit_m", [0.001, 0.0254, 0.1])
def test_a_shirt_is_none_in_any_unit(unit_m: float):
    vertices, faces = shirt(BODY, WOMAN)
    for rise in (0.0, WOMAN[:, 1].min()):
        assert jewellery_wearer(plain_mesh("shirt", (vertices - [0.0, rise, 0.0]) / unit_m, faces), BODY) is None
