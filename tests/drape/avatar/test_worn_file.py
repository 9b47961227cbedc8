"""A character's own file with garments on joints: what it had stays, and players move it as we say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.affine_maps import compose
from drape.avatar.character import tree_of
from drape.avatar.distilled import DrapedClip, distil, pelvis_places
from drape.avatar.joint_file import Jointed
from drape.avatar.joint_springs import JointSprings, fit_springs, leg_capsules, sink_depths
from drape.avatar.rig_motion import RigClip, rig_motion
from drape.avatar.rig_weights import HEAVIEST
from drape.avatar.wearer import Wearer, read_wearer
from drape.avatar.worn_file import worn_glb, worn_vrm
from drape.body.model import BodyModel
from drape.errors import InputError
from drape.files.gltf import GltfFile
from drape.garment.cache import Garment
from drape.motion.spring_bones import Capsules, Springs
from tests.drape.avatar.test_joint_file import COLOUR, FRAMES, swaying, to_world
from tests.fixtures.characters import character, with_json
from tests.fixtures.glb_reader import Reader, khronos_complaints
from tests.fixtures.poses import smooth_motion
from tests.fixtures.three_vrm import played

COUNT = 4


def listed(document: dict[str, Any]) -> None:
    """What three-vrm wants of a VRM besides its bones, and springs and a clip of its own."""
    extensions = document["extensions"]
    document["extensionsUsed"] = list(extensions)
    if "VRM" in extensions:
        extensions["VRM"] |= {"meta": {"title": "one"}, "materialProperties": [{"name": "skin", "shader": "own"}]}
        extensions["VRM"]["secondaryAnimation"] = {"boneGroups": [], "colliderGroups": [{"node": 0, "colliders": []}]}
        return
    extensions["VRMC_vrm"]["meta"] = {"name": "one", "authors": ["us"], "licenseUrl": "https://vrm.dev/licenses/1.0/"}
    own = {"node": 1, "stiffness": 1.0, "gravityPower": 0.0, "dragForce": 0.4, "hitRadius": 0.0}
    extensions["VRMC_springBone"] = {"specVersion": "1.0", "springs": [{"joints": [own, {"node": 4}]}]}


@pytest.fixture(scope="module", params=["0", "1"])
def payload(request: pytest.FixtureRequest, body: BodyModel) -> bytes:
    return character(body, vrm=request.param, arms_rad=0.5, yaw_rad=np.pi, change=listed)


@pytest.fixture(scope="module")
def worn(payload: bytes, body: BodyModel) -> Wearer:
    return read_wearer(payload, name="somebody", body=body)


@pytest.fixture(scope="module")
def clip(worn: Wearer, tube: Garment) -> DrapedClip:
    poses, trans = smooth_motion(np.arange(FRAMES) / 30.0)
    assert worn.file is not None
    motion = rig_motion(RigClip(*worn.to_rig(poses, trans), 60.0), worn, worn.file.skeleton)
    return DrapedClip(swaying(tube, worn, poses, trans, seed=0), motion)


def make_all_springs(patch: pytest.MonkeyPatch) -> None:
    for name in ("BETTER", "WORST"):
        patch.setattr(f"drape.avatar.joint_springs.{name}", np.inf)


@pytest.fixture(scope="module")
def made(worn: Wearer, clip: DrapedClip, tube: Garment) -> tuple[Jointed, JointSprings]:
    assert worn.file is not None
    distilled = distil(tube, [clip], worn, worn.file, count=COUNT)
    with pytest.MonkeyPatch.context() as patch:
        make_all_springs(patch)
        return Jointed(tube.surface, distilled, COLOUR), fit_springs(distilled, [clip], worn)


def test_what_the_file_had_stays(payload: bytes, made: tuple[Jointed, JointSprings], clip: DrapedClip, worn: Wearer):
    was = Reader(payload)
    for content in (
        worn_glb(payload, made[:1], [clip.vertices], clip.motion, worn.scale).to_bytes(),
        worn_vrm(payload, [made]).to_bytes(),
    ):
        now = Reader(content)
        assert now.binary[: len(was.binary)] == was.binary
        for key in ("meshes", "skins", "materials", "accessors", "bufferViews"):
            assert now.json[key][: len(was.json[key])] == was.json[key]
        for before, after in zip(was.json["nodes"], now.json["nodes"], strict=False):
            kept = dict(after)
            kept["children"] = after.get("children", [])[: len(before.get("children", []))]
            assert kept == before | {"children": before.get("children", [])}
        for name, told in was.json["extensions"].items():
            assert now.json["extensions"][name].keys() >= told.keys()
        assert [one["name"] for one in now.json["materials"]] == [
            *(one["name"] for one in was.json["materials"]), *(tube_materials(made[0]))]  # fmt: skip


def tube_materials(layer: Jointed) -> tuple[str, ...]:
    return layer.surface.material_names or (layer.surface.name,)


def test_the_glb_shows_character_and_garment_in_the_clip(
    payload: bytes, made: tuple[Jointed, JointSprings], clip: DrapedClip, worn: Wearer, tmp_path: Path
):
    content = worn_glb(payload, made[:1], [clip.vertices], clip.motion, worn.scale).to_bytes()
    file, distilled = Reader(content), made[0].distilled
    want = to_world(clip.motion, distilled.placed(clip.motion, distilled.fitted(clip, worn.scale)), worn.scale)
    shown = file.skinned(FRAMES, mesh=len(file.json["meshes"]) - 1)[:, : len(want[0])]
    assert np.abs(shown * worn.scale - want).max() < 1e-4
    before = {one["code"] for one in khronos_complaints(payload, tmp_path)}
    assert {one["code"] for one in khronos_complaints(content, tmp_path)} <= before


@pytest.mark.parametrize("hindered", [False, True])
def test_three_vrm_moves_the_springs_as_we_do(
    payload: bytes, made: tuple[Jointed, JointSprings], clip: DrapedClip, tmp_path: Path, hindered: bool
):
    """With legs so thick that tails are in them, VRM 0's spheres are not quite our capsules."""
    layer, springs = made
    legs = tuple(replace(limb, radius=0.3 if hindered else 0.01) for limb in springs.limbs[::2])
    springs = loose(replace(springs, limbs=legs, felt=np.full((COUNT, 2), hindered)))
    content = worn_vrm(payload, [(layer, springs)]).to_bytes()
    file = Reader(content)
    names = [node.get("name") for node in file.json["nodes"]]
    own = [names.index(f"{layer.surface.name}_{number:02d}") for number in range(COUNT)]
    order, _ = tree_of(GltfFile(payload))
    version, count, at = played(content, clip.motion, list(map(int, order)), own, tmp_path)
    assert count >= COUNT
    moves = compose(pelvis_places(clip.motion)[:, None], springs.moves(clip.motion))
    heads, tails = (
        np.einsum("feab,eb->fea", moves[..., :3], point) + moves[..., 3]
        for point in (springs.distilled.pivots, springs.tails)
    )
    assert_allclose(at[..., :3, 3], heads, atol=1e-5)
    way = springs.tails - springs.distilled.pivots
    shown = np.einsum("feab,eb->fea", at[..., :3, :3], way) + at[..., :3, 3]
    assert np.abs(shown - tails).max() < (0.03 if hindered and version == "0" else 1e-5)
    assert np.abs(tails - stiff_tails(springs, clip)).max() > 0.01


