"""What is what on a character: on made ones, whose parts are known, under many makers' names and under none."""

from __future__ import annotations

import numpy as np
import pytest

from drape.avatar.attire import Attire, attire_of
from drape.avatar.attire_words import KINDS, WORDS, kind_of_names
from drape.avatar.character import character_in
from drape.avatar.face_colours import face_colours
from drape.avatar.mapping import map_joints
from drape.avatar.t_pose import to_t_pose
from drape.body.model import BodyModel
from drape.catalog import find_garments, open_garment
from drape.errors import NotFound
from drape.files.gltf import GltfFile
from drape.garment.cache import Garment
from tests.fixtures.characters import with_json
from tests.fixtures.dressed_characters import MAKERS, Worn, dressed_character, dressed_parts

RIGHT = 0.95


@pytest.fixture(scope="module")
def shelf(body: BodyModel) -> dict[str, Garment]:
    names = ("tshirt", "trousers", "skirt", "dress")
    return {name: open_garment(find_garments([name])[0], body) for name in names}


@pytest.fixture(scope="module")
def outfits(body: BodyModel, shelf: dict[str, Garment]) -> dict[str, list[Worn]]:
    """A character in each of some clothes, by what these are."""
    worn: dict[str, tuple[str, ...]] = {"trousers": ("tshirt", "trousers"), "skirt": ("tshirt", "skirt")}
    worn |= {"dress": ("dress",)}
    kinds: dict[str, str] = {"tshirt": "top"}
    return {
        name: dressed_parts(body, {kinds.get(one, one): shelf[one] for one in of}, cut_away=name == "trousers")
        for name, of in worn.items()
    }


def told(payload: bytes, body: BodyModel, kinds: dict[str, str] | None = None) -> tuple[Attire, np.ndarray]:
    """The attire of a character, and which triangle of its file each face is."""
    file = GltfFile(payload)
    character = character_in(file)
    pose = to_t_pose(character, map_joints(character.skinned, body).rig)
    assert character.triangle is not None
    colours = face_colours(file, character.primitives)[character.triangle]
    return attire_of(file, character, pose, colours, corrections=kinds), character.triangle


def share_right(attire: Attire, triangle: np.ndarray, parts: list[Worn]) -> float:
    """The share of faces whose kind is that of the made part; a face in the colour of skin is skin too."""
    true = np.repeat([part.kind for part in parts], [len(part.faces) for part in parts])[triangle]
    found = np.array([part.kind for part in attire.parts])[attire.part]
    return float(((found == true) | (np.isin(found, ["skin", "face"]) & np.isin(true, ["skin", "face"]))).mean())


@pytest.mark.parametrize("maker", [maker for maker, names in MAKERS.items() if names and maker != "costume"])
def test_names_of_makers_tell_their_kinds(maker: str):
    assert [kind_of_names([name]) for name in MAKERS[maker].values()] == list(MAKERS[maker])


OUTFITS = ("trousers", "skirt", "dress")
BY_SHAPE = [(maker, outfit) for maker in ("costume", "nameless") for outfit in OUTFITS]  # one name, or none, for all


@pytest.mark.parametrize(("maker", "outfit"), [("vroid", "trousers"), ("mmd", "dress"), *BY_SHAPE])
def test_faces_are_rightly_told(maker: str, outfit: str, body: BodyModel, outfits: dict[str, list[Worn]]):
    parts = outfits[outfit]
    assert share_right(*told(dressed_character(body, parts, maker=maker), body), parts) >= RIGHT


def test_a_client_corrects_a_part(body: BodyModel, outfits: dict[str, list[Worn]]):
    payload = dressed_character(body, outfits["dress"])
    before, _ = told(payload, body)
    name = next(part.name for part in before.parts if part.kind == "dress")
    after, _ = told(payload, body, {name: "outer"})
    changed = next(part for part in after.parts if part.name == name)
    assert (changed.kind, changed.sure) == ("outer", 1.0) and np.array_equal(before.part, after.part)


@pytest.mark.parametrize("wrong", [{"no such part": "hair"}, {"Character/N00_000_Hair_00_HAIR (Instance)": "wig"}])
def test_an_unknown_part_or_kind_is_refused(wrong: dict[str, str], body: BodyModel, outfits: dict[str, list[Worn]]):
    with pytest.raises(NotFound):
        told(dressed_character(body, outfits["dress"]), body, wrong)


def test_what_hangs_on_a_hand_is_carried_and_on_the_head_a_hat(body: BodyModel, outfits: dict[str, list[Worn]]):
    """Meshes without a skin and without a name that tells."""

    def hang(document: dict) -> None:
        primitive = {"attributes": {"POSITION": document["meshes"][0]["primitives"][-1]["attributes"]["POSITION"]}}
        primitive["indices"] = document["meshes"][0]["primitives"][-1]["indices"]
        document["meshes"].append({"primitives": [primitive]})
        for joint in ("head", "right_wrist"):
            (bone,) = [one for one in document["nodes"] if one["name"] == joint]
            bone.setdefault("children", []).append(len(document["nodes"]))
            document["nodes"].append({"name": f"at {joint}", "mesh": len(document["meshes"]) - 1})

    attire, _ = told(with_json(dressed_character(body, outfits["dress"]), hang), body)
    kinds = {part.name: part.kind for part in attire.parts}
    assert kinds["at head"] == "hat" and kinds["at right_wrist"] == "carried"


def test_skin_has_the_colour_of_its_faces(body: BodyModel, outfits: dict[str, list[Worn]]):
    attire, _ = told(dressed_character(body, outfits["dress"]), body)
    assert np.allclose(attire.skin_colour, (0.896, 0.779, 0.696), atol=2e-3)  # sRGB of the linear (0.78, 0.57, 0.44)


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["M_Joints.001", "Mannequin"], "doll"), (["Barbarian_Hat"], "hat"), (["1H_Axe_Offhand"], "carried"),
        (["TShirt_low"], "top"), (["Human-male_casualsuit01"], "dress"), (["hair_ribbon_bag"], "carried"),
        (["No Name", "Body"], None), ([None, ""], None), (["Wolf3D_Outfit"], "cloth"), (["F00_EyeIris_00_EYE"], "face"),
    ],
)  # fmt: skip
def test_names_tell_kinds(names: list[str | None], kind: str | None):
    assert kind_of_names(names) == kind


def test_no_word_has_two_kinds():
    words = [word for line in WORDS.values() for word in line.split()]
    assert len(words) == len(set(words)) and set(WORDS) - set(KINDS) == {"cloth", "doll"}
