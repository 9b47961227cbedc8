"""Binary USD and vertex animation textures hold the frames, the materials and the pictures that they were given."""

from __future__ import annotations

import dataclasses
import io
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from drape.errors import InputError, Unavailable
from drape.export.clips import check_name, write_clip
from drape.export.surface import MovingGarment
from drape.export.usd_stage import usd_file
from drape.export.vat import WIDTH, merge_layers, vat_files
from drape.files.looks import Looks, Material
from drape.garment.cache import Garment
from drape.garment.files.usd import read_usd
from tests.drape.export.test_files import clip
from tests.fixtures.exports import Usd, UsdGeom, played
from tests.fixtures.glb_reader import khronos_complaints

BLUE = (0.1, 0.2, 0.6, 1.0)
FPS = 24.0


def picture(*colour: int) -> bytes:
    out = io.BytesIO()
    Image.new("RGB", (4, 4), colour).save(out, "PNG")
    return out.getvalue()


@pytest.fixture(scope="module")
def layers(tube: Garment) -> list[MovingGarment]:
    """A tube of two materials with pictures, one of which is placed, and one without texture coordinates."""
    placed = {"offset": (0.2, 0.3), "rotation": 0.4, "scale": (2.0, 0.5)}
    cotton = Material((0.5, 0.6, 0.7, 1.0), 0.1, 0.4, pictures={"base_colour": 0, "normal": 1}, **placed)
    trim = Material((1.0, 1.0, 1.0, 0.5), alpha_mode="MASK", alpha_cutoff=0.3, pictures={"base_colour": 0})
    looks = Looks((cotton, trim), (picture(255, 0, 0), picture(128, 128, 255)))
    first = dataclasses.replace(tube, looks=looks)
    bare = dataclasses.replace(tube, name="2 Röcke", uv=np.zeros((0, 2)), uv_faces=np.zeros((0, 3), int))
    return [MovingGarment(first, clip(tube), BLUE), MovingGarment(bare, clip(tube) + np.float32(1.0), BLUE)]


@pytest.mark.parametrize("suffix", [".usdc", ".usdz"])
def test_a_scene_opens_with_its_frames_rate_axis_and_unit(suffix: str, layers: list[MovingGarment], tmp_path: Path):
    path = tmp_path / f"clip{suffix}"
    path.write_bytes(usd_file(layers, FPS, suffix, point=np.array([1e6, 0.0, -2.5])))
    stage = Usd.Stage.Open(str(path))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FPS, 0.0, 2.0)
    assert stage.GetDefaultPrim().GetName() == "clip"
    for name, layer in zip(("tube", "_2_R_cke"), layers, strict=True):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/clip/{name}"))
        place = UsdGeom.XformCache(0).GetLocalToWorldTransform(mesh.GetPrim()).ExtractTranslation()
        assert_array_equal(place, [1e6, 0.0, -2.5])
        for frame, vertices in enumerate(layer.vertices):
            assert_array_equal(np.array(mesh.GetPointsAttr().Get(frame)), vertices)
            assert_allclose(np.linalg.norm(np.array(mesh.GetNormalsAttr().Get(frame)), axis=1), 1.0, atol=1e-6)
        assert_array_equal(np.reshape(mesh.GetFaceVertexIndicesAttr().Get(), (-1, 3)), layer.surface.faces)


def test_a_scene_in_one_file_keeps_looks_and_pictures(layers: list[MovingGarment]):
    mesh = read_usd(usd_file(layers[:1], FPS, ".usdz"), name="clip", vertex_limit=1000)
    was = layers[0].surface
    assert_allclose(mesh.uv[mesh.uv_faces], was.uv[was.uv_faces], atol=1e-6)
    for number, name in enumerate(was.material_names):
        look, wanted = mesh.looks.materials[mesh.material_names.index(name)], was.looks.materials[number]
        assert look is not None and wanted is not None
        told = {slot: mesh.looks.pictures[one] for slot, one in look.pictures.items()}
        assert told.keys() == wanted.pictures.keys()
        assert len({Image.open(io.BytesIO(one)).getpixel((0, 0)) for one in told.values()}) == len(told)
        for key in ("base_colour", "offset", "scale", "rotation", "metallic", "roughness", "alpha_cutoff"):
            if key != "alpha_cutoff" or wanted.alpha_mode == "MASK":
                assert_allclose(getattr(look, key), getattr(wanted, key), atol=1e-6, err_msg=f"{name} {key}")
        assert look.alpha_mode == wanted.alpha_mode


@pytest.mark.parametrize("width", [WIDTH, 100])
def test_a_texture_plays_the_frames(width: int, layers: list[MovingGarment], tmp_path: Path, monkeypatch):
    monkeypatch.setattr("drape.export.vat.WIDTH", width)
    files = vat_files(layers, FPS, "two")
    assert sorted(files) == ["two-remap_info.json", "two.glb", "two_vat.exr"]
    places, normals, mesh = played(files, "two")
    given = np.concatenate([one.vertices for one in layers], axis=1)
    assert_allclose(places[:, : given.shape[1]], given, rtol=0, atol=1e-6)
    assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-5)
    told = json.loads(files["two-remap_info.json"])
    (one,) = told["animations"].values()
    assert one == {"startFrame": 0, "endFrame": 2, "framerate": FPS, "looping": False}
    names = [material["name"] for material in mesh.json["materials"]]
    assert names == ["cotton", "trim", "cotton", "trim"] and len(mesh.json["textures"]) == 2
    complaints = {one["code"] for one in khronos_complaints(files["two.glb"], tmp_path)}
    assert complaints <= {"MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"}, "a picture of normals, and no tangents"


def test_layers_become_one_with_the_materials_of_all(layers: list[MovingGarment]):
    whole = merge_layers(layers, "two").surface
    assert whole.vertex_count == 432 and whole.faces.max() == 431
    assert whole.looks.material(0) == layers[0].surface.looks.material(0)
    assert whole.looks.material(2) == Material(BLUE)


def test_a_texture_has_rows_for_so_many_frames(layers: list[MovingGarment], monkeypatch):
    monkeypatch.setattr("drape.export.vat.MOST_ROWS", 4)
    with pytest.raises(InputError, match=r"at most 2 frames.*Cut the clip"):
        vat_files(layers, FPS, "long")


@pytest.mark.parametrize(
    ("name", "package", "match"),
    [("a.usdz", "pxr.Usd", "usd-core, which writes it.*\\.usda"), ("a_vat.exr", "OpenEXR", "patchdrape\\[vat\\]")],
)
def test_a_package_that_is_missing_is_told_before_anything_is_draped(name, package, match, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(Unavailable, match=match):
        check_name(tmp_path / name)


def test_files_lie_beside_each_other_by_their_names(tube: Garment, tmp_path: Path):
    with pytest.raises(InputError, match=r"ending in _vat\.exr.*a_vat\.exr"):
        check_name(tmp_path / "a.exr")
    beside = write_clip(tmp_path / "a_vat.exr", [tube], clip(tube), FPS)
    assert [one.name for one in beside] == ["a.glb", "a-remap_info.json"]
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a-remap_info.json", "a.glb", "a_vat.exr"]
