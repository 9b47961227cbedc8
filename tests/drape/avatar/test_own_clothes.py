"""Clothes that a character came in: what comes off, what is bare then, and the bodies below, on made characters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from drape.avatar.attire import Attire
from drape.avatar.character import character_in
from drape.avatar.covered import DEEPER_M
from drape.avatar.own_clothes import (
    ENDS,
    INSET_M,
    Halves,
    _without_skin,
    bare_colours,
    bare_faces,
    doubled_ends,
    layers_of,
    removed_faces,
    sewn_to_ends,
    tucked_faces,
)
from drape.avatar.own_garments import Undressed, undress
from drape.avatar.parts import PARTS, parts_of
from drape.avatar.rig_file import GAMMA, bare_file
from drape.avatar.t_pose import TPose
from drape.avatar.tucked import BELOW_M
from drape.avatar.wearer import Wearer, load_wearer, read_wearer, save_wearer
from drape.avatar.wears import THICKEST, legs_thickness, reach_of, why_not
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.catalog import find_garments, open_garment
from drape.files.gltf import GltfFile
from drape.garment.cache import Garment
from drape.garment.tailor import tailored
from drape.geometry.closest import closest_point, nearest_vertices, signed_distance
from tests.drape.avatar.test_attire import told
from tests.fixtures.characters import bare_wearer
from tests.fixtures.dressed_characters import COLOURS, dressed_character, dressed_parts

CATALOGUE = {
    "tshirt": ((True, False), False), "tank": ((True, False), False), "longsleeve": ((True, False), False),
    "shirt": ((True, False), False), "sweat": ((True, False), False), "trousers": ((False, True), True),
    "slim_trousers": ((False, True), True), "shorts": ((False, True), False), "skirt": ((False, True), False),
    "circle_skirt": ((False, True), False), "dress": ((True, True), False),
}  # fmt: skip


@pytest.fixture(scope="module")
def shelf(body: BodyModel) -> dict[str, Garment]:
    return {name: open_garment(find_garments([name])[0], body) for name in CATALOGUE}


@pytest.fixture(scope="module")
def cut_away(body: BodyModel, shelf: dict[str, Garment]) -> Wearer:
    """Our body in a T-shirt and trousers of its own with no skin below, with hair and a rucksack."""
    parts = dressed_parts(body, {"top": shelf["tshirt"], "trousers": shelf["trousers"]}, cut_away=True)
    return read_wearer(dressed_character(body, parts), name="cut_away", body=body)


@pytest.fixture(scope="module")
def whole(body: BodyModel, shelf: dict[str, Garment]) -> Wearer:
    """Our body in the same clothes, its skin whole."""
    parts = dressed_parts(body, {"top": shelf["tshirt"], "trousers": shelf["trousers"]})
    return read_wearer(dressed_character(body, parts), name="whole", body=body)


def test_cloth_without_skin_below_it_stands_for_it():
    """A leg of cloth above a boot, which is skin; and the same round a leg."""
    cloth, boot, leg = (
        trimesh.creation.cylinder(radius=radius, height=height, sections=48).subdivide().subdivide()
        for radius, height in ((0.08, 0.6), (0.12, 0.2), (0.06, 0.6))
    )
    boot.apply_translation([0.0, 0.0, -0.38])
    for under, hollow in (([boot], True), ([boot, leg], False)):
        whole: Any = trimesh.util.concatenate([cloth, *under])
        count = len(cloth.faces)
        skin = np.arange(len(whole.faces)) >= count
        none = np.zeros((len(whole.vertices), 24)), np.zeros((24, 3)), 1.0, 1.7
        pose = TPose(np.asarray(whole.vertices), np.asarray(whole.faces), *none)
        found = _without_skin(pose, np.arange(count), skin, np.zeros(len(skin), int))
        assert found.shape == (count,) and (found == hollow).all()


@pytest.mark.parametrize("name", CATALOGUE)
def test_the_catalogue_lies_on_its_halves(name: str, body: BodyModel, shelf: dict[str, Garment]):
    halves, legs = CATALOGUE[name]
    assert reach_of(shelf[name], body) == (halves, legs)


def kinds_off(attire: Attire, halves: Halves) -> set[str]:
    return {attire.parts[number].kind for number in np.unique(attire.part[removed_faces(attire, halves)])}


def test_a_top_takes_off_the_top_and_the_rucksack_and_trousers_the_trousers(cut_away: Wearer):
    assert kinds_off(cut_away.attire, Halves(True, False)) == {"top", "carried"}
    assert kinds_off(cut_away.attire, Halves(False, True)) == {"trousers"}
    assert kinds_off(cut_away.attire, Halves(True, True)) == {"top", "carried", "trousers"}


def test_any_garment_takes_off_a_dress(body: BodyModel, shelf: dict[str, Garment]):
    parts = dressed_parts(body, {"dress": shelf["dress"]}, rucksack=False)
    attire, _ = told(dressed_character(body, parts), body)
    assert kinds_off(attire, Halves(True, False)) == kinds_off(attire, Halves(False, True)) == {"dress"}


def test_the_body_is_laid_below_the_clothes(whole: Wearer, cut_away: Wearer, body: BodyModel):
    """Where the skin is whole the body is the skin; where it was cut away it is nearer to it than the clothes are."""
    trunk = (np.abs(body.v_template[:, 0]) < 0.15) & (np.abs(body.v_template[:, 1] - body.joints_template[3, 1]) < 0.15)
    gaps = []
    for wearer in (whole, cut_away):
        off = removed_faces(wearer.attire, Halves(True, True))
        bare = closest_point(wearer.body.v_template[trunk], body.v_template, body.faces).distance
        gaps.append(float(np.median(bare)))
        assert signed_distance(wearer.vertices[np.unique(wearer.faces[off])], body.v_template, body.faces).max() > 0.02
    assert gaps[0] < 0.003 and gaps[1] < 0.02


def test_a_top_lies_over_trousers_that_stay(whole: Wearer):
    """A T-shirt lies over trousers that stay: the body below it encloses them, and the bare one does not."""
    assert whole.body_under(Halves(False, True)) is whole.body
    trousers = np.unique(whole.faces[removed_faces(whole.attire, Halves(False, True))])
    hips = trousers[whole.vertices[trousers, 1] > whole.body.joints_template[0, 1] - 0.05]
    out = {
        key: signed_distance(whole.vertices[hips], one.v_template, one.faces)
        for key, one in (("bare", whole.body), ("upper", whole.body_under(Halves(True, False))))
    }
    assert (out["bare"] > 0.005).mean() > 0.3 and (out["upper"] > 0.005).mean() < 0.02


@pytest.mark.parametrize("made", ["whole", "cut_away"])
def test_a_top_that_stays_is_tucked_into_trousers(
    made: str, request: pytest.FixtureRequest, body: BodyModel, shelf: dict[str, Garment]
):
    """It lies on the skin from the waistband on and ends below it, joins what is left of it, and hides the skin."""
    wearer, halves = request.getfixturevalue(made), Halves(False, True)
    cut = tailored(shelf["trousers"], body, wearer.body_under(halves))
    left = undress(wearer, np.zeros(len(wearer.faces), dtype=bool), [(cut.vertices, cut.faces)], halves)
    top, tops = left.tucked, tucked_faces(wearer.attire, halves)
    assert top is not None and (left.off & tops)[top.rows].all()
    off_skin = closest_point(top.vertices, wearer.body.v_template, wearer.body.faces).distance
    waist_m = np.quantile(cut.vertices[:, 1], 0.995)
    low = top.vertices[:, 1] < waist_m - 0.03
    assert low.any() and off_skin[low].max() < 0.003 < off_skin.max()
    assert waist_m - BELOW_M - 0.05 < top.vertices[:, 1].min()
    rest = np.unique(wearer.faces[tops & ~left.off])  # where both meet, both are where the file has them
    seam = np.intersect1d(rest, wearer.faces[top.rows])
    assert len(seam) > 50 and nearest_vertices(wearer.vertices[seam], top.vertices)[0].max() < 1e-9
    shown = wearer.body.v_template[np.unique(wearer.body.faces[left.bare])]
    own = wearer.vertices[np.unique(wearer.faces[wearer.attire.of_kinds(("skin",)) & ~left.off])]
    for skin in (shown, own):
        trunk = (np.abs(skin[:, 0]) < 0.1) & (np.abs(skin[:, 1] - waist_m) < BELOW_M - 0.03)
        assert not trunk.any()
    assert not tucked_faces(wearer.attire, Halves(True, True)).any()
    stays = wearer.faces[tops & ~left.off]  # such a top may be painted on the skin, which then shows through it
    middle = wearer.body.v_template[wearer.body.faces[left.bare]].mean(axis=1)
    assert closest_point(middle, wearer.vertices, stays).distance.min() > INSET_M


def test_no_skin_is_bare_where_a_coarse_top_is_tucked_in(cut_away: Wearer, shelf: dict[str, Garment]):
    """Faces of a toy's top are as high as a hand is long: where one is drawn in, all of it is."""
    waist_m = float(np.quantile(shelf["trousers"].vertices[:, 1], 0.995))
    trunk, rings = cut_away.body.v_template, []
    for height_m in (-0.1, 0.13, 0.36):
        near = trunk[(np.abs(trunk[:, 1] - waist_m - height_m) < 0.03) & (np.abs(trunk[:, 0]) < 0.25)]
        angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        ways = np.stack([np.sin(angles), np.cos(angles)], axis=1)
        rings.append(np.insert(ways * (near[:, [0, 2]] @ ways.T).max(axis=0)[:, None], 1, waist_m + height_m, axis=1))
    tube = trimesh.Trimesh(np.concatenate(rings), [
        corner for ring in range(2) for one in range(24) for a, b in [(24 * ring + one, 24 * ring + (one + 1) % 24)]
        for corner in ((a, b, b + 24), (a, b + 24, a + 24))
    ], process=False)  # fmt: skip
    tops, attire = cut_away.attire.of_kinds(("top",)), cut_away.attire
    count, number = len(tube.faces), int(attire.part[tops][0])
    coarse = replace(
        cut_away,
        vertices=np.concatenate([cut_away.vertices, tube.vertices.astype(np.float32)]),
        faces=np.concatenate([cut_away.faces[~tops], tube.faces + len(cut_away.vertices)]).astype(cut_away.faces.dtype),
        weights=np.concatenate([cut_away.weights, cut_away.body.weights[nearest_vertices(tube.vertices, trunk)[1]]]),
        attire=attire._replace(
            part=np.append(attire.part[~tops], np.full(count, number)),
            colours=np.concatenate([attire.colours[~tops], np.ones((count, 3))]),
        ),
    )
    none = np.zeros(len(coarse.faces), dtype=bool)
    left = undress(coarse, none, [(shelf["trousers"].vertices, shelf["trousers"].faces)], Halves(False, True))
    middle = trunk[coarse.body.faces[left.bare]].mean(axis=1)
    there = (np.abs(middle[:, 1] - waist_m - 0.17) < 0.12) & (np.abs(middle[:, 0]) < 0.2)
    assert left.tucked is not None and not there.any()


