"""Pictures of a garment come back from every kind of file, in a garment's own file and in a GLB."""

from __future__ import annotations

import base64
import io
import json
import struct
import sys
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image, PngImagePlugin

from drape.errors import ArtifactError, MeshError
from drape.export.glb import add_garment
from drape.export.glb_file import GlbFile
from drape.files import pictures
from drape.files.ktx2 import ktx2_picture
from drape.files.looks import Looks, Material, looks_of, media_type
from drape.garment.cache import Garment, load_garment, save_garment
from drape.garment.files import archive
from drape.garment.files.mesh import GarmentMesh, read_mesh
from tests.drape.garment.garment_files import FACES, UV, VERTICES, as_gltf, glb_bytes
from tests.fixtures.glb_reader import khronos_complaints

RED = (200, 30, 20)
KTX2 = [zlib.decompress(base64.b85decode(packed)) for packed in (  # 8 x 8, of (200, 40, 40)
    # UASTC
    r"c-mX-9TK5nWU!l;ONxsD2pEBw1BzjQ5sE<|1Bi8icnXw82M3_E0~!re%fz6;u#Az3fti_sK>)6+9?tp?1oA){=&bUh%#ze12B*a0"
    r"%wmPmyv(xHqT<9H1tUE}0|o{bkS?G$aY@#v_9u?P^^?j603f&`PX",
    # ETC1S, with its halves
    r"c-mX-9TK5nWU!l;ONxsD2pEBw1Bzh)B*p@zHvq8?5Z?h}6__Lt?1!p7#E8&?3=ZNDKY&AgKMrvnD9yy6!LXQ-iGi6J*{$|))_)+7"
    r"2hu?Al^11}q!uwaB^GBED}?4{mZcUIC*~*^=@}Y;%x7fK1gc{NVqG-5(CsEyjPU>qgz<=Jh7g$Hu!)(effFL=!e9VV+yGT}&;=qP"
    r"^l*PDTuy*VjRow_2|mgUJ`gV}FfjrF3jn{-Bj*",
)]  # fmt: skip
GENERATED = "MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"


def picture(colour: tuple[int, ...] = RED, kind: str = "PNG", size: tuple[int, int] = (8, 8), **saved) -> bytes:
    out = io.BytesIO()
    Image.new("RGBA" if len(colour) == 4 else "RGB", size, colour).save(out, kind, **saved)
    return out.getvalue()


def told_size(width: int, height: int) -> bytes:
    """A small PNG whose head says that it is larger: drawn in full, it takes seconds and a gigabyte."""
    whole = picture()
    head = b"IHDR" + struct.pack(">II", width, height) + whole[24:29]
    return whole[:12] + head + struct.pack(">I", zlib.crc32(head)) + whole[33:]


def zipped(files: Mapping[str, bytes | str], packing: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packing) as target:
        for name, content in files.items():
            target.writestr(name, content)
    return out.getvalue()


OBJ = "mtllib cloth.mtl\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in VERTICES)
OBJ += "".join(f"vt {u} {v}\n" for u, v in UV) + "usemtl front\n"
OBJ += "".join(f"f {a + 1}/{a + 1} {b + 1}/{b + 1} {c + 1}/{c + 1}\n" for a, b, c in FACES[:20]) + "usemtl back\n"
OBJ += "".join(f"f {a + 1}/{a + 1} {b + 1}/{b + 1} {c + 1}/{c + 1}\n" for a, b, c in FACES[20:])
MTL = """newmtl front
Kd 0.1 0.2 0.3
map_Kd -s 2 2 1 C:\\mine\\tex\\Cloth Red.png
map_Bump -bm 0.5 cloth_normal.png
newmtl back
Kd 0.1 0.2 0.3
Tr 0.25
"""
ZIP = {
    "coat/coat.obj": OBJ,
    "coat/cloth.mtl": MTL,
    "coat/tex/cloth red.png": picture(),
    "coat/cloth_normal.png": picture((128, 128, 255)),
    "__MACOSX/coat/._coat.obj": b"junk",
}


def colour_of(content: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))[0, 0]


