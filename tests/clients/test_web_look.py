"""What a page shows, in Node.js: borders of panels, weaves, looks of fabrics, poses of characters."""

from __future__ import annotations

import base64
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.avatar.own_clothes import Halves, bare_faces, removed_faces
from drape.avatar.own_garments import Undressed, undress
from drape.avatar.rig_file import bare_file
from drape.avatar.wearer import Wearer, read_wearer
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.catalog import find_garments, open_garment
from drape.cloth.fabric_table import FABRICS
from drape.files.looks import Material
from drape.geometry.rotations import rotvec_to_matrix
from drape.geometry.skinning import skin_points
from drape.wire.mesh_messages import STEP_M, pack_mesh
from service.http.schemas import FabricInfo
from tests.clients.node import page_answer
from tests.drape.motion.rigs import rig_names
from tests.fixtures.characters import ARMS_DOWN_RAD, character
from tests.fixtures.dressed_characters import dressed_character, dressed_parts

BORDERS = """
const { unpackMesh } = await import(`${WEB}/lib/src/meshes.js`);
const { borderDistances } = await import(`${WEB}/lib/src/borders.js`);
const layer = unpackMesh(Uint8Array.from(Buffer.from(input.mesh, "hex")).buffer);
console.log(JSON.stringify({ uvMetres: layer.uvMetres, uv: [...layer.uv], distances: [...borderDistances(layer)] }));
"""


def two_panels(steps: int = 8, side_m: float = 0.08, unit: float = 0.5) -> bytes:
    """The MESH of two square panels sewn along x = side_m, flat; texture coordinates have ``unit`` to a metre and a gap
    between."""
    columns, rows = 2 * steps + 1, steps + 1
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) * (side_m / steps)
    corner = (y * columns + x)[:-1, :-1].ravel()
    right, up, both = corner + 1, corner + columns, corner + columns + 1
    faces = np.concatenate([np.stack([corner, right, both], 1), np.stack([corner, both, up], 1)])
    second = np.tile((x[:-1, :-1] >= steps).ravel(), 2)
    uv = np.concatenate([vertices[:, :2], vertices[:, :2] + [0.02, 0.0]]) * unit  # the second panel lies apart
    uv_faces = faces + second[:, None] * len(vertices)
    return pack_mesh(vertices, faces, uv, uv_faces)


def test_borders_are_as_far_as_they_are_in_the_panels(tmp_path: Path):
    got = page_answer(BORDERS, {"mesh": two_panels().hex()}, tmp_path)
    assert_allclose(got["uvMetres"], 2.0)
    u, v = np.reshape(got["uv"], (-1, 2)).T * 2.0  # [m]
    panel = u > 0.09
    hem = np.minimum.reduce([v, 0.08 - v, np.where(panel, 0.18 - u, u)])
    seam = np.where(panel, u - 0.10, 0.08 - u)
    expected = np.minimum(np.stack([hem, seam], axis=1), 0.06)
    assert_allclose(np.reshape(got["distances"], (-1, 2)), expected, rtol=0, atol=1.01 * STEP_M)  # of two corners


LOOKS = """
const { fabricLook, fabricSwatch } = await import(`${WEB}/lib/src/materials.js`);
const { BOND_NAMES, weaveTextures } = await import(`${WEB}/lib/src/weave.js`);
const tiles = BOND_NAMES.map((bond) => {
  const { normal, shade } = weaveTextures(bond);
  return [normal, shade].map(({ image }) => Buffer.from(image.data).toString("base64"));
});
const looks = input.fabrics.map(fabricLook);
const swatches = looks.map((look) => Buffer.from(fabricSwatch(look, "#808080", 32)).toString("base64"));
console.log(JSON.stringify({ looks, swatches, tiles, names: BOND_NAMES }));
"""