def test_a_tucked_top_is_drawn_in_its_own_colours(cut_away: Wearer, body: BodyModel, shelf: dict[str, Garment]):
    """Beside bare skin, on the character's own nodes, where it was drawn in."""
    cloth = [(shelf["trousers"].vertices, shelf["trousers"].faces)]
    none = np.zeros(len(cut_away.faces), dtype=bool)
    left = undress(cut_away, none, cloth, Halves(False, True))
    assert left.tucked is not None and left.bare.any() and cut_away.file is not None
    file = GltfFile(bare_file(cut_away, cut_away.file, left).to_bytes())
    found = character_in(file)
    assert found.triangle is not None and len(found.triangle) == left.added
    drawn = cut_away.scale * found.vertices[found.faces]
    top = left.tucked.vertices[left.tucked.faces]
    assert np.abs(drawn[-len(top) :] - top).max() < 1e-4
    skin, own = (file.item("meshes", number).primitives[0] for number in (0, len(file.document.meshes) - 1))
    assert "COLOR_0" not in skin.attributes
    blue = np.array(COLOURS["top"])
    assert np.allclose(file.array(own.attributes["COLOR_0"]), blue, atol=0.01)


def test_a_top_that_ends_above_trousers_stays(body: BodyModel, shelf: dict[str, Garment]):
    parts = dressed_parts(body, {"top": shelf["tank"]}, rucksack=False)
    short = parts[-1].vertices * [1.0, 0.3, 1.0] + [0.0, 0.7 * parts[-1].vertices[:, 1].max(), 0.0]
    payload = dressed_character(body, [*parts[:-1], parts[-1]._replace(vertices=short)])
    wearer, trousers = read_wearer(payload, name="me", body=body), shelf["trousers"]
    none = np.zeros(len(wearer.faces), dtype=bool)
    left = undress(wearer, none, [(trousers.vertices, trousers.faces)], Halves(False, True))
    assert left.tucked is None and not left.off.any()


