"""GLB files hold what they were given: read back with a reader of the tests' own, and with pygltflib."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pygltflib
import pytest
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES, PARENTS
from drape.errors import InputError
from drape.export import glb
from drape.export.glb_body import add_body
from drape.export.glb_file import GlbFile
from drape.export.root_motion import RootMotion
from drape.garment.cache import Garment
from drape.garment.files.gltf_mesh import read_glb
from drape.geometry import rigid
from drape.geometry.rotations import quaternion_to_matrix
from tests.fixtures.glb_reader import PACKAGES, Reader, khronos_complaints
from tests.fixtures.poses import random_motion

THREE = PACKAGES / "three"
SHOW = """
import { readFileSync } from "node:fs";
const { GLTFLoader } = await import(%s);
const { AnimationMixer, Vector3 } = await import(%s);
const bytes = readFileSync("clip.glb");
const { scene, animations } = await new GLTFLoader().parseAsync(new Uint8Array(bytes).buffer, "");
const mixer = new AnimationMixer(scene), at = new Vector3();
mixer.clipAction(animations[0]).play();
const places = [];
for (let frame = 0; frame < 5; frame++) {
  mixer.setTime(Math.min(frame / 30, animations[0].duration - 1e-9));
  scene.updateMatrixWorld(true);
  let mesh; scene.traverse((one) => { mesh ??= one.isMesh ? one : undefined; });
  for (let i = 0; i < mesh.geometry.attributes.position.count; i++)
    places.push(...mesh.getVertexPosition(i, at).applyMatrix4(mesh.matrixWorld).toArray());
}
console.log(JSON.stringify(places));
"""


def clip(tube: Garment, frames: int = 5) -> np.ndarray:
    wave = np.linspace(0.0, 1.0, frames)[:, None, None]
    return (tube.vertices[None] * (1.0 + 0.2 * wave) + [0.0, 0.0, 3.0] * wave).astype(np.float32)


def content(tube: Garment, frames: np.ndarray, fps: float = 30.0, root_motion: RootMotion | None = None) -> bytes:
    file = GlbFile()
    glb.add_garment(file, tube, frames, fps, root_motion=root_motion)
    return file.to_bytes()


def written(*clip: Any, **options: Any) -> Reader:
    return Reader(content(*clip, **options))


def fixed(frames: int) -> RootMotion:
    return RootMotion(np.zeros((frames, 3)), np.zeros((frames, 3)))


def turning(tube: Garment, frames: int = 5, turn_rad: float = 6.0) -> tuple[np.ndarray, RootMotion]:
    """A tube that waves, and turns about itself on a way of 3 m."""
    share = np.linspace(0.0, 1.0, frames)
    root_motion = RootMotion(share[:, None] * [0.0, turn_rad, 0.0], share[:, None] * [3.0, 0.0, -1.0] + [0.5, 1.0, 0.0])
    wave = tube.vertices[None] * (1.0 + 0.2 * share[:, None, None] ** 2)
    return np.stack([wave[i] @ root_motion.rotation(i).T + root_motion.place[i] for i in range(frames)]), root_motion


def test_seams_split_vertices_and_nothing_else(tube: Garment):
    corners = glb.split_seams(tube)
    assert_array_equal(corners.source[:216], np.arange(216))
    assert len(corners.source) == 216 + 9  # one copy of each vertex of the seam
    assert_array_equal(corners.source[corners.faces], tube.faces)
    flipped = tube.uv[tube.uv_faces] * [1, -1] + [0, 1]
    assert corners.uv is not None
    assert_allclose(corners.uv[corners.faces], flipped, rtol=0, atol=1e-7)


def test_a_mesh_without_texture_coordinates_stays_as_it_is(tube: Garment):
    bare = dataclasses.replace(tube, uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int))
    corners = glb.split_seams(bare)
    assert corners.uv is None
    assert_array_equal(corners.faces, tube.faces)
    assert "TEXCOORD_0" not in written(bare, clip(tube)).json["meshes"][0]["primitives"][0]["attributes"]


def test_every_keyframe_is_its_frame(tube: Garment):
    frames = clip(tube)
    file = written(tube, frames, fps=24.0)
    source = glb.split_seams(tube).source
    (node,) = (i for i, n in enumerate(file.json["nodes"]) if n.get("mesh") == 0)
    times, weights = file.channel(node, "weights")
    assert_allclose(times, np.arange(5) / 24.0, rtol=1e-6, atol=0)
    weights = weights.reshape(5, 4)
    for primitive in file.json["meshes"][0]["primitives"]:
        base = file.array(primitive["attributes"]["POSITION"])
        normals = file.array(primitive["attributes"]["NORMAL"])
        moves = np.stack([file.array(target["POSITION"]) for target in primitive["targets"]])
        turns = np.stack([file.array(target["NORMAL"]) for target in primitive["targets"]])
        shown = base + np.einsum("ft,tva->fva", weights, moves)
        assert_allclose(shown, frames[:, source], rtol=0, atol=1e-6)
        lengths = np.linalg.norm(normals + np.einsum("ft,tva->fva", weights, turns), axis=-1)
        assert_allclose(lengths, 1.0, rtol=0, atol=1e-5)


def test_quantised_frames_are_theirs_to_half_a_step(tube: Garment):
    frames, root_motion = turning(tube)
    file = written(tube, frames, root_motion=root_motion)
    assert file.json["extensionsUsed"] == file.json["extensionsRequired"] == ["KHR_mesh_quantization"]
    (place,) = (i for i, n in enumerate(file.json["nodes"]) if n.get("mesh") == 0)
    node, source = file.json["nodes"][place], glb.split_seams(tube).source
    scale = node["scale"][0]
    assert node["scale"] == [scale] * 3 and 0.1 < scale < 0.3  # of the tube, not of its way
    weights = file.channel(place, "weights")[1].reshape(5, 4)
    turn = quaternion_to_matrix(np.roll(file.channel(place, "rotation")[1].astype(np.float64), 1, axis=-1))
    way = file.channel(place, "translation")[1].astype(np.float64)
    assert_allclose(node["translation"], way[0], rtol=0, atol=0)
    assert_allclose(node["rotation"], file.channel(place, "rotation")[1][0], rtol=0, atol=0)
    (primitive, *_) = file.json["meshes"][0]["primitives"]
    for name in ("POSITION", "NORMAL"):
        base = file.array(primitive["attributes"][name])
        moves = np.stack([file.array(target[name]) for target in primitive["targets"]])
        local = base + np.einsum("ft,tva->fva", weights, moves)
        if name == "POSITION":
            # Off by half a step along each axis of the root, and float32 rounds the way.
            off = np.einsum("fba,fvb->fva", turn, frames[:, source] - way[:, None]) - scale * local
            assert np.abs(off).max() <= 0.5 * scale / 32767 + np.spacing(np.float32(4.0))
        else:
            shown = np.einsum("fab,fvb->fva", turn, local)
            shown /= np.linalg.norm(shown, axis=-1, keepdims=True)
            expected = glb.vertex_normals(frames, tube.faces)[:, source]
            steps = np.linalg.norm(shown - expected, axis=-1)
            assert steps.max() < np.sqrt(3.0) / 254 * 1.1  # half a step of each part


def test_quantised_is_half_as_large(tube: Garment):
    frames, root_motion = turning(tube, 60)
    corners = len(glb.split_seams(tube).source)
    small, large = (len(written(tube, frames, root_motion=one).binary) for one in (root_motion, None))
    both = large - 60 * corners * 24  # indices, texture coordinates, weights, times
    assert small == 60 * corners * 12 + both + 60 * (12 + 16)


def test_a_normal_that_turns_past_a_right_angle_keeps_its_direction(tube: Garment):
    frames, root_motion = turning(tube, turn_rad=1.4)
    file = written(tube, frames, root_motion=fixed(len(root_motion)))  # a node that takes nothing over
    (primitive, *_) = file.json["meshes"][0]["primitives"]
    base = file.array(primitive["attributes"]["NORMAL"])
    normals = glb.vertex_normals(frames, tube.faces)[:, glb.split_seams(tube).source]
    assert (np.abs(normals[-1] - normals[0]) > 1.2).any()  # more than a normalized number holds
    for target, expected in zip(primitive["targets"], normals[1:], strict=True):
        shown = base + file.array(target["NORMAL"])
        shown /= np.linalg.norm(shown, axis=-1, keepdims=True)
        angles = np.degrees(np.arccos(np.clip((shown * expected).sum(axis=1), -1.0, 1.0)))
        assert angles.max() < 2.0


def test_a_single_quantised_frame_has_a_node_and_no_motion(tube: Garment):
    frames, root_motion = turning(tube, 1)
    file = written(tube, frames, root_motion=root_motion)
    assert "animations" not in file.json
    read = read_glb_mesh(file)
    assert_allclose(read[: tube.vertex_count], frames[0], rtol=0, atol=1e-5)


def read_glb_mesh(file: Reader) -> np.ndarray:
    """World places of the one mesh at rest."""
    (node,) = (n for n in file.json["nodes"] if "mesh" in n)
    base = file.array(file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"])
    x, y, z, w = node["rotation"]
    return node["scale"][0] * base @ quaternion_to_matrix(np.array([w, x, y, z])).T + node["translation"]


def test_a_root_motion_of_another_length_is_refused(tube: Garment):
    with pytest.raises(InputError, match="root motion: expected 5 frames, got 4"):
        written(tube, clip(tube), root_motion=fixed(4))


def test_intake_reads_what_was_quantised(tube: Garment):
    frames, root_motion = turning(tube, 2)
    read = read_glb(content(tube, frames, root_motion=root_motion), name="again", vertex_limit=1000)
    assert len(read.vertices) == tube.vertex_count
    distance = np.linalg.norm(read.vertices[:, None] - frames[0][None], axis=-1).min(axis=1)
    assert distance.max() < 1e-4


def test_three_js_shows_the_frames(tube: Garment, tmp_path: Path):
    """The page's own library: its world places of every keyframe."""
    node, loader = shutil.which("node"), THREE / "examples/jsm/loaders/GLTFLoader.js"
    if node is None or not loader.is_file():
        pytest.skip("No Node.js or no three.js: make page.")
    frames, root_motion = turning(tube)
    (tmp_path / "clip.glb").write_bytes(content(tube, frames, root_motion=root_motion))
    script = tmp_path / "show.mjs"
    script.write_text(SHOW % (json.dumps(loader.as_uri()), json.dumps((THREE / "build/three.module.js").as_uri())))
    run = subprocess.run([node, script], cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    shown = np.array(json.loads(run.stdout)).reshape(5, -1, 3)
    corners = glb.split_seams(tube)
    used = np.unique(corners.faces[tube.face_material == 0])
    assert_allclose(shown[:, used], frames[:, corners.source[used]], rtol=0, atol=2e-5)


@pytest.fixture(scope="module")
def complaints(tmp_path_factory: pytest.TempPathFactory) -> Callable[[bytes], list[dict[str, Any]]]:
    """Errors and warnings of the Khronos glTF validator on a file."""
    folder = tmp_path_factory.mktemp("validator")
    return lambda content: khronos_complaints(content, folder)


@pytest.mark.parametrize("frames", [1, 5])
@pytest.mark.parametrize("quantised", [False, True])
def test_the_khronos_validator_has_no_complaint(
    tube: Garment, body: BodyModel, complaints: Callable[[bytes], list[dict[str, Any]]], frames: int, quantised: bool
):
    file = GlbFile()
    moving, root_motion = turning(tube, frames)
    for garment in (tube, dataclasses.replace(tube, uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int))):
        glb.add_garment(file, garment, moving, 30.0, root_motion=root_motion if quantised else None)
    poses, trans = random_motion(frames)
    add_body(file, body, np.full(10, 0.5), poses, trans, 30.0)
    assert complaints(file.to_bytes()) == []


