"""Who wore a garment: unit, axes, place and arms of bodies that are known, and a refusal in words."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from drape.body.assets import load_body
from drape.errors import BodyError, MeshError
from drape.garment.avatars import standard_avatar
from drape.garment.cache import GARMENTS_DIR, load_garment
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake_options import IntakeOptions
from drape.garment.mesh_checks import UNITS_M
from drape.garment.modelled_on import modelled_on
from drape.garment.reading_hints import ReadingHints, reading_hints
from drape.garment.registration import posed_by, unpack_parameters
from drape.garment.searched_cloth import SearchedCloth
from drape.garment.unnamed_avatar import on_standard, worn_by
from drape.garment.wearer_fields import SHAPES, bones_of, enclosed, known_parameters, thin_body, unthreaded
from drape.garment.wearer_judge import judge, misplaced
from drape.garment.wearer_reading import Reading
from drape.garment.wearer_search import find_wearers, the_wearer
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.garment.garment_files import shirt
from tests.fixtures.mantles import cape, poncho, standing

BODY = load_body()
FACES = shirt(BODY, BODY.v_template)[1]


def tube_dress(radius_m: float = 0.24) -> GarmentMesh:
    """A strapless dress round the standard body in T-pose."""
    unit, faces = tube(40, 20, radius_m=1.0, height_m=1.0)
    down = 1.0 - unit[:, 1:2]
    points = (radius_m + 0.06 * down) * unit * [1.0, 0.0, 0.75] + [0.0, 0.36, 0.02] - 0.8 * down * [0.0, 1.0, 0.0]
    return plain_mesh("tube", points, faces)


def a_wrap() -> GarmentMesh:
    """A tube of 30 cm that fits round hips and round a chest, its origin anywhere, in centimetres."""
    unit, faces = tube(40, 14, radius_m=1.0, height_m=1.0)
    return plain_mesh("wrap", 100.0 * (unit * [0.16, 0.3, 0.12] + [0.3, 0.2, -0.2]), faces)


def shirt_on(parameters: np.ndarray, reading: Reading, shift: np.ndarray) -> GarmentMesh:
    """The file of a shirt on the body with ``parameters``, moved by ``shift`` [m]."""
    vertices, faces = shirt(BODY, posed_by(BODY, parameters))
    return plain_mesh("shirt", (vertices + shift) @ reading.turn / reading.scale, faces)


def test_thin_body_has_the_joints_of_the_whole_one_in_every_shape():
    betas = np.linspace(-1.0, 1.0, BODY.shape_count)
    thin = thin_body(BODY)
    assert len(thin.v_template) < len(BODY.v_template)
    np.testing.assert_allclose(thin.rest_joints(betas), BODY.rest_joints(betas), rtol=0, atol=1e-9)


def test_a_tube_encloses_its_bones_whatever_its_faces_look_like_and_half_of_it_does_not():
    mesh = tube_dress()
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    bones = bones_of(BODY.joints_template, BODY.v_template[::6])
    assert enclosed(middles, bones)[0].mean() > 0.99
    assert enclosed(middles[middles[:, 2] > 0.05], bones)[0].mean() < 0.75


def test_openings_count_that_no_bone_goes_through():
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.stack([0.2 * np.cos(angle), np.full(24, 0.2), 0.2 * np.sin(angle)], axis=1)
    assert unthreaded(np.stack([ring, ring + np.array([0.6, 0.0, 0.0])]), BODY.joints_template) == 1
    assert unthreaded(np.zeros((0, 24, 3)), BODY.joints_template) == 0


def test_borders_of_laces_and_tapes_are_no_openings():
    dress, (lace, faces) = tube_dress(), grid(2, 30, cell_m=0.02)
    count = len(dress.vertices)
    laces = [lace + np.array([x, -0.3, 0.25]) for x in (-0.05, 0.05)]
    both = np.concatenate([dress.faces, *(faces + count + number * len(lace) for number in range(2))])
    assert len(SearchedCloth(plain_mesh("laced", np.concatenate([dress.vertices, *laces]), both)).loops) == 2


RINGS = {  # middles and radii [m] of tubes, and how much of them lies where none is worn
    "dress": ([[0.0, -0.1, 0.0]], 0.3, 0.0),
    "both legs in one": ([[0.0, -0.9, 0.0]], 0.3, 1.0),
    "hat": ([[0.0, 0.62, 0.03]], 0.11, 0.0),
    "on the crown": ([[0.0, 0.9, 0.03]], 0.11, 1.0),
    "a pair on the head": ([[-0.05, 0.68, 0.03], [0.05, 0.68, 0.03]], 0.05, 1.0),
    "socks": ([[-0.1, -0.95, 0.0], [0.1, -0.95, 0.0]], 0.06, 0.0),
}


@pytest.mark.parametrize("kind", RINGS)
def test_cloth_that_lies_where_none_is_worn_is_told(kind: str):
    middles, radius_m, share = RINGS[kind]
    ring = tube(24, 6, radius_m=radius_m, height_m=0.15)[0]
    points = np.concatenate([ring + middle for middle in middles])
    bones = bones_of(BODY.joints_template, BODY.v_template)
    piece = np.repeat(np.arange(len(middles)), len(ring))
    assert misplaced(points, bones, enclosed(points, bones)[1], piece) == pytest.approx(share)


def test_a_shirt_over_the_head_has_empty_sleeves_and_one_with_its_side_in_front_costs_more():
    front, side = (Reading("m", 1.0, "+y", axis) for axis in ("+z", "+x"))
    parameters = known_parameters(BODY, "standard", 0.4, 0.0)
    worn, small = (shirt_on(parameters, Reading("free", scale, "+y", "+z"), np.zeros(3)) for scale in (1.0, 2.5))
    cloth = SearchedCloth(worn)
    assert cloth.oddness(side) > cloth.oddness(front) + 0.03
    assert not judge(cloth, front, BODY, parameters, 0.0).fault
    head = parameters.copy()
    head[-2] -= 0.55
    assert "openings" in judge(SearchedCloth(small), front, BODY, head, 0.0).fault


def test_a_loose_dress_is_refused_in_readings_that_few_write():
    parameters = known_parameters(BODY, "standard", 0.0, 0.0)
    usual, free = Reading("m", 1.0, "+y", "+z"), Reading("free", 1.0, "+y", "+z")
    one, other = (judge(SearchedCloth(tube_dress()), each, BODY, parameters, 0.0) for each in (usual, free))
    assert 0.3 < one.energy < other.energy < 0.7
    assert not one.fault
    assert other.fault


def test_a_refusal_in_a_unit_that_was_told_says_to_leave_it_out():
    with pytest.raises(MeshError, match=r"Leave out what was said of the file \(unit"):
        the_wearer(tube_dress(), BODY, ReadingHints(unit=("mm", 0.001)))


def test_dress_on_the_standard_body_is_found_in_millimetres_with_z_up():
    dress = tube_dress()
    turned = replace(dress, vertices=1000.0 * dress.vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0])
    mesh, avatar, wearer = worn_by(turned, BODY, IntakeOptions())
    assert (wearer.reading.unit, wearer.reading.up) == ("mm", "+z")
    np.testing.assert_allclose(mesh.vertices, dress.vertices, rtol=0, atol=1e-9)
    np.testing.assert_allclose(avatar.vertices, standard_avatar(BODY).vertices, rtol=0, atol=1e-9)
    assert "millimetres, z up" in mesh.notes[-1]
    assert wearer.origin == "root" and wearer.sure < 1.0  # the dress may be worn higher or lower


@pytest.mark.parametrize(("shape", "lift_rad"), [("woman", 0.7), ("person", 1.0)])
def test_arms_unit_axis_and_place_of_a_shirt_are_found(shape: str, lift_rad: float):
    """Where the rims of its sleeves led to the end, arms were 2.5 degrees off, and the second body 44 mm."""
    parameters = known_parameters(BODY, shape, lift_rad, 0.0)
    reading, shift = Reading("dm", 0.1, "+z", "-y"), np.array([0.4, 0.2, -0.1])
    found = the_wearer(shirt_on(parameters, reading, shift), BODY)
    assert (found.reading.unit, found.reading.up, found.reading.front) == ("dm", "+z", "-y")
    pose = unpack_parameters(BODY, parameters)[1]
    joints = BODY.posed_joints(pose[None], unpack_parameters(BODY, parameters)[0])[0]
    way = joints[18] - joints[16]
    assert abs(found.arms_deg - np.degrees(np.arctan2(-way[1], np.hypot(way[0], way[2])))) < 2.0
    theirs = posed_by(BODY, found.parameters)
    covered = BODY.weights[:, [3, 6, 9]].sum(axis=1) > 0.6
    off = (theirs - shift - posed_by(BODY, parameters))[covered].mean(axis=0)
    assert np.linalg.norm(off) < 0.012
    assert found.sleeved and found.to_json()["unit"] == "dm"


def test_arms_bent_before_the_body_are_found_in_their_sleeves():
    """Straight ones lay beside them, and sleeves hung beside the arms in T-pose."""
    parameters = known_parameters(BODY, "standard", 1.2, 1.3)
    skin = posed_by(BODY, parameters)
    kept = BODY.weights[:, [13, 14, 16, 17, 18, 19, 3, 6, 9, 0]].sum(axis=1) > 0.6
    used, faces = np.unique(BODY.faces[kept[BODY.faces].all(axis=1)], return_inverse=True)
    lifted = skin + 0.014 * meshes.vertex_normals(skin, BODY.faces)
    found = the_wearer(plain_mesh("top", 10.0 * lifted[used], faces.reshape(-1, 3)), BODY)
    off = np.linalg.norm(posed_by(BODY, found.parameters) - skin, axis=1)
    assert off[BODY.weights[:, [18, 19]].sum(axis=1) > 0.6].mean() < 0.03


def gown(train_m: float) -> GarmentMesh:
    """A strapless gown on the woman, in metres, over the floor, whose train lies behind her."""
    skin = posed_by(BODY, known_parameters(BODY, "woman", 0.4, 0.0))
    skin = skin - [0.0, skin[:, 1].min(), 0.0]
    trunk = skin[BODY.weights[:, [16, 17, 18, 19, 20, 21, 22, 23]].sum(axis=1) < 0.5]
    chest = (BODY.regressor @ skin)[9, 1] + 0.08
    unit, faces = tube(48, 40, radius_m=1.0, height_m=1.0)
    height = 0.01 + unit[:, 1] * (chest - 0.01)
    rows = [trunk[np.abs(trunk[:, 1] - max(y, 0.8)) < 0.02] for y in height]
    half = np.array([0.5 * np.ptp(row, axis=0) + 0.015 for row in rows])
    middle = np.array([0.5 * (row[:, 2].min() + row[:, 2].max()) for row in rows])
    down = np.clip((0.8 - height) / 0.8, 0.0, 1.0)
    back = np.clip(-unit[:, 2], 0.0, 1.0) ** 2
    x, z = unit[:, 0] * half[:, 0] * (1.0 + down), unit[:, 2] * half[:, 2] * (1.0 + down) - train_m * back * down**3
    return plain_mesh("gown", np.stack([x, height, z + middle], axis=1), faces)


def test_a_gown_with_a_train_is_no_hood_in_a_smaller_unit():
    mesh = gown(0.75)
    found = the_wearer(replace(mesh, vertices=mesh.vertices / UNITS_M["inch"]), BODY)
    assert (found.reading.unit, found.reading.up, found.reading.front) == ("inch", "+y", "+z")


def test_a_body_that_stands_on_the_origin_of_its_file_is_found_there():
    parameters = known_parameters(BODY, "man", 0.6, 0.0)
    floor = posed_by(BODY, parameters)[:, 1].min()
    found = the_wearer(shirt_on(parameters, Reading("cm", 0.01, "+y", "+z"), np.array([0.0, -floor, 0.0])), BODY)
    assert found.origin == "floor" and found.sure > 0.5
    np.testing.assert_allclose(posed_by(BODY, found.parameters)[:, 1].min(), 0.0, rtol=0, atol=0.01)
    np.testing.assert_allclose(found.trans[[0, 2]], 0.0, rtol=0, atol=0.01)


def test_named_unit_and_axis_win():
    found = find_wearers(tube_dress(), BODY, ReadingHints(("m", 1.0), "+y"))
    assert {one.reading.unit for one in found} == {"m"} and {one.reading.up for one in found} == {"+y"}


def test_a_tube_that_is_a_skirt_as_well_as_a_top_has_the_other_body_that_its_options_choose():
    wrap = a_wrap()
    mesh, avatar, wearer = worn_by(wrap, BODY, IntakeOptions())
    other, turned = wearer.to_json()["others"]
    assert turned["words"].endswith("facing -z")
    assert other["words"].endswith("higher") or other["words"].endswith("lower")
    assert (other["unit"], other["up"], other["facing"]) == ("cm", "y", "z") and wearer.sure < 0.5
    placed, chosen, found = modelled_on(wrap, BODY, IntakeOptions(), json.loads(other["options"]["avatar"]))
    assert found is None
    np.testing.assert_allclose(placed.vertices, mesh.vertices, rtol=0, atol=1e-9)
    expected = posed_by(BODY, wearer.others[0].parameters)
    np.testing.assert_allclose(chosen.vertices, expected, rtol=0, atol=1e-3)
    pelvis = [float((BODY.regressor @ skin)[0, 1]) for skin in (chosen.vertices, avatar.vertices)]
    assert abs(pelvis[0] - pelvis[1]) > 0.15  # from the hips to the chest


@pytest.mark.parametrize("kind", ["shirt", "dress"])
def test_a_garment_modelled_back_to_front_is_turned_and_says_what_turns_it_back(kind: str):
    """Its skin fits better by 0.03 and 0.05 then, for which readings that few write were too dear."""
    garment = load_garment(next(GARMENTS_DIR.glob(f"{kind}-*.npz")))
    vertices = garment.vertices[: garment.vertex_count].astype(np.float64) + np.array([0.4, 0.2, -0.1])
    mesh, _, wearer = worn_by(plain_mesh(kind, vertices * [-1.0, 1.0, -1.0], garment.faces), BODY, IntakeOptions())
    assert (wearer.reading.up, wearer.reading.front) == ("+y", "-z")
    (told,) = [note.split("back to front: ")[1] for note in mesh.notes if "back to front" in note]
    assert told == 'the avatar {"unit": "m", "up": "y", "facing": "z"} takes it so'
    assert reading_hints(wearer.others[0].axes)[0].reading == Reading("m", 1.0, "+y", "+z")


def test_flat_cloth_is_refused_unless_its_body_is_told():
    """A square metre was a cape."""
    points, faces = grid(30, 30, cell_m=1.0 / 30.0)
    points = points[:, [0, 2, 1]] - [0.5, 0.0, 0.5]
    for waves_m in (0.0, 0.015):
        waves = waves_m * (np.sin(9.0 * points[:, :1]) * np.cos(7.0 * points[:, 2:])) * [0.0, 1.0, 0.0]
        flat = plain_mesh("flat", 100.0 * (points + waves), faces)
        with pytest.raises(MeshError, match=r"a flat piece, of an extent of 100 x .* x 100"):
            worn_by(flat, BODY, IntakeOptions())
    told = {"unit": "cm", "up": "y", "facing": "z", "trans": [0.0, 0.0, 0.0]}
    np.testing.assert_allclose(modelled_on(flat, BODY, IntakeOptions(), told)[0].vertices, 0.01 * flat.vertices)


def test_an_outfit_for_hanging_arms_does_not_lie_on_the_standard_body():
    worn = shirt(BODY, BODY.v_template)[0]
    assert on_standard(plain_mesh("shirt", worn, FACES), BODY, IntakeOptions()) is not None
    for lift_rad in (0.3, 0.8):
        hanging = shirt(BODY, posed_by(BODY, known_parameters(BODY, "standard", lift_rad, 0.0)))[0]
        assert on_standard(plain_mesh("shirt", hanging, FACES), BODY, IntakeOptions()) is None


def test_what_is_told_of_a_file_holds_on_any_body():
    dress = tube_dress()
    turned = replace(dress, vertices=dress.vertices[:, [2, 0, 1]] / 0.37)  # z up, facing +x, in units of 37 cm
    told = {"unit": 0.37, "up": "z", "facing": "x"}
    for meaning in (told, told | {"trans": [0.0, 0.0, 0.0]}, told | {"betas": [0.0]}):
        mesh, avatar, _ = modelled_on(turned, BODY, IntakeOptions(), meaning)
        np.testing.assert_allclose(mesh.vertices, dress.vertices, rtol=0, atol=1e-9)
        if meaning != told:  # else the body is looked for
            np.testing.assert_allclose(avatar.vertices, BODY.v_template, rtol=0, atol=1e-9)


def test_a_facing_that_is_told_leaves_the_rest_to_the_search():
    wearer = modelled_on(a_wrap(), BODY, IntakeOptions(), {"facing": "-z"})[2]
    assert wearer is not None and (wearer.reading.unit, wearer.reading.up, wearer.reading.front) == ("cm", "+y", "-z")


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"unit": "yard"}, "avatar unit: expected m, cm, dm, mm, inch, or metres > 0, got 'yard'"),
        ({"unit": -1.0}, "avatar unit"),
        ({"unit": True}, "avatar unit"),
        ({"up": "w"}, "avatar axis: expected x, y, z, -x, -y or -z, got 'w'"),
        ({"facing": ["z"]}, "avatar axis"),
        ({"up": "z", "facing": "-z"}, "avatar facing"),
    ],
)
def test_units_and_axes_that_are_none_are_refused(told: dict[str, object], words: str):
    with pytest.raises(BodyError, match=words):
        reading_hints(told)


def test_what_is_told_in_part_has_the_usual_rest():
    front_only, rest = reading_hints({"facing": "y", "gender": 1.0})
    assert rest == {"gender": 1.0} and front_only.reading is None
    assert front_only.turned == Reading("m", 1.0, "+z", "+y")
    assert reading_hints({"unit": 0.01}) == (ReadingHints(("cm", 0.01)), None)
    assert reading_hints({"up": "-z"})[0].turned == Reading("m", 1.0, "-z", "-y")
    assert reading_hints("standard") == (ReadingHints(), "standard")


MANTLES = {
    "cape": (50.0, 100.0, lambda body: cape(body, 50.0, length_m=1.05, open_deg=10.0)),
    "poncho": (0.0, 1.0, lambda body: poncho(body, width_m=0.62, front_m=0.6, back_m=0.6)),
}


@pytest.mark.parametrize("kind", MANTLES)
def test_cloth_that_hangs_from_arms_tells_its_unit_and_facing(kind: str):
    """A cape in centimetres is no hat in millimetres, a woman's poncho no scarf of half its size."""
    down_deg, per_m, made = MANTLES[kind]
    betas = np.array(SHAPES["woman"])
    woman = replace(BODY, v_template=BODY.rest_vertices(betas))
    vertices, faces = made(woman)
    skin = standing(woman, down_deg)
    found = the_wearer(plain_mesh(kind, per_m * (vertices - [0.0, skin[:, 1].min(), 0.0]), faces), BODY)
    assert (found.reading.scale, found.reading.up, found.reading.front) == (1.0 / per_m, "+y", "+z")
    assert abs(found.arms_deg - down_deg) < 12.0