def test_a_look_follows_from_what_is_told_of_a_fabric(tmp_path: Path):
    fabrics = {
        name: {key: getattr(cloth, key) for key in FabricInfo.model_fields if key != "id"}
        for name, cloth in FABRICS.items()
    }
    asked = [{"id": name, **numbers} for name, numbers in fabrics.items()]
    unnamed = [{**numbers, "id": "of my own"} for numbers in fabrics.values()]
    got = page_answer(LOOKS, {"fabrics": [*asked, *unnamed]}, tmp_path)
    looks = dict(zip(fabrics, got["looks"], strict=False))
    knits = {name for name, look in looks.items() if look["knit"]}
    assert knits == {"jersey", "rib", "ponte", "sweat", "swim"}, "those whose source says a knit"
    assert {name: looks[name]["bond"] for name in ("denim", "satin", "rib", "poplin", "jersey")} == {
        "denim": "twill", "satin": "satin", "rib": "rib", "poplin": "plain", "jersey": "jersey",
    }  # fmt: skip
    for name, look in looks.items():
        assert 0.5 < look["pitchM"] / fabrics[name]["thickness_m"] < 2.0
        assert (look["opacity"] < 1.0) == (name == "chiffon")
    for name, look in zip(fabrics, got["looks"][len(fabrics) :], strict=True):  # by their numbers alone
        assert look["bond"] == ("jersey" if name in knits else "plain")


def test_a_weave_has_unit_normals_no_border_and_keeps_the_dye(tmp_path: Path):
    got = page_answer(LOOKS, {"fabrics": []}, tmp_path)
    for name, (normal, shade) in zip(got["names"], got["tiles"], strict=True):
        normals, shades = (
            np.frombuffer(base64.b64decode(one), np.uint8).reshape(256, 256, 4).astype(float) for one in (normal, shade)
        )
        towards = normals[..., :3] / 127.5 - 1.0
        assert_allclose(np.linalg.norm(towards, axis=-1), 1.0, atol=2 / 127.5)
        assert_allclose(towards[..., :2].mean(axis=(0, 1)), 0.0, atol=0.03, err_msg=name)
        assert 180 < shades[..., 0].mean() <= 201, name
        for axis in (0, 1):  # from the last pixel to the first it goes on as it does inside
            steps = np.abs(np.diff(shades[..., 0], axis=axis))
            around = np.abs(shades.take(0, axis=axis) - shades.take(-1, axis=axis))[..., 0]
            assert around.mean() <= steps.mean(axis=1 - axis).max() + 1.0, name


CHARACTER = """
globalThis.self = globalThis;
const { readCharacter } = await import(`${WEB}/lib/src/character.js`);
const { jointPlaces } = await import(`${WEB}/lib/src/kinematics.js`);
const { Vector3 } = await import(`${WEB}/node_modules/three/build/three.module.js`);
const bytes = Uint8Array.from(Buffer.from(input.file, "base64")).buffer;
const one = await readCharacter(bytes, input.avatar);
const places = input.poses.map((pose) => {
  one.pose(pose, input.root);
  one.object.updateMatrixWorld(true);
  return input.names.map((name) => {
    let found = null;
    one.object.traverse((node) => (found ??= node.userData.name === name || node.name === name ? node : null));
    return found.getWorldPosition(new Vector3()).toArray();
  });
});
const ours = input.poses.map((pose) => jointPlaces(pose, input.root, input.avatar.rest_joints));
console.log(JSON.stringify({ places, ours }));
"""