def assert_coat(mesh: GarmentMesh) -> None:
    assert mesh.material_names == ("front", "back") and mesh.notes == ()
    front, back = mesh.looks.materials
    assert front is not None and front.base_colour == (1.0, 1.0, 1.0, 1.0)
    assert_array_equal(colour_of(mesh.looks.pictures[front.pictures["base_colour"]]), RED)
    assert_array_equal(colour_of(mesh.looks.pictures[front.pictures["normal"]]), (128, 128, 255))
    assert back == Material((0.1, 0.2, 0.3, 0.75), alpha_mode="BLEND")


def test_an_obj_in_a_zip_has_its_pictures():
    assert_coat(read_mesh(zipped(ZIP), name="coat"))


def test_an_obj_in_a_folder_has_its_pictures_and_none_from_outside(tmp_path: Path):
    for name, content in ZIP.items():
        path = tmp_path / name.replace("coat/tex/cloth red", "coat/mine/tex/Cloth Red")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.replace("C:\\", "").encode())
    assert_coat(read_mesh(tmp_path / "coat/coat.obj"))
    (tmp_path / "secret.png").write_bytes(picture())
    (tmp_path / "coat/cloth.mtl").write_text("newmtl front\nmap_Kd ../secret.png\n")
    (note,) = read_mesh(tmp_path / "coat/coat.obj").notes
    assert "'../secret.png' is not beside the mesh" in note


def test_an_obj_in_the_parts_of_a_form_has_its_pictures():
    body = b""
    for name, content in ZIP.items():
        head = f'--xyz\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n\r\n'
        body += head.encode() + (content if isinstance(content, bytes) else content.encode()) + b"\r\n"
    assert_coat(read_mesh(body + b"--xyz--\r\n", name="coat", kind="zip"))
    with pytest.raises(MeshError, match="at most 1000 parts"):
        read_mesh(b"--xyz\r\n" * 1001, kind="zip")


@pytest.mark.parametrize("kind", ["PNG", "JPEG", "WEBP", "TGA", "BMP"])
def test_pictures_are_made_anew_as_png_or_jpeg(kind: str):
    made = pictures.remake_picture(picture(kind=kind), label="picture")
    assert media_type(made) in ("image/png", "image/jpeg")
    assert_allclose(colour_of(made), RED, atol=6)  # JPEG


@pytest.mark.parametrize("packed", KTX2)
def test_a_texture_of_ktx2_alone_is_read(packed: bytes):
    def change(document: dict) -> None:
        document["textures"][0] = {"extensions": {"KHR_texture_basisu": {"source": 1}}}
        document["images"][1] = {"uri": "data:image/ktx2;base64," + base64.b64encode(packed).decode()}

    mesh = read_mesh(changed(glb_of(whole()), change))
    assert mesh.notes == ()
    (made,) = (one for one in mesh.looks.pictures if media_type(one) == "image/jpeg")
    assert_allclose(colour_of(made), (200, 40, 40), atol=6)


def test_of_a_large_ktx2_the_size_that_is_enough_is_read():
    assert Image.open(io.BytesIO(pictures.remake_picture(KTX2[1], label="", side=3))).size == (3, 3)
    assert ktx2_picture(KTX2[1], side=3, most_pixels=64, label="").size == (4, 4)


def test_without_its_package_a_ktx2_tells_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    with pytest.raises(MeshError, match="the package opengl-basisu"):
        pictures.remake_picture(KTX2[0], label="picture")


def test_what_else_a_picture_carries_goes_and_alpha_stays():
    told = PngImagePlugin.PngInfo()
    told.add_text("Author", "somebody-secret")
    assert b"secret" not in pictures.remake_picture(picture(pnginfo=told, icc_profile=b"secret"), label="picture")
    spoken = picture(kind="JPEG", comment=b"secret", icc_profile=b"secret", exif=b"Exif\0\0secret")
    assert b"secret" in spoken and b"secret" not in pictures.remake_picture(spoken, label="picture")
    assert Image.open(io.BytesIO(pictures.remake_picture(picture((1, 2, 3, 90)), label=""))).mode == "RGBA"
    assert Image.open(io.BytesIO(pictures.remake_picture(picture((1, 2, 3, 255)), label=""))).mode == "RGB"
    assert Image.open(io.BytesIO(pictures.remake_picture(picture(size=(4096, 64)), label=""))).size == (2048, 32)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (KTX2[0][:-40], "a whole PNG"),
        (KTX2[0][:20] + b"\xff\xff\0\0" * 2 + KTX2[0][28:], "too many pixels"),
        (b"<svg onload='x'/>", "a whole PNG"),
        (picture()[:-40], "a whole PNG"),
        (told_size(8193, 8192), "67 million pixels, got 8193 x 8192"),
        (told_size(20000, 20000), "too many pixels"),
    ],
)
def test_a_picture_that_cannot_be_kept_is_told_and_the_mesh_stays(content: bytes, words: str):
    mesh = read_mesh(zipped(ZIP | {"coat/tex/cloth red.png": content}))
    assert len(mesh.faces) == len(FACES)
    assert mesh.notes[-1].startswith("warning: a picture is left out:") and words in mesh.notes[-1]
    front = mesh.looks.materials[0]
    assert front is not None and list(front.pictures) == ["normal"] and len(mesh.looks.pictures) == 1


