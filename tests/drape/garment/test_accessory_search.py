"""Glasses, hats and shoes from files with nothing said: their unit and axes, and where they sit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.accessories import carriers_of
from drape.garment.accessory_search import accessory_wearer, seated
from drape.garment.avatars import standard_avatar
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake import intake_mesh
from drape.garment.mesh_checks import UNITS_M
from drape.garment.reading_hints import ReadingHints
from drape.garment.registration import posed_by
from drape.garment.seats import are_glasses
from drape.garment.wearer_fields import known_parameters
from drape.garment.wearer_reading import Reading, WearerCandidate
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import tube
from tests.drape.garment.garment_files import at_rest, shirt

BODY = load_body()
BONE = BODY.weights.argmax(axis=1)
WOMAN = posed_by(BODY, known_parameters(BODY, "woman", 0.8, 0.0))


def head_of(skin: np.ndarray) -> np.ndarray:
    return skin[JOINT_NAMES.index("head") == BONE]


def nose_of(skin: np.ndarray) -> np.ndarray:
    return head_of(skin)[head_of(skin)[:, 2].argmax()]


def glasses(skin: np.ndarray) -> GarmentMesh:
    """Two rings before the eyes and two bars to the ears."""
    ring, ring_faces = tube(24, 3, radius_m=1.0, height_m=1.0)
    bar, bar_faces = tube(6, 8, radius_m=0.002, height_m=0.13)
    rings = [ring[:, [0, 2, 1]] * [0.024, 0.018, 0.004] + [x, 0.0, -0.004] for x in (-0.033, 0.033)]
    bars = [bar[:, [0, 2, 1]] * [1.0, 1.0, -1.0] + [x, 0.01, 0.0] for x in (-0.066, 0.066)]
    return together(
        [*((one, ring_faces) for one in rings), *((one, bar_faces) for one in bars)],
        nose_of(skin) + np.array([0.0, 0.034, 0.0]),
    )


def hat(skin: np.ndarray) -> GarmentMesh:
    """A cylinder on the forehead with a brim, closed above."""
    head = head_of(skin)
    nose = nose_of(skin)
    near = head[np.abs(head[:, 1] - nose[1] - 0.08) < 0.01]
    middle, half = 0.5 * (near.min(axis=0) + near.max(axis=0)), 0.5 * np.ptp(near, axis=0) + 0.008
    unit, faces = tube(32, 8, radius_m=1.0, height_m=1.0)
    row = np.rint(unit[:, 1] * (len(np.unique(unit[:, 1])) - 1)).astype(int)
    wide = np.array([1.7, 1.3, 1.0, 1.0, 1.0, 1.0, 0.98, 0.9, 0.4, 0.02])
    high = np.array([0.0, 0.0, 0.0, 0.03, 0.06, 0.09, 0.12, 0.13, 0.13, 0.13])
    points = np.stack(
        [unit[:, 0] * half[0] * wide[row], high[row] + nose[1] + 0.075, unit[:, 2] * half[2] * wide[row]], axis=1
    )
    return plain_mesh("hat", points + middle * [1.0, 0.0, 1.0], faces)


def shoe(skin: np.ndarray, side: str) -> GarmentMesh:
    """An upper 12 mm off a foot, and a level sole below it."""
    own = np.isin(BONE, [JOINT_NAMES.index(f"{side}_{name}") for name in ("ankle", "foot")])
    faces = BODY.faces[own[BODY.faces].all(axis=1)]
    used, inverse = np.unique(faces, return_inverse=True)
    upper = (skin + 0.012 * meshes.vertex_normals(skin, BODY.faces))[used]
    low, high = upper.min(axis=0), upper.max(axis=0)
    box, box_faces = tube(24, 5, radius_m=1.0, height_m=1.0)
    row = np.rint(box[:, 1] * (len(np.unique(box[:, 1])) - 1)).astype(int)
    wide, rise = np.array([0.02, 1, 1, 1, 1, 1, 0.02])[row], np.array([0, 0, 0.3, 0.6, 0.9, 1, 1])[row]
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    sole = np.stack(
        [box[:, 0] * half[0] * wide + middle[0], low[1] - 0.012 + 0.01 * rise, box[:, 2] * half[2] * wide + middle[2]],
        axis=1,
    )
    return together([(upper, inverse.reshape(-1, 3)), (sole, box_faces)], np.zeros(3))


def together(parts: list[tuple[np.ndarray, np.ndarray]], at: np.ndarray) -> GarmentMesh:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([own + start for (_, own), start in zip(parts, starts, strict=False)])
    return plain_mesh("thing", np.concatenate([vertices for vertices, _ in parts]) + at, faces)


def both_shoes(skin: np.ndarray) -> GarmentMesh:
    pair = [shoe(skin, side) for side in ("left", "right")]
    return together([(one.vertices, one.faces) for one in pair], np.zeros(3))


THINGS: dict[str, tuple[Callable[[np.ndarray], GarmentMesh], tuple[str, ...]]] = {
    "glasses": (glasses, ("head",)),
    "hat": (hat, ("head",)),
    "a left shoe": (lambda skin: shoe(skin, "left"), ("left_ankle",)),
    "shoes": (both_shoes, ("left_ankle", "right_ankle")),
}
READINGS = [("dm", "+y", "+z", "root"), ("inch", "+z", "-y", "floor")]


@pytest.mark.parametrize("thing", THINGS)
@pytest.mark.parametrize(("unit", "up", "front", "origin"), READINGS)
def test_a_thing_at_its_place_in_the_file_tells_unit_and_axes(thing: str, unit: str, up: str, front: str, origin: str):
    reading = Reading(unit, {"dm": 0.1, "inch": 0.0254}[unit], up, front)
    mesh = THINGS[thing][0](WOMAN)
    rise = WOMAN[:, 1].min() if origin == "floor" else 0.0
    found = accessory_wearer(
        replace(mesh, vertices=(mesh.vertices - [0.0, rise, 0.0]) @ reading.turn / reading.scale), BODY
    )
    assert found is not None and (found.reading, found.origin) == (reading, origin)


def hood(skin: np.ndarray) -> GarmentMesh:
    """A dome over the head and a tube to the neck, open before the face and below."""
    head = head_of(skin)
    unit, faces = tube(40, 14, radius_m=1.0, height_m=1.0)
    down = 3.0 * unit[:, 1:2]  # [rad] from the crown to the ears, and straight on
    dome, half = np.minimum(down, 0.5 * np.pi), 0.5 * np.ptp(head, axis=0) + 0.03
    points = np.sin(dome) * unit * [1.0, 0.0, 1.0] + (np.cos(dome) + dome - down) * [0.0, 1.0, 0.0]
    mesh = plain_mesh("hood", points * half + 0.5 * (head.min(axis=0) + head.max(axis=0)), faces)
    return mesh.take_faces(unit[faces].mean(axis=1)[:, 2] < 0.7)


@pytest.mark.parametrize("unit", ["m", "cm", "mm", "inch"])
def test_a_hood_is_worn_on_the_head_in_any_unit_and_faces_where_it_is_open(unit: str):
    """In centimetres it hung at the hips, which are as high over a floor."""
    for up, front, origin in (("+y", "+z", "root"), ("+y", "-z", "root"), ("+z", "+x", "floor")):
        reading = Reading(unit, UNITS_M[unit], up, front)
        mesh, rise = hood(WOMAN), WOMAN[:, 1].min() if origin == "floor" else 0.0
        file = replace(mesh, vertices=(mesh.vertices - [0.0, rise, 0.0]) @ reading.turn / reading.scale)
        found = accessory_wearer(file, BODY)
        assert found is not None and (found.reading, found.origin) == (reading, origin)
        placed = replace(mesh, vertices=found.reading.apply(file.vertices))
        assert not carriers_of(placed, posed_by(BODY, found.parameters), BODY)  # cloth, not carried by the head


def test_a_short_skirt_over_its_floor_is_no_hat():
    """It is as high as a head over its root."""
    unit, faces = tube(40, 14, radius_m=1.0, height_m=1.0)
    skirt = unit * [1.0, 0.0, 0.7] * (0.24 - 0.1 * unit[:, 1:2]) + unit * [0.0, 0.36, 0.0] + [0.0, 0.66, 0.0]
    assert accessory_wearer(plain_mesh("skirt", 100.0 * skirt, faces), BODY) is None


@pytest.mark.parametrize("thing", ["glasses", "a left shoe"])
def test_glasses_and_a_shoe_anywhere_are_told_by_their_shape(thing: str):
    mesh = THINGS[thing][0](WOMAN)
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    found = accessory_wearer(replace(mesh, vertices=100.0 * (mesh.vertices - middle)), BODY)
    assert found is not None and (found.reading.unit, found.reading.up, found.reading.front) == ("cm", "+y", "+z")
    assert found.origin == "" and found.sure < 0.5


@pytest.mark.parametrize("unit_m", [0.001, 0.0254, 0.1])
def test_a_shirt_is_none_in_any_unit(unit_m: float):
    vertices, faces = shirt(BODY, WOMAN)
    for rise in (0.0, WOMAN[:, 1].min(), vertices[:, 1].mean()):
        assert accessory_wearer(plain_mesh("shirt", (vertices - [0.0, rise, 0.0]) / unit_m, faces), BODY) is None


def test_what_is_told_of_the_file_holds():
    mesh = glasses(WOMAN)
    assert accessory_wearer(mesh, BODY, ReadingHints(("cm", 0.01))) is None


def test_a_hat_that_was_found_too_low_and_too_far_in_front_is_raised_to_the_forehead():
    mesh = hat(BODY.v_template)
    parameters = known_parameters(BODY, "standard", 0.0, 0.0)
    parameters[-3:] += [0.0, 0.05, -0.03]
    low = WearerCandidate(Reading("m", 1.0, "+y", "+z"), BODY, parameters, 0.0, 0.0, 0.0, 0.0, sleeved=False)
    np.testing.assert_allclose(seated(mesh, low).trans, 0.0, rtol=0, atol=0.025)
    dress = plain_mesh("shirt", *shirt(BODY, BODY.v_template))
    assert seated(dress, low) is low


def test_small_things_are_taken_in_and_sit_before_the_eyes():
    """Glasses were refused as too small for cloth."""
    mesh = glasses(BODY.v_template)
    assert float(meshes.face_areas(mesh.vertices, mesh.faces).sum()) < 0.02
    garment = intake_mesh(replace(mesh, vertices=mesh.vertices + np.array([0.0, -0.03, 0.02])), BODY, digest="0" * 64)
    assert garment.carriers == ("head",)


def test_shoes_are_put_round_the_feet_that_stand_elsewhere():
    """Those of a body that stands with its feet apart lay beside the feet."""
    pair = both_shoes(BODY.v_template)
    apart = replace(pair, vertices=pair.vertices + np.sign(pair.vertices[:, :1]) * np.array([0.03, 0.0, 0.0]))
    rest = at_rest(apart, standard_avatar(BODY), BODY, carriers=("left_ankle", "right_ankle"))
    for side in (-1.0, 1.0):
        there, wanted = (one[side * one[:, 0] > 0.0, 0] for one in (rest.mesh.vertices, pair.vertices))
        assert abs(there.mean() - wanted.mean()) > 0.02
        own = rest.vertices[: len(rest.mesh.vertices)]
        assert abs(own[side * own[:, 0] > 0.0, 0].mean() - wanted.mean()) < 0.012


def test_a_shirt_in_millimetres_is_no_pair_of_glasses():
    assert are_glasses(glasses(WOMAN).vertices)
    assert not are_glasses(shirt(BODY, WOMAN)[0])