@pytest.mark.parametrize(("scale", "arms_rad", "yaw_rad"), [(1.0, 0.0, 0.0), (100.0, ARMS_DOWN_RAD, 1.0)])
def test_a_characters_joints_are_where_the_bodys_are(
    body: BodyModel, rng: np.random.Generator, tmp_path: Path, scale: float, arms_rad: float, yaw_rad: float
):
    """Whatever the unit, the way it faces, and however its arms hang at rest."""
    payload = character(body, scheme="mixamo", scale=scale, arms_rad=arms_rad, yaw_rad=yaw_rad)
    names = rig_names("mixamo")
    known = [joint for joint in JOINT_NAMES if joint in names]
    rest = body.joints_template
    poses = rng.normal(scale=0.4, size=(2, 24, 3)).astype(np.float32)
    root = [0.3, 1.1, -0.2]
    avatar = {"joints": {joint: names[joint] for joint in known}, "rest_joints": rest.tolist(), "scale": 1 / scale}
    document = {
        "file": base64.b64encode(payload).decode(), "avatar": avatar, "names": [names[joint] for joint in known],
        "poses": poses.reshape(2, 72).tolist(), "root": root,
    }  # fmt: skip
    got = page_answer(CHARACTER, document, tmp_path)
    turns, places = rotvec_to_matrix(poses.astype(np.float64)), np.zeros((2, 24, 3))
    world = turns.copy()
    places[:, 0] = root
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            world[:, joint] = world[:, parent] @ turns[:, joint]
            places[:, joint] = places[:, parent] + world[:, parent] @ (rest[joint] - rest[parent])
    assert_allclose(np.asarray(got["ours"]), places, atol=1e-6)
    index = [JOINT_NAMES.index(joint) for joint in known]
    assert_allclose(np.asarray(got["places"]), places[:, index], atol=2e-3)  # feet are turned by their heading alone


COVERED = """
globalThis.self = globalThis;
const { coverSkin } = await import(`${WEB}/lib/src/covered.js`);
const three = await import(`${WEB}/node_modules/three/build/three.module.js`);
const { Bone, BufferAttribute, BufferGeometry, Group, MeshStandardMaterial, Skeleton, SkinnedMesh } = three;
const skin = (name, count) => {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(9 * count), 3));
  if (count > 2) geometry.setIndex([...Array(3 * count).keys()].reverse());
  const mesh = new SkinnedMesh(geometry, new MeshStandardMaterial());
  mesh.name = name;
  mesh.bind(new Skeleton([new Bone()]));
  return mesh;
};
const [body, hand, hair] = [skin("Body", 4), skin("Hand", 4), skin("Hair", 2)];
const object = new Group().add(hand, body, hair);
const told = () => [body, hand, hair].map((mesh) => [
  mesh.geometry.index && [...mesh.geometry.index.array], mesh.children.map((twin) => [...twin.geometry.index.array]),
]);
const before = told();
const primitives = (ranges, more = []) => ({ deeper_m: 0.05, primitives: [
  { name: "Body", triangles: 4, ranges }, { name: "Hand", triangles: 4, ranges: [] },
  { name: "?", triangles: 2, ranges: more },
] });
const first = coverSkin(object, primitives([0, 2], [1, 1]));
const one = told();
const second = coverSkin(object, primitives([1, 2]));
const both = told();
first();
const left = told();
const [twin] = body.children;
const shader = { vertexShader: "void main() {\\n#include <project_vertex>\\n}" };
twin.material.onBeforeCompile(shader);
second();
const own = twin.material.customProgramCacheKey() !== body.material.customProgramCacheKey();
const after = told();
const gone = [{ name: "Body", triangles: 4, ranges: [0, 1], hidden: [1, 2] }];
const third = coverSkin(object, { deeper_m: 0.05, primitives: gone });
const hidden = told();
third();
console.log(JSON.stringify({ before, one, both, left, after, shader, own, hidden, last: told() }));
"""


def test_covered_skin_is_drawn_deeper_and_comes_back(tmp_path: Path):
    got = page_answer(COVERED, {}, tmp_path)
    own = np.arange(12)[::-1].reshape(4, 3)

    def of(covered: list[int]) -> list:
        flat, kept = np.repeat(own[:, :1], 3, axis=1), ~np.isin(np.arange(4), covered)
        return [np.where(mask[:, None], own, flat).ravel().tolist() for mask in (kept, ~kept)]

    for moment, covered in (("one", [0, 1]), ("both", [0, 1, 2]), ("left", [1, 2])):
        above, below = of(covered)
        assert got[moment][0] == [above, [below]], "each triangle has an area in one of the two meshes"
        assert got[moment][1] == [own.ravel().tolist(), []], "the hand has as many triangles and another name"
    assert got["one"][2] == [[0, 1, 2, 3, 3, 3], [[0, 0, 0, 3, 4, 5]]], "hair has no index of its own"
    above, below = (np.reshape(one, (4, 3)) for one in got["hidden"][0])
    assert (above[:3] == above[:3, :1]).all() and (below[1:] == below[1:, :1]).all(), "two of four are in neither"
    assert np.array_equal(above[3], own[3]) and np.array_equal(below[0], own[0])
    assert got["before"] == got["after"] == got["last"] and got["before"][2] == [None, []]
    assert "mvPosition + vec4(0.0, 0.0, -0.05000, 0.0)" in got["shader"]["vertexShader"] and got["own"]


