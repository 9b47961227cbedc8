"""A character's own clothes as garments: what becomes cloth, what stays on the skin and why, on made characters."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import drape
from drape.avatar.own_clothes import Halves, halves_of
from drape.avatar.own_garments import (
    BURIED_M,
    KINDS,
    OWN,
    OwnGarments,
    _buried,
    _large_pieces,
    body_of,
    halves_on,
    own_faces,
    own_garments,
    split_own,
    undress,
)
from drape.avatar.wearer import Wearer, read_wearer, upper_body
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES
from drape.catalog import find_garments, open_garment
from drape.command import main
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.tailor import tailored
from drape.geometry.closest import closest_point, signed_distance
from tests.fixtures.dressed_characters import MAKERS, Worn, dressed_character, dressed_parts
from tests.fixtures.glb_reader import Reader

SPINE = np.eye(len(JOINT_NAMES))[JOINT_NAMES.index("spine3")]


@pytest.fixture(scope="module")
def shelf(body: BodyModel) -> dict[str, Garment]:
    return {name: open_garment(find_garments([name])[0], body) for name in ("tshirt", "tank", "shorts")}


@pytest.fixture(scope="module")
def file(body: BodyModel, shelf: dict[str, Garment]) -> bytes:
    """Our body in a tank top and shorts of its own, with a breastplate and an apron of twelve faces."""
    parts = dressed_parts(body, {"top": shelf["tank"], "trousers": shelf["shorts"]})
    bag = parts[-1]
    plate = Worn("skirt", bag.vertices * [0.5, 0.5, 0.5] + [0.0, 0.6, 0.2], bag.faces, bag.weights)
    few = Worn("dress", shelf["shorts"].vertices.astype(float), shelf["shorts"].faces[:12].astype(int), bag.weights[:1])
    few = few._replace(weights=np.tile(SPINE, (len(few.vertices), 1)))
    return dressed_character(body, [*parts, plate, few])


@pytest.fixture(scope="module")
def wearer(file: bytes, body: BodyModel) -> Wearer:
    return read_wearer(file, name="me", body=body)


@pytest.fixture(scope="module")
def own(file: bytes, wearer: Wearer) -> OwnGarments:
    return own_garments(file, wearer)


def test_own_clothes_are_garments_where_they_were(own: OwnGarments, wearer: Wearer):
    """One for each kind, on the character's own body, clear of it and not moved but off the skin."""
    assert [one.name for one in own.garments] == ["me~trousers", "me~top"]
    for garment in own.garments:
        kind = garment.manifest[OWN]["kind"]
        assert garment.body_digest == wearer.body.digest
        rows = wearer.attire.of_kinds((kind,))
        assert (own_faces(wearer, [garment]) == rows).all()
        assert len(garment.surface.faces) == rows.sum()
        points = garment.vertices[: garment.vertex_count].astype(np.float64)
        off_mm = 1e3 * closest_point(points, wearer.vertices, wearer.faces[rows]).distance
        assert np.median(off_mm) < 3.0 and np.quantile(off_mm, 0.95) < 12.0
        assert signed_distance(points, wearer.body.v_template, wearer.body.faces).min() > -0.001


def test_the_body_with_trousers_on_is_made_when_a_garment_lies_on_it(wearer: Wearer, own: OwnGarments):
    """Trousers and top lie on the bare one, so nothing of the other was computed for them."""
    fresh = replace(wearer)
    assert len(own.garments) == 2 and "upper" not in vars(fresh)
    assert fresh.body_under(Halves(True, True)) is wearer.body and "upper" not in vars(fresh)
    assert fresh.body_under(Halves(True, False)).digest == upper_body(wearer).digest != wearer.body.digest


def test_a_top_over_trousers_that_are_no_cloth_lies_on_the_body_with_them(file: bytes, wearer: Wearer):
    """Trousers that one bone moves, as armour."""
    weights = wearer.weights.copy()
    weights[np.unique(wearer.faces[wearer.attire.of_kinds(("trousers",))])] = np.eye(len(SPINE))[0]
    armoured = replace(wearer, weights=weights)
    found = own_garments(file, armoured)
    assert [one.manifest[OWN]["kind"] for one in found.garments] == ["top"]
    assert found.garments[0].body_digest == armoured.upper.digest != wearer.body.digest