def test_the_khronos_validator_sees_what_is_wrong(tube: Garment, complaints: Callable[[bytes], list[dict[str, Any]]]):
    broken = content(tube, clip(tube)).replace(b'"VEC3"', b'"VEC2"', 1)
    assert {one["severity"] for one in complaints(broken)} >= {0}


def test_materials_keep_their_names_and_faces(tube: Garment):
    file = written(tube, clip(tube, 1))
    assert [material["name"] for material in file.json["materials"]] == ["cotton", "trim"]
    assert "animations" not in file.json
    source = glb.split_seams(tube).source
    for index, primitive in enumerate(file.json["meshes"][0]["primitives"]):
        faces = source[file.array(primitive["indices"])].reshape(-1, 3)
        assert_array_equal(faces, tube.faces[tube.face_material == index])


def test_a_vertex_without_faces_gets_a_normal(tube: Garment):
    lone = dataclasses.replace(
        tube, faces=tube.faces[:-2], uv_faces=tube.uv_faces[:-2], face_material=tube.face_material[:-2]
    )
    file = written(lone, clip(tube, 1))
    normals = file.array(file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"])
    assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=0, atol=1e-5)


def test_the_skeleton_moves_the_body(tube: Garment, body: BodyModel):
    poses, trans = random_motion(4, spread_rad=0.6)
    betas = np.full(10, 0.5)
    content = GlbFile()
    add_body(content, body, betas, poses, trans, 30.0)
    file = Reader(content.to_bytes())
    (skin,) = file.json["skins"]
    names = [file.json["nodes"][joint]["name"] for joint in skin["joints"]]
    assert names == list(JOINT_NAMES)
    # The file's own forward kinematics, by its nodes.
    offsets = np.array([file.json["nodes"][joint]["translation"] for joint in skin["joints"]])
    xyzw = np.stack([file.channel(joint, "rotation")[1] for joint in skin["joints"]], axis=1)
    root = file.channel(skin["joints"][0], "translation")[1]
    local = quaternion_to_matrix(np.roll(xyzw.astype(np.float64), 1, axis=-1))
    joints = np.zeros((24, 3))
    for joint, parent in enumerate(PARENTS):
        joints[joint] = offsets[joint] + (joints[parent] if parent >= 0 else 0.0)
    rotations, places = rigid.forward_kinematics(local, np.broadcast_to(joints, (4, 24, 3)), PARENTS)
    places = places + (root - joints[0])[:, None]
    (primitive,) = file.json["meshes"][0]["primitives"]
    rest = file.array(primitive["attributes"]["POSITION"])
    bones, weights = (file.array(primitive["attributes"][key]) for key in ("JOINTS_0", "WEIGHTS_0"))
    binds = file.array(skin["inverseBindMatrices"])
    bound = rest[:, None] + binds[bones][..., 3, :3]
    moved = np.einsum("fvkab,vkb->fvka", rotations[:, bones], bound) + places[:, bones]
    shown = np.einsum("vk,fvka->fva", weights, moved)
    # Four bones of at most six: what is left out sums to 0.034 at most.
    assert np.abs(shown - body.posed_vertices(poses, trans, betas)).max() < 0.01
    assert np.median(np.abs(shown - body.posed_vertices(poses, trans, betas))) < 1e-6
    # Neighbouring keys are never on opposite sides of the sphere.
    assert (np.sum(xyzw[1:] * xyzw[:-1], axis=-1) >= 0.0).all()


def test_foreign_readers_open_it(tube: Garment, body: BodyModel, tmp_path):
    file = GlbFile()
    glb.add_garment(file, tube, clip(tube), 30.0)
    poses, trans = random_motion(5)
    add_body(file, body, np.zeros(10), poses, trans, 30.0)
    path = tmp_path / "both.glb"
    path.write_bytes(file.to_bytes())
    read = pygltflib.GLTF2().load(str(path))
    assert read is not None and len(read.animations) == 1 and len(read.skins) == 1
    scene = trimesh.load_scene(path)
    assert {"tube", body.name} <= {name.split("_")[0] if name.startswith("tube") else name for name in scene.geometry}


@pytest.mark.parametrize(("count", "dtype"), [(65534, np.uint16), (65535, np.uint32)])
def test_indices_are_as_wide_as_they_must(count: int, dtype: type):
    assert glb.flat_indices(np.zeros((1, 3), int), count).dtype == dtype