BARE = """
globalThis.self = globalThis;
const { readCharacter } = await import(`${WEB}/lib/src/character.js`);
const { bareSkin } = await import(`${WEB}/lib/src/bare.js`);
const { Vector3 } = await import(`${WEB}/node_modules/three/build/three.module.js`);
const bytesOf = (text) => Uint8Array.from(Buffer.from(text, "base64")).buffer;
const one = await readCharacter(bytesOf(input.file), input.avatar);
const off = await bareSkin(one.object, bytesOf(input.bare));
one.pose(input.pose, input.root);
one.object.updateMatrixWorld(true);
let skin = null;
one.object.traverse((node) => (skin = node.name === "bare_skin" ? node : skin));
const at = [...Array(skin.geometry.attributes.position.count).keys()].map((i) =>
  skin.getVertexPosition(i, new Vector3()).applyMatrix4(skin.matrixWorld).toArray());
off();
console.log(JSON.stringify({ at, gone: skin.parent === null }));
"""


@pytest.fixture(scope="module")
def dressed(body: BodyModel) -> tuple[bytes, Wearer]:
    """A character in a top and a skirt with no skin below, and how it is worn."""
    own = {kind: open_garment(find_garments([name])[0], body) for kind, name in (("top", "tank"), ("skirt", "skirt"))}
    payload = dressed_character(body, dressed_parts(body, own, cut_away=True))
    return payload, read_wearer(payload, name="me", body=body)


def test_bare_skin_moves_with_the_character(dressed: tuple[bytes, Wearer], rng: np.random.Generator, tmp_path: Path):
    """Where players put it is where the body that was laid on the character is posed."""
    payload, wearer = dressed
    off = removed_faces(wearer.attire, Halves(True, False))
    chosen = bare_faces(wearer.body, wearer.vertices, wearer.faces, off)
    assert wearer.file is not None
    bare = bare_file(wearer, wearer.file, Undressed(off, chosen)).to_bytes()
    pose, root = rng.normal(scale=0.3, size=(1, 24, 3)).astype(np.float32), [0.3, 1.1, -0.2]
    avatar = {"joints": wearer.joints, "rest_joints": wearer.body.joints_template.tolist(), "scale": wearer.scale}
    document = {"file": base64.b64encode(payload).decode(), "bare": base64.b64encode(bare).decode(), "avatar": avatar}
    got = page_answer(BARE, document | {"pose": pose.reshape(72).tolist(), "root": root}, tmp_path)
    moves = wearer.body.bones(pose.astype(np.float64), np.array([root]) - wearer.body.joints_template[0])
    used = np.unique(wearer.body.faces[chosen])
    expected = skin_points(wearer.body.v_template[None], wearer.body.weights, *moves)[0, used]
    apart = np.linalg.norm(np.array(got["at"]) - expected, axis=1)
    assert len(used) > 500 and np.quantile(apart, 0.99) < 5e-3 and got["gone"]  # of four joints a vertex


TUCKED = """
const { readCharacter } = await import(`${WEB}/lib/src/character.js`);
const { bareSkin } = await import(`${WEB}/lib/src/bare.js`);
const bytesOf = (text) => Uint8Array.from(Buffer.from(text, "base64")).buffer;
const one = await readCharacter(bytesOf(input.file), input.avatar);
const found = () => {
  const meshes = [];
  one.object.traverse((node) => {
    const { name, material, userData } = node;
    if (userData.drapeCovered) meshes.push([name, /-0.05000/.test(material.customProgramCacheKey())]);
  });
  return meshes;
};
const off = await bareSkin(one.object, bytesOf(input.bare));
const on = found();
off();
console.log(JSON.stringify([on, found()]));
"""