def test_they_keep_their_materials(own: OwnGarments):
    for garment, blue in zip(own.garments, (0.1, 0.6), strict=True):
        (look,) = garment.looks.materials
        assert look is not None
        assert look.base_colour[2] == pytest.approx(blue, abs=0.01)
        assert garment.surface.material_names[0].startswith("N00_")


def test_what_is_no_cloth_stays_on_the_skin_and_says_why(own: OwnGarments, wearer: Wearer):
    told = {part.kind: own.stiff[part.name] for part in wearer.attire.parts if part.name in own.stiff}
    assert told == {"skirt": "One bone moves all of it, as armour.", "dress": "It has 12 faces, too few to fold."}


def test_clothes_of_the_skins_own_mesh_are_painted_on_it(wearer: Wearer, file: bytes):
    """A face of skin that is called a top is sewn to the rest of the skin."""
    skin = next(number for number, part in enumerate(wearer.attire.parts) if part.kind == "skin")
    part = wearer.attire.part.copy()
    chest = wearer.vertices[wearer.faces].mean(axis=1)[:, 1] > wearer.body.joints_template[SPINE.argmax(), 1]
    part[(part == skin) & chest] = len(wearer.attire.parts)
    painted = wearer.attire.parts[skin]._replace(kind="outer", name="painted")
    others = [one._replace(kind="shoes" if one.kind in KINDS else one.kind) for one in wearer.attire.parts]
    attire = wearer.attire._replace(parts=(*others, painted), part=part)
    found = own_garments(file, replace(wearer, attire=attire))
    assert found.stiff["painted"] == "It is painted on the skin, or one mesh with it."


def test_cloth_deep_in_the_body_is_told_to_be_none(body: BodyModel, shelf: dict[str, Garment]):
    parts = dressed_parts(body, {"top": shelf["tank"]}, rucksack=False)
    sunk = parts[-1]._replace(vertices=parts[-1].vertices * [0.2, 1.0, 0.2])
    payload = dressed_character(body, [*parts[:-1], sunk])
    found = own_garments(payload, read_wearer(payload, name="sunk", body=body))
    assert not found.garments
    (why,) = found.stiff.values()
    assert why == "It lies inside of the body that we lay below it."


def test_what_lies_deep_in_the_body_and_small_pieces_stay(body: BodyModel, shelf: dict[str, Garment]):
    """Shorts whose upper end is drawn in to the trunk, and a bracelet that is called trousers too."""
    parts = dressed_parts(body, {"trousers": shelf["shorts"]}, rucksack=False)
    hips = body.joints_template[[1, 2]].mean(axis=0)
    cloth = parts[-1]
    high = cloth.vertices[:, 1] > hips[1]
    drawn_in = np.where(high[:, None], hips + 0.1 * (cloth.vertices - hips) * [1.0, 10.0, 1.0], cloth.vertices)
    away = cloth.vertices[:300] * [0.01, 0.01, 0.01] + body.joints_template[20] + [0.0, 0.2, 0.0]
    faces = np.concatenate([cloth.faces, cloth.faces[(cloth.faces < 300).all(axis=1)] + len(drawn_in)])
    weights = np.concatenate([cloth.weights, cloth.weights[:300]])
    both = cloth._replace(vertices=np.concatenate([drawn_in, away]), faces=faces, weights=weights)
    payload = dressed_character(body, [*parts[:-1], both])
    worn = read_wearer(payload, name="drawn_in", body=body)
    whole, buried = worn.attire.of_kinds(("trousers",)), _buried(worn, worn.body, ["trousers"])
    kept = _large_pieces(worn, np.flatnonzero(whole & ~buried))
    middle = worn.vertices[worn.faces].mean(axis=1).astype(np.float64)
    depth = -signed_distance(middle, worn.body.v_template, worn.body.faces)
    assert (buried <= whole).all() and (depth[buried] > 0.0).mean() > 0.9
    assert (depth[kept] < BURIED_M).mean() > 0.97 and 0.3 * whole.sum() < len(kept) < 0.95 * whole.sum()
    assert (np.abs(middle[kept, 0]) < 0.4).all(), "no bracelet"