def test_pictures_are_bounded_together(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pictures, "MOST_BYTES", 100)
    assert "0 MiB of pictures" in read_mesh(zipped(ZIP)).notes[-1]


def test_a_picture_of_another_kind_has_no_media_type():
    with pytest.raises(ValueError, match="neither PNG nor JPEG"):
        media_type(b"<html>")


LOOK = Material(
    (0.5, 0.6, 0.7, 1.0), 0.1, 0.4, "MASK", 0.3, True, {"base_colour": 0, "normal": 1, "metallic_roughness": 0},
    (0.5, 0.25), 0.5, (2.0, 3.0),
)  # fmt: skip


def whole(material: Material = LOOK) -> GarmentMesh:
    plain = read_mesh(glb_bytes(VERTICES, FACES, UV), name="coat")
    kept = tuple(pictures.remake_picture(one, label="") for one in (picture(), picture((128, 128, 255))))
    return replace(plain, looks=Looks((material,), kept))


def glb_of(mesh: GarmentMesh) -> bytes:
    file = GlbFile()
    surface = replace_surface(mesh)
    add_garment(file, surface, mesh.vertices[None], 1.0)
    return file.to_bytes()


def replace_surface(mesh: GarmentMesh):
    from drape.export.surface import MeshSurface

    uv = mesh.uv, mesh.uv_faces
    return MeshSurface(
        mesh.name, len(mesh.vertices), mesh.faces, *uv, mesh.material_names, mesh.face_material, mesh.looks
    )


def test_looks_come_back_from_the_glb_that_was_written():
    read = read_mesh(glb_of(whole()), name="coat")
    assert read.notes == () and read.looks.materials == (LOOK,)
    assert read.looks.pictures == whole().looks.pictures
    assert read.looks.digest == whole().looks.digest != replace(whole().looks, materials=(None,)).digest == ""


def test_the_khronos_validator_has_no_complaint(tmp_path: Path):
    codes = {one["code"] for one in khronos_complaints(glb_of(whole()), tmp_path)}
    assert codes == {GENERATED}  # normals without tangents are the viewer's to make


def test_a_gltf_is_read_with_its_data_inside_and_beside():
    inside, _ = as_gltf(glb_of(whole()), inside=True)
    apart, binary = as_gltf(glb_of(whole()), inside=False)
    for mesh in (read_mesh(inside), read_mesh(zipped({"a/coat.gltf": apart, "a/the coat.bin": binary}))):
        assert mesh.looks.materials == (LOOK,) and len(mesh.faces) == len(FACES)
    with pytest.raises(MeshError, match="Send it in the same zip"):
        read_mesh(apart)
    for broken in (inside.replace(b"base64,", b"base64,%"), apart.replace(b'"the%20coat.bin"', b"3")):
        with pytest.raises(MeshError, match="bytes in the file or beside it"):
            read_mesh(broken)


def test_a_vrm_in_a_zip_is_a_glb():
    assert read_mesh(zipped({"coat.vrm": glb_of(whole())})).looks.materials == (LOOK,)