def test_a_tucked_top_is_drawn_deeper_than_skin_that_is_bare(
    dressed: tuple[bytes, Wearer], body: BodyModel, tmp_path: Path
):
    payload, wearer = dressed
    none, trousers = np.zeros(len(wearer.faces), dtype=bool), open_garment(find_garments(["trousers"])[0], body)
    left = undress(wearer, none, [(trousers.vertices, trousers.faces)], Halves(False, True))
    assert wearer.file is not None
    bare = bare_file(wearer, wearer.file, left).to_bytes()
    avatar = {"joints": wearer.joints, "rest_joints": wearer.body.joints_template.tolist(), "scale": wearer.scale}
    document = {"file": base64.b64encode(payload).decode(), "bare": base64.b64encode(bare).decode(), "avatar": avatar}
    on, off = page_answer(TUCKED, document, tmp_path)
    assert sorted(on) == [["bare_skin", False], ["skin_under_garments", True], ["tucked_top", True]] and off == []


OVER = """
const { clothMaterial, fabricLook } = await import(`${WEB}/lib/src/materials.js`);
const shaders = [0, 0.008].map((nearerM) => {
  const material = clothMaterial(fabricLook(null), { colour: "#888888", bordered: true, plain: input.plain, nearerM });
  const vertexShader = "#include <begin_vertex> #include <project_vertex>";
  const shader = { vertexShader, fragmentShader: "", uniforms: {} };
  material.onBeforeCompile(shader);
  return [shader.vertexShader, material.customProgramCacheKey()];
});
console.log(JSON.stringify(shaders));
"""


@pytest.mark.parametrize("plain", [True, False])
def test_what_is_worn_over_something_is_drawn_nearer_from_outside(tmp_path: Path, plain: bool):
    (below, own), (over, other) = page_answer(OVER, {"plain": plain}, tmp_path)
    assert "gl_Position.z" not in below and "vBorder = border" in below and own != other
    assert "vBorder = border" in over, "borders are drawn as well"
    assert "0.00800 * smoothstep(0.0, 0.3, normalize(transformedNormal).z)" in over


PICTURED = """
const { withPictures } = await import(`${WEB}/lib/src/pictures.js`);
const { clothMaterial, fabricLook } = await import(`${WEB}/lib/src/materials.js`);
const made = [true, false].map((plain) => {
  const cloth = clothMaterial(fabricLook(null), { colour: "#808080", uvMetres: 1, plain });
  const { map, normalMap, alphaTest } = withPictures(cloth, input.look, new Map([[0, { width: 1, height: 1 }]]));
  const same = withPictures(cloth, null) === cloth;
  return { matrix: map.matrix.elements, normal: normalMap === map, alphaTest, same };
});
console.log(JSON.stringify(made));
"""


def test_pictures_lie_on_cloth_as_in_their_file(tmp_path: Path):
    look = Material(
        alpha_mode="MASK",
        alpha_cutoff=0.25,
        roughness=0.5,
        pictures={"base_colour": 0, "normal": 1},
        offset=(0.1, 0.2),
        rotation=0.3,
        scale=(2.0, 3.0),
    )
    for got in page_answer(PICTURED, {"look": asdict(look)}, tmp_path):
        uv = np.array([0.7, 0.4])  # from the lower left; KHR_texture_transform takes those from the upper left
        cos, sin = np.cos(0.3), np.sin(0.3)
        expected = [0.1, 0.2] + np.array([[cos, sin], [-sin, cos]]) @ ([2.0, 3.0] * np.array([uv[0], 1.0 - uv[1]]))
        matrix = np.reshape(
            list(got["matrix"].values()) if isinstance(got["matrix"], dict) else got["matrix"], (3, 3)
        ).T
        assert_allclose((matrix @ [*uv, 1.0])[:2], expected, rtol=1e-6)
        assert (got["normal"], got["alphaTest"], got["same"]) == (False, 0.25, True)