def test_no_hole_is_left_where_clothes_come_off(cut_away: Wearer):
    """Whatever of the body lay below the clothes has skin of its own near, or is among the bare faces."""
    halves = Halves(True, True)
    body, off = cut_away.body, removed_faces(cut_away.attire, halves)
    bare = bare_faces(body, cut_away.vertices, cut_away.faces, off)
    middle = body.v_template[body.faces].mean(axis=1)
    below = closest_point(middle, cut_away.vertices, cut_away.faces[off]).distance < 0.05
    skin = closest_point(middle, cut_away.vertices, cut_away.faces[~off]).distance
    assert not (below & ~bare & (skin > 0.02)).any() and bare.sum() > 2000
    assert not bare_faces(body, cut_away.vertices, cut_away.faces, np.zeros(len(off), dtype=bool)).any()


def test_what_a_top_bared_at_the_hips_has_the_colour_of_the_trousers(cut_away: Wearer):
    """A coat hid how high they go: skin would be seen between them and a shorter shirt in a squat."""
    body, file = cut_away.body, cut_away.file
    off = removed_faces(cut_away.attire, Halves(True, False))
    bare = bare_faces(body, cut_away.vertices, cut_away.faces, off)
    surface = cut_away.vertices, cut_away.faces
    colours = bare_colours(body, cut_away.attire, *surface, off)
    rows = {name: body.weights.argmax(axis=1) == JOINT_NAMES.index(name) for name in ("pelvis", "spine3")}
    painted = {kind: np.array(COLOURS[kind]) ** (1.0 / GAMMA) for kind in ("trousers", "skin")}
    assert np.abs(colours[rows["pelvis"]] - painted["trousers"]).max() < 0.02
    assert np.abs(colours[rows["spine3"]] - painted["skin"]).max() < 0.02
    assert file is not None
    made = GltfFile(bare_file(cut_away, file, Undressed(off, bare)).to_bytes())
    assert "COLOR_0" in made.item("meshes", 0).primitives[0].attributes
    every = removed_faces(cut_away.attire, Halves(True, True))
    assert (bare_colours(body, cut_away.attire, *surface, every) == cut_away.attire.skin_colour).all()