def changed(payload: bytes, change) -> bytes:
    """A glTF with data inside whose document ``change`` has edited."""
    document = json.loads(as_gltf(payload, inside=True)[0])
    change(document)
    return json.dumps(document).encode()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("pbrMetallicRoughness", {"baseColorFactor": [1, 2]}),
        ("pbrMetallicRoughness", {"metallicFactor": float("nan")}),
        ("alphaMode", "ODD"),
        ("normalTexture", {"index": 99}),
        ("normalTexture", {"index": {}}),
        ("normalTexture", "none"),
    ],
)
def test_a_look_that_is_wrong_leaves_the_mesh(key: str, value: object):
    def change(document: dict) -> None:
        document["materials"][0][key] = value

    mesh = read_mesh(changed(glb_of(whole()), change))
    assert len(mesh.faces) == len(FACES) and mesh.notes[-1].startswith("warning: ")


def test_a_texture_of_webp_alone_is_read_and_one_without_a_file_is_told():
    def change(document: dict) -> None:
        document["textures"][0] = {"extensions": {"EXT_texture_webp": {"source": 1}}}
        document["images"][1] = {"uri": "absent.webp"}

    (note,) = read_mesh(changed(glb_of(whole()), change)).notes
    assert "expected a file beside" in note


def with_names(*names: str) -> dict[str, bytes]:
    return {name: OBJ.encode() for name in names}


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (zipped({f"{i}.png": b"" for i in range(1001)}), "at most 1000 files"),
        (zipped(with_names("a.obj", "b.obj")), "one mesh"),
        (zipped({"readme.txt": b"x"}), "got none"),
        (zipped({"inner.zip": zipped(ZIP)}), "another archive, 'inner.zip'"),
        (zipped(with_names("../a.obj")), "names inside the zip"),
        (zipped(with_names("/a.obj")), "names inside the zip"),
        (zipped({"a.obj": OBJ, "b.png": b"\0" * 2**25}), "files packed to at least 1/250"),
        (zipped(ZIP, zipfile.ZIP_LZMA), "only deflated"),
        (zipped(ZIP)[:-30], "a whole zip"),
        (b"PK\x03\x04", "a whole zip"),
        (zipped({"a.obj": OBJ}, zipfile.ZIP_STORED).replace(b"usemtl", b"usemti"), "a whole 'a.obj'"),
    ],
)
def test_a_zip_that_is_no_garment_is_refused(payload: bytes, words: str):
    with pytest.raises(MeshError, match=words):
        read_mesh(payload, kind="zip")


def test_a_zip_is_not_unpacked_beyond_its_limit(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(archive, "MOST_BYTES", 100)
    with pytest.raises(MeshError, match="MiB unpacked"):
        read_mesh(zipped(ZIP))


def test_a_garment_keeps_its_looks_on_disk(tube: Garment, tmp_path: Path):
    dressed = replace(tube, looks=whole().looks)
    read = load_garment(save_garment(dressed, tmp_path))
    assert read.looks.materials == (LOOK,) and read.looks.pictures == whole().looks.pictures
    assert load_garment(save_garment(tube, tmp_path)).looks.materials == ()


def test_looks_that_do_not_fit_their_bytes_are_refused(tube: Garment, tmp_path: Path):
    told, content = whole().looks.to_json(), np.zeros(10, np.uint8)
    with pytest.raises(ValueError, match="as long or as many"):
        looks_of(told, content)
    odd = replace(tube, looks=Looks((LOOK,), ()))
    with pytest.raises(ArtifactError):
        load_garment(save_garment(odd, tmp_path))


def ply_text(names: str) -> bytes:
    lines = ["ply", "format ascii 1.0", "comment TextureFile cloth.png", f"element vertex {len(VERTICES)}"]
    lines += [f"property float {name}" for name in ("x", "y", "z", *names)]
    lines += [f"element face {len(FACES)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, row)) for row in np.hstack([VERTICES, UV])]
    return "\n".join(lines + [f"3 {a} {b} {c}" for a, b, c in FACES]).encode() + b"\n"


@pytest.mark.parametrize("names", ["st", "uv"])
def test_a_ply_has_its_texture(names: str):
    mesh = read_mesh(zipped({"a.ply": ply_text(names), "cloth.png": picture()}))
    assert_allclose(mesh.uv[mesh.uv_faces], UV[FACES], rtol=0, atol=1e-6)
    assert mesh.looks.materials == (Material(pictures={"base_colour": 0}),)
    assert "'cloth.png' is not beside the mesh" in read_mesh(ply_text(names)).notes[-1]