def loose(springs: JointSprings) -> JointSprings:
    """Springs of the grid's numbers, so soft that they swing."""
    return replace(springs, numbers=Springs(*(np.full(COUNT, one) for one in (0.2, 0.2, 0.1, 0.0))))


def stiff_tails(springs: JointSprings, clip: DrapedClip) -> np.ndarray:
    """Where the tails (F, E, 3) are in the world of joints that only follow the rig."""
    at = compose(pelvis_places(clip.motion)[:, None], springs.distilled.carried(clip.motion))
    return np.einsum("feab,eb->fea", at[..., :3], springs.tails) + at[..., 3]


def test_numbers_of_springs_are_found_again(made: tuple[Jointed, JointSprings], clip: DrapedClip, worn: Wearer):
    """Cloth that swings by the law is followed by what is fitted to it far better than by the rig."""
    distilled, springs = made[0].distilled, loose(made[1])
    swung = to_world(clip.motion, distilled.placed(clip.motion, springs.moves(clip.motion)), worn.scale)
    draped = DrapedClip(swung, clip.motion)
    fitted = fit_springs(distilled, [draped], worn)
    ways = (fitted.distilled, fitted.moves(clip.motion)), (distilled, distilled.carried(clip.motion))
    errors = [one.error_m(draped, moves, worn.scale) for one, moves in ways]
    assert errors[0] < 0.4 * errors[1]