def test_a_character_keeps_its_own_head_and_hands(cut_away: Wearer):
    """Of the fitted body, whose head and hands have another size, none are seen beside them."""
    body, weights, faces = cut_away.body, cut_away.weights, cut_away.faces
    doubled = doubled_ends(body, weights, faces)
    middle, bone = body.v_template[body.faces].mean(axis=1), body.weights[body.faces[:, 0]].argmax(axis=1)
    for part, end in (("head", "head"), ("palm", "left_wrist"), ("sole", "right_ankle")):
        far = np.linalg.norm(middle - body.joints_template[JOINT_NAMES.index(end)], axis=1) > ENDS[part][1]
        own = (bone == JOINT_NAMES.index(end)) & far
        assert own.any() and doubled[own].mean() > 0.9
        assert not doubled[~far & (bone == JOINT_NAMES.index(end))].any()
    headless = faces[(weights[faces[:, 0], JOINT_NAMES.index("head")] < 0.01)]
    assert not doubled_ends(body, weights, headless)[bone == JOINT_NAMES.index("head")].any()
    every = Halves(True, True)
    left = undress(cut_away, np.zeros(len(faces), dtype=bool), [], every)
    assert left.bare.any() and not (left.bare & doubled).any()


def test_what_is_painted_on_a_hand_stays_on_it(body: BodyModel):
    """A toy's hand in the colours of its sleeve: no skin is drawn there in its place. A cuff beside it comes off."""
    hand = parts_of(body.weights)[body.faces[:, 0]] == list(PARTS).index("left_palm")
    painted = hand & (np.arange(len(hand)) % 3 == 0)
    faces = np.concatenate([body.faces, body.faces[hand] + body.vertex_count])  # the cuff, a mesh of its own
    weights = np.concatenate([body.weights, body.weights])
    cuff = np.arange(len(faces)) >= len(body.faces)
    off = np.append(painted, np.ones(hand.sum(), dtype=bool))
    assert np.array_equal(sewn_to_ends(weights, faces, off), off & ~cuff)
    arm = np.append(parts_of(body.weights)[body.faces[:, 0]] == list(PARTS).index("left_forearm"), cuff[cuff])
    assert not sewn_to_ends(weights, faces, arm | off | np.append(hand, cuff[cuff])).any()


