"""USD scenes in binary by the package usd-core: meshes whose points and normals move, in their materials and pictures.

Metres, y up, a time code per frame. A ``.usdc`` has colours, a ``.usdz`` the pictures too. Points are float32, under an
Xform in float64 where they count from a point of their own. ``drape.export.usda`` writes text without a package.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from drape.errors import Unavailable
from drape.export.glb import vertex_normals
from drape.export.surface import MovingGarment
from drape.export.usda import identifiers
from drape.files.looks import Material, media_type
from drape.geometry import meshes
from drape.wanted import go_on

SUFFIXES = (".usdc", ".usdz")
ROOT, LOOKS = "/clip", "materials"
ENDINGS = {"image/png": "png", "image/jpeg": "jpg"}
CHANNELS = {"base_colour": "sRGB", "normal": "raw", "metallic_roughness": "raw"}


def check_usd() -> None:
    """Raises ``Unavailable`` where the package usd-core is not installed."""
    _pxr("Usd")


def _pxr(name: str) -> Any:
    try:
        return import_module(f"pxr.{name}")
    except ModuleNotFoundError as error:
        cure = "pip install 'patchdrape[usd]', or write .usda, which needs none."
        raise Unavailable("USD", expected="the package usd-core, which writes it", got="none", cure=cure) from error


def usd_file(layers: Sequence[MovingGarment], fps: float, suffix: str, *, point: np.ndarray | None = None) -> bytes:
    """Returns the bytes of a USD scene of ``layers``, ".usdc" or ".usdz" by its ``suffix``, at ``fps`` frames a second.

    Vertices count from ``point`` [m] (3,), the origin by default. Raises ``Unavailable`` without usd-core.
    """
    usd = _pxr("Usd")
    with tempfile.TemporaryDirectory(prefix="usd-") as folder:
        path = Path(folder) / "clip.usdc"
        stage = usd.Stage.CreateNew(str(path))
        _head(stage, len(layers[0].vertices), fps, np.zeros(3) if point is None else point)
        beside = Path(folder) if suffix == ".usdz" else None
        names = identifiers([LOOKS, *(one.surface.name for one in layers)])[1:]
        for name, layer in zip(names, layers, strict=True):
            go_on()
            mesh = _add_mesh(stage, f"{ROOT}/{name}", layer)
            _add_materials(stage, mesh, f"{ROOT}/{LOOKS}/{name}", layer, beside)
        stage.GetRootLayer().Save()
        if suffix == ".usdz":
            _pxr("UsdUtils").CreateNewUsdzPackage(_pxr("Sdf").AssetPath(str(path)), str(path.with_suffix(suffix)))
        return path.with_suffix(suffix).read_bytes()


def _head(stage: Any, frames: int, fps: float, point: np.ndarray) -> None:
    geometry = _pxr("UsdGeom")
    geometry.SetStageUpAxis(stage, geometry.Tokens.y)
    geometry.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(fps)
    stage.SetFramesPerSecond(fps)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(frames - 1)
    root = geometry.Xform.Define(stage, ROOT)
    root.AddTranslateOp().Set(_pxr("Gf").Vec3d(*point.tolist()))
    stage.SetDefaultPrim(root.GetPrim())


def _add_mesh(stage: Any, path: str, layer: MovingGarment) -> Any:
    """The mesh at ``path``, which moves."""
    geometry, surface = _pxr("UsdGeom"), layer.surface
    mesh = geometry.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(geometry.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateFaceVertexCountsAttr(_numbers("IntArray", np.full(len(surface.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(_numbers("IntArray", surface.faces.astype(np.int32).reshape(-1)))
    points, extent, normals = mesh.CreatePointsAttr(), mesh.CreateExtentAttr(), mesh.CreateNormalsAttr()
    mesh.SetNormalsInterpolation(geometry.Tokens.vertex)
    table = meshes.face_table(surface.faces, surface.vertex_count)
    for frame, vertices in enumerate(layer.vertices):
        go_on()
        points.Set(_numbers("Vec3fArray", vertices), frame)
        extent.Set(_numbers("Vec3fArray", np.stack([vertices.min(axis=0), vertices.max(axis=0)])), frame)
        normals.Set(_numbers("Vec3fArray", vertex_normals(vertices, surface.faces, table=table)), frame)
    mesh.CreateDisplayColorAttr([_pxr("Gf").Vec3f(*map(float, layer.colour[:3]))])
    if surface.uv_faces.size:
        kind, each = _pxr("Sdf").ValueTypeNames.TexCoord2fArray, geometry.Tokens.faceVarying
        coordinates = geometry.PrimvarsAPI(mesh).CreatePrimvar("st", kind, each)
        coordinates.Set(_numbers("Vec2fArray", surface.uv))
        coordinates.SetIndices(_numbers("IntArray", surface.uv_faces.astype(np.int32).reshape(-1)))
    return mesh


def _numbers(kind: str, array: np.ndarray) -> Any:
    made, wanted = getattr(_pxr("Vt"), kind), np.int32 if kind == "IntArray" else np.float32
    return made.FromNumpy(np.ascontiguousarray(array, wanted))


def _add_materials(stage: Any, mesh: Any, folder: str, layer: MovingGarment, beside: Path | None) -> None:
    """Materials of ``mesh`` in the prim ``folder``, bound to the faces that have them; their pictures are written into
    the folder ``beside``."""
    geometry, shade, surface = _pxr("UsdGeom"), _pxr("UsdShade"), layer.surface
    names = surface.material_names or (surface.name,)
    for number, name in enumerate(identifiers(names)):
        look = surface.looks.material(number) or Material((*layer.colour[:3], 1.0))
        pictures = {} if beside is None or not surface.uv_faces.size else look.pictures
        stored = {slot: _stored(surface.looks.pictures[one], beside) for slot, one in pictures.items()}
        material = _material(stage, f"{folder}/{name}", look, stored)
        prim = mesh.GetPrim()
        if surface.material_names:
            subset = geometry.Subset.Define(stage, f"{mesh.GetPath()}/{name}")
            subset.CreateElementTypeAttr(geometry.Tokens.face)
            subset.CreateFamilyNameAttr(shade.Tokens.materialBind)
            subset.CreateIndicesAttr(_numbers("IntArray", np.flatnonzero(surface.face_material == number)))
            prim = subset.GetPrim()
        shade.MaterialBindingAPI.Apply(prim).Bind(material)


def _stored(picture: bytes, folder: Path | None) -> str:
    """The name of ``picture`` in ``folder``, where it is once."""
    assert folder is not None
    ending = ENDINGS[media_type(picture)]
    held = {one.read_bytes(): one.name for one in folder.glob(f"*.{ending}")}
    if picture not in held:
        held[picture] = f"{len(list(folder.iterdir()))}.{ending}"
        (folder / held[picture]).write_bytes(picture)
    return f"./{held[picture]}"  # USD seeks names without "./" in its own folders.


def _material(stage: Any, path: str, look: Material, pictures: dict[str, str]) -> Any:
    """The material of a ``look`` at ``path``, by UsdPreviewSurface, with ``pictures`` in files of these names."""
    shade, kinds, gf = _pxr("UsdShade"), _pxr("Sdf").ValueTypeNames, _pxr("Gf")
    material = shade.Material.Define(stage, path)
    shader = _shader(stage, f"{path}/surface", "UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    red, green, blue, alpha = look.base_colour
    plain = {
        "diffuseColor": (kinds.Color3f, gf.Vec3f(red, green, blue)), "metallic": (kinds.Float, look.metallic),
        "roughness": (kinds.Float, look.roughness),
        "opacity": (kinds.Float, 1.0 if look.alpha_mode == "OPAQUE" else alpha),
    }  # fmt: skip
    if look.alpha_mode == "MASK":
        plain["opacityThreshold"] = kinds.Float, look.alpha_cutoff
    for name, (kind, value) in plain.items():
        shader.CreateInput(name, kind).Set(value)
    placed: Any = _placed(stage, path, look) if pictures else None
    for slot, name in pictures.items():
        read = _shader(stage, f"{path}/{slot}", "UsdUVTexture")
        read.CreateInput("file", kinds.Asset).Set(name)
        read.CreateInput("sourceColorSpace", kinds.Token).Set(CHANNELS[slot])
        for side in ("wrapS", "wrapT"):
            read.CreateInput(side, kinds.Token).Set("repeat")
        read.CreateInput("st", kinds.Float2).ConnectToSource(placed.ConnectableAPI(), "result")
        for output, wanted, scale in _wires(slot, look):
            if scale is not None:
                read.CreateInput("scale", kinds.Float4).Set(gf.Vec4f(*scale))
            if slot == "normal":
                read.CreateInput("bias", kinds.Float4).Set(gf.Vec4f(-1.0, -1.0, -1.0, 0.0))
            kind = {"diffuseColor": kinds.Color3f, "normal": kinds.Normal3f}.get(wanted, kinds.Float)
            shader.CreateInput(wanted, kind).ConnectToSource(read.ConnectableAPI(), output)
    return material


def _wires(slot: str, look: Material) -> list[tuple[str, str, tuple[float, ...] | None]]:
    """What of a picture goes where: its output, the input of the surface, and by what its texels are multiplied."""
    if slot == "normal":
        return [("rgb", "normal", (2.0, 2.0, 2.0, 1.0))]
    if slot == "metallic_roughness":
        return [("g", "roughness", (1.0, look.roughness, look.metallic, 1.0)), ("b", "metallic", None)]
    alpha = [] if look.alpha_mode == "OPAQUE" else [("a", "opacity", None)]
    return [("rgb", "diffuseColor", look.base_colour), *alpha]


def _placed(stage: Any, path: str, look: Material) -> Any:
    """What tells pictures where they are read: glTF counts from the upper left, USD from the lower left."""
    kinds, gf = _pxr("Sdf").ValueTypeNames, _pxr("Gf")
    read = _shader(stage, f"{path}/st", "UsdPrimvarReader_float2")
    read.CreateInput("varname", kinds.String).Set("st")
    moved = _shader(stage, f"{path}/place", "UsdTransform2d")
    moved.CreateInput("in", kinds.Float2).ConnectToSource(read.ConnectableAPI(), "result")
    (x, y), (width, height), turn = look.offset, look.scale, look.rotation
    moved.CreateInput("scale", kinds.Float2).Set(gf.Vec2f(width, height))
    moved.CreateInput("rotation", kinds.Float).Set(math.degrees(turn))
    at = x + math.sin(turn) * height, 1.0 - y - math.cos(turn) * height
    moved.CreateInput("translation", kinds.Float2).Set(gf.Vec2f(*at))
    return moved


def _shader(stage: Any, path: str, kind: str) -> Any:
    shader = _pxr("UsdShade").Shader.Define(stage, path)
    shader.CreateIdAttr(kind)
    outputs, kinds = {"UsdPreviewSurface": "surface", "UsdUVTexture": "rgb"}, _pxr("Sdf").ValueTypeNames
    if kind == "UsdUVTexture":
        for name, what in (("rgb", kinds.Float3), *((one, kinds.Float) for one in "rgba")):
            shader.CreateOutput(name, what)
    else:
        shader.CreateOutput(outputs.get(kind, "result"), kinds.Token if kind in outputs else kinds.Float2)
    return shader
