"""Point caches, scenes and their meshes hold what they were given."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.export.mdd import mdd_frames, mdd_head
from drape.export.obj import obj_text
from drape.export.pc2 import HEAD_BYTES, pc2_head, pc2_samples
from drape.export.surface import MovingGarment
from drape.export.usda import POINT_BYTES, usda_pieces
from drape.garment.cache import Garment
from drape.garment.files.obj_mesh import read_obj
from tests.fixtures.exports import UsdGeom, read_mdd, read_pc2, read_usda


def clip(tube: Garment, frames: int = 3) -> np.ndarray:
    share = np.linspace(0.0, 1.0, frames)[:, None, None]
    return (tube.vertices[None] * (1.0 + 0.2 * share) + [0.0, 0.0, 3.0] * share).astype(np.float32)


def test_a_point_cache_holds_the_bits(tube: Garment, tmp_path: Path):
    frames, path = clip(tube), tmp_path / "clip.pc2"
    path.write_bytes(pc2_head(216, 3) + pc2_samples(frames[:2]) + pc2_samples(frames[2:]))
    assert HEAD_BYTES == 32
    assert_array_equal(read_pc2(path), frames)


def test_an_mdd_cache_holds_the_bits_and_the_times(tube: Garment):
    frames = clip(tube)
    file = mdd_head(216, 3, 24.0) + mdd_frames(frames[:2]) + mdd_frames(frames[2:])
    times, points = read_mdd(file)
    assert_array_equal(times, (np.arange(3) / 24.0).astype(np.float32))
    assert_array_equal(points, frames)


def test_a_scene_holds_meshes_and_their_motion(tube: Garment):
    frames = clip(tube)
    bare = dataclasses.replace(tube, name="2 Röcke", uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int))
    layers = [MovingGarment(one, frames, (0.1, 0.2, 0.3, 1.0)) for one in (tube, tube, bare)]
    pieces = list(usda_pieces(layers, 24.0, point=np.array([1e6, 0.0, -2.5])))
    scene = read_usda(b"".join(pieces).decode())
    assert UsdGeom.GetStageUpAxis(scene.stage) == "Y" and UsdGeom.GetStageMetersPerUnit(scene.stage) == 1.0
    assert (scene.stage.GetTimeCodesPerSecond(), scene.stage.GetEndTimeCode()) == (24.0, 2.0)
    assert_array_equal(scene.translate, [1e6, 0.0, -2.5])
    assert list(scene.meshes) == ["tube", "tube_2", "_2_R_cke"]
    for mesh in scene.meshes.values():
        assert_allclose(mesh.points, frames, rtol=0, atol=0.52e-5)
        assert_allclose(mesh.extents[:, 0], frames.min(axis=1), rtol=0, atol=0.52e-5)
        assert_allclose(mesh.extents[:, 1], frames.max(axis=1), rtol=0, atol=0.52e-5)
        assert_array_equal(mesh.faces, tube.faces)
        for number, name in enumerate(("cotton", "trim")):
            assert_array_equal(mesh.subsets[name], np.flatnonzero(tube.face_material == number))
    assert scene.meshes["_2_R_cke"].uv is None
    found = scene.meshes["tube"].uv
    assert found is not None
    assert_allclose(found, tube.uv[tube.uv_faces], rtol=1e-5, atol=1e-6)


def test_no_piece_of_a_scene_is_long(tube: Garment):
    many = np.tile(clip(tube), (1, 40, 1))  # more points than faces name
    repeated = {name: np.tile(getattr(tube, name), (40, 1)) for name in ("faces", "uv_faces", "uv")}
    large = dataclasses.replace(tube, **repeated, face_material=np.tile(tube.face_material, 40))
    pieces = list(usda_pieces([MovingGarment(large, many, (0.1, 0.2, 0.3, 1.0))], 30.0))
    assert max(map(len, pieces)) < 40 * 1024
    size = sum(map(len, usda_pieces([MovingGarment(tube, many, (0.1, 0.2, 0.3, 1.0))], 30.0)))
    assert abs(size / many[..., 0].size - POINT_BYTES) < 4


def test_the_mesh_beside_a_point_cache_keeps_its_order(tube: Garment):
    frames = clip(tube)
    bare = dataclasses.replace(tube, uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int), material_names=())
    for surfaces in ([tube], [bare], [bare, tube]):
        text = obj_text(surfaces, [frames[0]] * len(surfaces))
        mesh = read_obj(text.encode(), name="out", vertex_limit=1000)
        assert_allclose(mesh.vertices, np.concatenate([frames[0]] * len(surfaces)), rtol=0, atol=1e-6)
        faces = [one.faces + 216 * number for number, one in enumerate(surfaces)]
        assert_array_equal(np.sort(mesh.faces, axis=None), np.sort(np.concatenate(faces), axis=None))