def test_ours_replace_what_they_take_off(own: OwnGarments, wearer: Wearer, body: BodyModel, shelf: dict[str, Garment]):
    trousers, top = own.garments
    assert split_own(own.garments, Halves(False, False)) == ([trousers], [top])
    assert split_own(own.garments, Halves(True, False)) == ([trousers], [])
    assert split_own(own.garments, Halves(False, True)) == ([], [top])
    worn = [trousers, shelf["tshirt"]]
    assert halves_on(wearer, worn, body) == (True, True)
    cloth = [(one.vertices, one.faces) for one in worn]
    left = undress(wearer, own_faces(wearer, worn), cloth, halves_of([shelf["tshirt"]], body))
    assert kinds_of(wearer, left.off) == {"top", "trousers", "carried", "dress"}
    only_top = undress(wearer, own_faces(wearer, [top]), cloth, Halves(False, False))
    assert kinds_of(wearer, only_top.off) == {"top"}


def kinds_of(wearer: Wearer, faces: np.ndarray) -> set[str]:
    return {wearer.attire.parts[number].kind for number in np.unique(wearer.attire.part[faces])}


def test_they_are_cut_for_the_body_below_them(
    own: OwnGarments, wearer: Wearer, body: BodyModel, shelf: dict[str, Garment]
):
    """A top over trousers that stay on lies on another body than one over bare legs."""
    top = own.garments[1]
    bare, over = (wearer.body_under(Halves(True, lower)) for lower in (True, False))
    assert body_of(top, wearer, body) is bare
    assert body_of(shelf["tank"], wearer, body) is body
    assert tailored(top, bare, bare) is top
    moved = tailored(top, bare, over)
    assert moved.body_digest == over.digest != bare.digest
    assert np.abs(moved.vertices - top.vertices).max() < 0.05


def test_its_file_has_its_clothes_as_cloth_alone(file: bytes, wearer: Wearer, tmp_path: Path):
    """By the command: over a clip at rest, cloth lies where the file's own faces were, and these are gone."""
    (tmp_path / "me.glb").write_bytes(file)
    np.savez(tmp_path / "stop.npz", poses=np.zeros((2, 24, 3)), trans=np.zeros((2, 3)), mocap_framerate=30.0, up="y")
    words = [
        "wear",
        "--on",
        str(tmp_path / "me.glb"),
        str(tmp_path / "stop.npz"),
        "--alive",
        "--as-recorded",
        "--tier",
        "instant",
    ]
    assert main([*words, "--rig", "--out", str(tmp_path / "out.glb")]) == 0
    made = Reader((tmp_path / "out.glb").read_bytes())
    own, *garments = made.json["meshes"]
    assert [one["name"] for one in garments] == ["bare skin", "me~trousers", "me~top"]
    drawn = {
        made.json["materials"][one["material"]]["name"]: made.array(one["indices"]).size // 3
        for one in own["primitives"]
    }
    parts = {part.kind: part.faces for part in wearer.attire.parts}
    assert [drawn[MAKERS["vroid"][kind]] for kind in ("top", "trousers")] == [1, 1], "one without area"
    assert [drawn[MAKERS["vroid"][kind]] for kind in ("hair", "shoes", "skirt")] == [
        parts[kind] for kind in ("hair", "shoes", "skirt")
    ]
    assert 0 < drawn[MAKERS["vroid"]["skin"]] < parts["skin"], "what lies deep below cloth is gone too"
    for number, kind in ((2, "trousers"), (3, "top")):
        rows = wearer.attire.of_kinds((kind,))
        off = closest_point(made.skinned(2, mesh=number)[0] * wearer.scale, wearer.vertices, wearer.faces[rows])
        assert np.median(off.distance) < 0.01


def test_own_clothes_need_a_character():
    with pytest.raises(InputError, match="a character"):
        drape.load().wear("tank", alive=True)
    with pytest.raises(InputError, match="garments on a character"):
        drape.load().wear("tank", tier="instant").glb("walk")


def test_a_character_without_cloth_says_why(body: BodyModel, tmp_path: Path):
    path = tmp_path / "me.glb"
    parts = dressed_parts(body, {})
    bag = parts[-1]
    path.write_bytes(dressed_character(body, [*parts, Worn("skirt", bag.vertices, bag.faces, bag.weights)]))
    with pytest.raises(InputError, match="One bone moves all of it"):
        drape.load().wear(on=path, alive=True)