def test_painted_sleeves_do_not_widen_the_arms(whole: Wearer):
    """Garments on the arms take them off: skin round all that they do in poses was a giant's muscles."""
    part = parts_of(whole.weights)[whole.faces[:, 0]]
    arm = np.isin(part, [number for number, name in enumerate(PARTS) if name.endswith("arm")])
    skin, top = (next(n for n, one in enumerate(whole.attire.parts) if one.kind == kind) for kind in ("skin", "top"))
    painted = (whole.attire.part == skin) & arm
    attire = whole.attire._replace(part=np.where(painted, top, whole.attire.part))
    pose = TPose(whole.vertices, whole.faces, whole.weights, np.zeros((24, 3)), 1.0, 1.7)
    layers = layers_of(attire, pose)
    assert layers.body[painted].all() and not layers.felt[painted].any()
    assert np.array_equal(layers.felt[~arm], layers.body[~arm])


def test_bare_skin_under_a_garment_is_drawn_deeper(cut_away: Wearer, body: BodyModel, shelf: dict[str, Garment]):
    """Clients draw it like the character's own: it does not stand through the cloth that lies on it."""
    halves = Halves(True, False)
    cut = tailored(shelf["tshirt"], body, cut_away.body_under(halves))
    none = np.zeros(len(cut_away.faces), dtype=bool)
    left = undress(cut_away, none, [(cut.vertices, cut.faces)], halves)
    assert left.deep is not None and not (left.deep & ~left.bare).any() and cut_away.file is not None
    middle = cut_away.body.v_template[cut_away.body.faces].mean(axis=1)
    near = closest_point(middle, cut.vertices.astype(float), cut.faces.astype(int)).distance < 0.03
    assert left.deep[near & left.bare].mean() > 0.8 and left.deep.sum() < left.bare.sum()
    nodes = bare_file(cut_away, cut_away.file, left).json["nodes"]
    told = {node["name"]: node.get("extras", {}).get("deeper_m") for node in nodes if "mesh" in node}
    assert told == {"bare skin": None, "skin under garments": DEEPER_M}


