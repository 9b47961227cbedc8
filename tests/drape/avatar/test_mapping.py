"""Joints of rigs whose names nobody knows, by where they are; and figures that are no person."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse

from drape.avatar.character import Character, character_in
from drape.avatar.mapping import SWAPPED, map_joints
from drape.avatar.shape_joints import joints_by_shape
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.errors import MotionError
from drape.files.data import data_folder
from drape.files.formats import AVATAR_SUFFIXES
from drape.files.gltf import GltfFile
from drape.motion.t_pose import CANONICAL_FLOOR, CANONICAL_JOINTS
from tests.fixtures.characters import ARMS_DOWN_RAD, character

LIMBS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
NEEDED = ("pelvis", "spine1", "spine2", "spine3", *(f"{side}_{one}" for side in ("left", "right") for one in LIMBS))


def nameless(found: Character) -> Character:
    """``found`` under names that say nothing."""
    names = tuple(f"bone_{number:03d}" for number in range(len(found.names)))
    return replace(found, names=names, humanoid={})


@pytest.mark.parametrize("arms_rad", [0.0, ARMS_DOWN_RAD])
@pytest.mark.parametrize("yaw_rad", [0.0, np.pi, 0.5])
def test_a_body_without_names_has_the_joints_that_names_tell(body: BodyModel, arms_rad: float, yaw_rad: float):
    found = character_in(GltfFile(character(body, arms_rad=arms_rad, yaw_rad=yaw_rad, scale=0.01)))
    wanted, got = map_joints(found, body), map_joints(nameless(found), body)
    assert (wanted.by, wanted.confidence, got.by) == ("names", 1.0, "shape") and 0.7 < got.confidence < 1.0
    assert {joint: got.rig.sources[joint] for joint in NEEDED} == {joint: wanted.rig.sources[joint] for joint in NEEDED}
    np.testing.assert_allclose(got.rig.alignment, wanted.rig.alignment, atol=1e-9)


@pytest.mark.skipif(data_folder("avatars") is None, reason="No DRAPE_DATA with characters.")
def test_characters_of_others_have_by_shape_the_joints_that_names_tell(body: BodyModel):
    folder = data_folder("avatars")
    assert folder is not None
    for path in sorted(one for one in folder.iterdir() if one.suffix in AVATAR_SUFFIXES):
        found = character_in(GltfFile(path.read_bytes()))
        wanted, got = map_joints(found, body).rig.sources, joints_by_shape(nameless(found)).sources
        wrong = [joint for joint in NEEDED if got.get(joint) != wanted[joint]]
        assert not wrong, (path.name, wrong)


def test_twist_bones_and_rolls_are_passed_over(body: BodyModel):
    found = nameless(character_in(GltfFile(character(body))))
    want = map_joints(character_in(GltfFile(character(body))), body).rig.sources
    for joint, end in (("left_shoulder", "left_elbow"), ("left_hip", "left_knee"), ("right_elbow", "right_wrist")):
        found = with_twist(found, want[joint], want[end])
    got = joints_by_shape(found).sources
    assert {joint: got[joint] for joint in NEEDED} == {joint: want[joint] for joint in NEEDED}


def with_twist(found: Character, node: int, end: int) -> Character:
    """``found`` with a node half-way from ``node`` to ``end``, at the end of the list, that moves half of the skin."""
    world = np.concatenate([found.world, found.world[node : node + 1]])
    world[-1, :3, 3] = 0.5 * (found.places[node] + found.places[end])
    own = np.asarray(found.weights.argmax(axis=1)).reshape(-1) == node
    way = np.linalg.norm(found.vertices - found.places[end], axis=1)
    far = own & (way < np.linalg.norm(world[-1, :3, 3] - found.places[end]))
    weights = scipy.sparse.lil_matrix((len(found.vertices), len(world)))
    weights[:, :-1] = found.weights
    weights[far, :] = 0.0
    weights[far, len(world) - 1] = 1.0
    return replace(
        found, names=(*found.names, "bone_twist"), parents=(*found.parents, node), world=world, weights=weights.tocsr()
    )


def test_what_is_told_wins_over_places(body: BodyModel):
    found = nameless(character_in(GltfFile(character(body))))
    spine = found.names[joints_by_shape(found).sources["spine2"]]
    got = map_joints(found, body, joints={"spine3": spine})
    assert got.by == "shape" and found.names[got.rig.sources["spine3"]] == spine
    whole = {joint: found.names[node] for joint, node in got.rig.sources.items()}
    again = map_joints(found, body, joints=whole)
    assert again.by == "told" and again.rig.sources == got.rig.sources


def test_left_and_right_that_are_swapped_are_told(body: BodyModel):
    found = character_in(GltfFile(character(body, scheme="unreal")))
    assert map_joints(found, body).notes == ()
    other = {"l": "r", "r": "l"}
    names = tuple(f"{name[:-1]}{other[name[-1]]}" if name[-2:] in ("_l", "_r") else name for name in found.names)
    assert map_joints(replace(found, names=names), body).notes == (SWAPPED,)


# --- what is no person ---


def figure(bones: Mapping[str, tuple[str, tuple[float, float, float]]]) -> Character:
    """A figure of ``bones``, name: (parent, place), each with a ball of skin around it and along it."""
    names = tuple(bones)
    parents = tuple(names.index(above) if above else -1 for above, _ in bones.values())
    world = np.tile(np.eye(4), (len(names), 1, 1))
    world[:, :3, 3] = [place for _, place in bones.values()]
    ball = 0.03 * np.random.default_rng(1).normal(size=(40, 3)).clip(-1.0, 1.0)
    vertices = np.concatenate([ball + place for place in world[:, :3, 3]])
    owner = np.repeat(np.arange(len(names)), len(ball))
    weights = scipy.sparse.csr_matrix((np.ones(len(owner)), (np.arange(len(owner)), owner)), (len(owner), len(names)))
    return Character(names, parents, world, vertices, np.zeros((0, 3), int), weights, {}, "")


def person(without: tuple[str, ...] = (), shift: tuple[float, float, float] = (0.0, 0.0, 0.0), mark: str = "") -> dict:
    """The bones of a person, without those whose names begin with ``without``, moved by ``shift``."""
    places = CANONICAL_JOINTS - [0.0, CANONICAL_FLOOR, 0.0]
    found = {}
    for joint, name in enumerate(JOINT_NAMES):
        if not name.endswith(without or ("-",)):
            above = JOINT_NAMES[PARENTS[joint]] if joint else ""
            found[mark + name] = (mark + above if above else "", tuple(places[joint] + shift))
    return found


def horse() -> dict:
    bones = {"root": ("", (0.0, 1.0, -0.6)), "spine": ("root", (0.0, 1.0, 0.0)), "neck": ("spine", (0.0, 1.1, 0.6))}
    bones["head"] = ("neck", (0.0, 1.5, 0.9))
    for above, z in (("root", -0.6), ("neck", 0.5)):
        for side in (-0.2, 0.2):
            leg = [f"{above} {side} {part}" for part in range(3)]
            for part, (name, height) in enumerate(zip(leg, (0.9, 0.5, 0.02), strict=True)):
                bones[name] = (leg[part - 1] if part else above, (side, height, z))
    return bones


def pair() -> dict:
    return {"scene": ("", (0.0, 0.0, 0.0)), **{
        name: (above or "scene", place) for mark, shift in (("a ", -0.8), ("b ", 0.8))
        for name, (above, place) in person(shift=(shift, 0.0, 0.0), mark=mark).items()}}  # fmt: skip


def loose() -> dict:
    return {**person(shift=(-0.8, 0.0, 0.0), mark="a "), **person(shift=(0.8, 0.0, 0.0), mark="b ")}


def stumps() -> dict:
    """A person whose arms end three centimetres beyond the shoulders."""
    bones = person()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        _, (x, y, z) = bones[f"{side}_shoulder"]
        for joint, way in (("elbow", 0.01), ("wrist", 0.02), ("hand", 0.03)):
            bones[f"{side}_{joint}"] = (bones[f"{side}_{joint}"][0], (x + sign * way, y, z))
    return bones


def column() -> dict:
    """A person all of whose joints lie in the middle."""
    return {name: (above, (0.0, *place[1:])) for name, (above, place) in person().items()}


def arms_below() -> dict:
    """A person whose arms hang on a node between the knees, as its pelvis does."""
    bones = {name: (above or "root", place) for name, (above, place) in person().items()}
    for side in ("left", "right"):
        bones[f"{side}_collar"] = ("root", bones[f"{side}_collar"][1])
    return {"root": ("", (0.0, 0.4, 0.0)), **bones}


def legs_alone() -> dict:
    """Hips and what hangs on them."""
    return {name: bone for name, bone in person().items() if name == "pelvis" or name.endswith(LEGS)}


LEGS = ("hip", "knee", "ankle", "foot")
ARMS = ("collar", "shoulder", "elbow", "wrist", "hand")
FIGURES: dict[str, tuple[Callable[[], dict], str]] = {
    "four legs": (horse, "two legs"),
    "two people under one node": (pair, "two legs"),
    "two skeletons": (loose, "one skeleton"),
    "no arms": (lambda: person(without=ARMS), "two arms"),
    "arms of one bone": (lambda: person(without=ARMS[2:]), "shoulder, elbow and wrist"),
    "legs of one bone": (lambda: relinked(("knee", "foot")), "hip, knee and ankle"),
    "arms below the hips": (arms_below, "arms above the legs"),
    "legs alone": (legs_alone, "two arms"),
    "stumps": (stumps, "limbs of a person"),
    "one column": (
        lambda: {name: (above, (0.0, *place[1:])) for name, (above, place) in person().items()},
        "hips beside",
    ),
}


def relinked(without: tuple[str, ...]) -> dict:
    """A person without some joints, whose children hang on what is above."""
    bones = person()
    found = {}
    for name, (above, place) in bones.items():
        while above.endswith(without):
            above = bones[above][0]
        if not name.endswith(without):
            found[name] = (above, place)
    return found


def test_the_figure_of_the_refusals_is_a_person():
    found = figure(person())
    assert joints_by_shape(found).sources["left_elbow"] == found.names.index("left_elbow")


@pytest.mark.parametrize("kind", FIGURES)
def test_what_is_no_person_is_refused_with_the_cure(body: BodyModel, kind: str):
    make, said = FIGURES[kind]
    with pytest.raises(MotionError, match=said) as refused:
        joints_by_shape(figure(make()))
    assert "Rename the joints" in refused.value.cure