def test_joints_that_would_move_cloth_worse_than_the_rig_are_no_springs(
    made: tuple[Jointed, JointSprings], clip: DrapedClip, worn: Wearer
):
    """Of cloth that is draped as the rig's own weights have it."""
    distilled, none = made[0].distilled, np.zeros((FRAMES, 0, 3, 4))
    on_rig = replace(distilled, weights=distilled.on_rig, parents=distilled.parents[:0])
    draped = DrapedClip(to_world(clip.motion, on_rig.placed(clip.motion, none), worn.scale), clip.motion)
    with pytest.MonkeyPatch.context() as patch:
        make_all_springs(patch)
        all_sprung = fit_springs(distilled, [draped], worn)
    fitted = fit_springs(distilled, [draped], worn)
    assert fitted.distilled.count < all_sprung.distilled.count == COUNT
    errors = [one.distilled.error_m(draped, one.moves(clip.motion), worn.scale) for one in (fitted, all_sprung)]
    assert errors[0] < errors[1]


def test_springs_that_one_clip_alone_wants_are_none(
    made: tuple[Jointed, JointSprings], clip: DrapedClip, worn: Wearer, monkeypatch: pytest.MonkeyPatch
):
    """One clip has cloth as springs swing it, the other as the rig's own weights have it."""
    distilled, none = made[0].distilled, np.zeros((FRAMES, 0, 3, 4))
    on_rig = replace(distilled, weights=distilled.on_rig, parents=distilled.parents[:0])
    places = distilled.placed(clip.motion, loose(made[1]).moves(clip.motion)), on_rig.placed(clip.motion, none)
    clips = [DrapedClip(to_world(clip.motion, placed, worn.scale), clip.motion) for placed in places]
    held = fit_springs(distilled, clips, worn).distilled.count
    monkeypatch.setattr("drape.avatar.joint_springs.WORST", np.inf)
    assert held < fit_springs(distilled, clips, worn).distilled.count


def test_a_file_of_no_springs_has_the_garment_on_the_rig(
    payload: bytes, made: tuple[Jointed, JointSprings], clip: DrapedClip, worn: Wearer, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("drape.avatar.joint_springs.BETTER", 0.0)
    fitted = fit_springs(made[0].distilled, [clip], worn)
    weights = fitted.distilled.weights
    assert fitted.distilled.count == 0 and (weights > 0.0).sum(axis=1).max() <= HEAVIEST
    assert_allclose(weights.sum(axis=1), 1.0)
    was, now = (Reader(one).json for one in (payload, worn_vrm(payload, [(made[0], fitted)]).to_bytes()))
    assert now["extensions"].get("VRMC_springBone") == was["extensions"].get("VRMC_springBone")
    assert len(now["nodes"]) == len(was["nodes"]) + 1 and len(now["meshes"]) == len(was["meshes"]) + 1


def test_cloth_sinks_by_what_it_is_deeper_than_it_was_draped():
    """In a limb as wide as 0.1 round the y axis: cloth outside of it may come as near as that."""
    draped, at = (np.zeros((4, 1, 1, 1, 3)) for _ in range(2))
    draped[..., 0], at[..., 0] = (
        np.reshape(one, (4, 1, 1, 1)) for one in ([0.12, 0.12, 0.05, 0.05], [0.11, 0.08, 0.03, 0.2])
    )
    start, end = (np.full((4, 1, 3), [0.0, y, 0.0]) for y in (-1.0, 1.0))
    legs = Capsules(start, end, np.array([0.1]), np.ones((1, 1), dtype=bool))
    assert_allclose(sink_depths(at, draped, legs).reshape(-1), [0.0, 0.02, 0.02, 0.0], atol=1e-12)


def test_what_a_character_wears_makes_its_legs_no_wider(clip: DrapedClip, worn: Wearer):
    """A wide skirt moves with the legs too, and its skin would be a leg of half a metre."""
    wide = replace(worn, vertices=worn.vertices * np.float32(3.0))
    for one, other in zip(leg_capsules(worn, clip.motion), leg_capsules(wide, clip.motion), strict=True):
        assert one.radius == other.radius


def test_materials_are_told_to_vrm_0(payload: bytes, made: tuple[Jointed, JointSprings]):
    file = Reader(worn_vrm(payload, [made]).to_bytes()).json
    if "VRM" in file["extensions"]:
        told = file["extensions"]["VRM"]["materialProperties"]
        assert [one["name"] for one in told[1:]] == [one["name"] for one in file["materials"][1:]]
        assert told[0] == {"name": "skin", "shader": "own"}


def test_a_plain_glb_is_no_vrm(body: BodyModel, made: tuple[Jointed, JointSprings]):
    with pytest.raises(InputError, match="a character in a VRM file"):
        worn_vrm(character(body), [made])


def test_a_file_in_pieces_is_refused(body: BodyModel, made: tuple[Jointed, JointSprings]):
    def apart(document: dict[str, Any]) -> None:
        document["buffers"].append({"byteLength": 1, "uri": "more.bin"})

    with pytest.raises(InputError, match="one buffer of its own"):
        worn_vrm(with_json(character(body, vrm="1"), apart), [made])