def test_bare_skin_lies_on_the_character_s_own_nodes(cut_away: Wearer):
    """Skinned by the nodes of its file, which stand in T-pose, it is the body that was laid below."""
    halves = Halves(True, True)
    body, off = cut_away.body, removed_faces(cut_away.attire, halves)
    chosen = bare_faces(body, cut_away.vertices, cut_away.faces, off)
    assert cut_away.file is not None
    skin = character_in(GltfFile(bare_file(cut_away, cut_away.file, Undressed(off, chosen)).to_bytes()))
    expected = np.sort(body.v_template[body.faces[chosen]].mean(axis=1), axis=0)
    assert np.allclose(np.sort(cut_away.scale * skin.vertices[skin.faces].mean(axis=1), axis=0), expected, atol=1e-4)
    assert set(skin.names) >= {"pelvis", "spine3"}


def test_a_stored_wearer_keeps_its_parts_and_bodies(whole: Wearer, body: BodyModel, tmp_path: Path):
    """The body with its trousers on is the same whether it was stored or is made of what was."""
    fresh = load_wearer(save_wearer(replace(whole), tmp_path / "fresh"), body)
    assert fresh.over is None and fresh.upper.digest == whole.upper.digest
    again = load_wearer(save_wearer(whole, tmp_path), body)
    assert (
        again.over is not None
        and again.attire.parts == whole.attire.parts
        and np.array_equal(again.attire.part, whole.attire.part)
    )
    assert again.attire.skin_colour == whole.attire.skin_colour
    assert np.allclose(again.attire.colours, whole.attire.colours, atol=0.5 / 255.0)
    for halves in (Halves(True, False), Halves(False, True), Halves(True, True)):
        one, other = whole.body_under(halves), again.body_under(halves)
        assert one.digest == other.digest and np.array_equal(one.v_template, other.v_template)
        assert np.allclose(other.joints_template, whole.body.joints_template, atol=1e-9)


def test_a_bare_character_has_one_body():
    wearer = bare_wearer()
    assert wearer.body_under(Halves(True, False)) is wearer.body


def test_legs_as_thick_as_long_wear_no_trousers(body: BodyModel, shelf: dict[str, Garment]):
    """A cylinder of the standard leg's length round each shin tells its own thickness."""
    assert legs_thickness(body) < 0.2
    own = body.weights.argmax(axis=1) == 4
    regressor = _without(body, own)  # so that joints stay
    knee, ankle, hip = (regressor @ body.v_template)[[4, 7, 1]]
    vertices, along = body.v_template.copy(), (ankle - knee) / np.linalg.norm(ankle - knee)
    way = vertices[own] - knee
    across = way - np.outer(way @ along, along)
    radius_m = 0.25 * (np.linalg.norm(ankle - knee) + np.linalg.norm(knee - hip))
    vertices[own] += across * (radius_m / np.linalg.norm(across, axis=1) - 1.0)[:, None]
    thick = BodyModel("thick", "d", vertices, body.shapedirs, regressor, body.weights, body.faces)
    assert legs_thickness(thick) == pytest.approx(0.5, rel=0.02) and THICKEST < 0.5
    refusal = why_not(thick, reach_of(shelf["trousers"], body), garment="trousers")
    assert refusal is not None and "0.50 times" in str(refusal)
    assert why_not(thick, reach_of(shelf["skirt"], body), garment="skirt") is None
    assert why_not(body, reach_of(shelf["trousers"], body), garment="trousers") is None
    vertices[own] += 0.3 * (across * (radius_m / np.linalg.norm(across, axis=1))[:, None])
    stout = BodyModel("stout", "d", vertices, body.shapedirs, regressor, body.weights, body.faces)
    for name in ("trousers", "skirt", "dress"):
        refusal = why_not(stout, reach_of(shelf[name], body), garment=name)
        assert refusal is not None and "0.65 times" in str(refusal) and refusal.cure == "Choose a top."
    assert why_not(stout, reach_of(shelf["tshirt"], body), garment="tshirt") is None


def _without(body: BodyModel, own: np.ndarray):
    """The regressor of ``body`` without its ``own`` vertices, scaled so that rows still sum to one."""
    dense = np.where(own[None], 0.0, body.regressor.toarray())
    return type(body.regressor)(dense / dense.sum(axis=1, keepdims=True))
