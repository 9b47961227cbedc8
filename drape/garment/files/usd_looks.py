"""The looks of a USD file's materials: UsdPreviewSurface, with UsdUVTexture, UsdTransform2d and UsdPrimvarReader."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from pydantic import ValidationError

from drape.errors import MeshError
from drape.files.looks import Looks, Material, Slot
from drape.files.notes import absent_file, absent_look, absent_picture, warning
from drape.files.pictures import Channel, metallic_roughness
from drape.garment.files.mesh import Beside

CHANNELS = {"r": 0, "g": 1, "b": 2, "a": 3}
GLTF_CHANNELS = {"roughness": "g", "metallic": "b"}  # channels of a picture that glTF takes as it is
USUAL = "st"  # the usual name of texture coordinates


def coordinates_of(prims: Sequence[Any | None]) -> str:
    """Returns the name of the texture coordinates that place the first picture of the material ``prims``; "st" if none
    says it."""
    for prim in prims:
        surface = None if prim is None else _surface(prim)
        for name in () if surface is None else ("diffuseColor", "normal", "roughness"):
            texture, _ = _source(surface, name)
            reader = None if texture is None else _placed(texture)[1]
            coordinates = None if reader is None else _value(reader, "varname")
            if coordinates:
                return str(coordinates)
    return USUAL


def usd_looks(prims: Sequence[Any | None], beside: Beside) -> tuple[Looks, tuple[str, ...]]:
    """Returns the looks of the materials ``prims``, in their order, and notes about what is missing or left out. A look
    is None where the prim is None or has no UsdPreviewSurface. ``beside`` returns the bytes of a picture."""
    reader = _Reader(beside)
    looks = tuple(None if prim is None else reader.material(prim) for prim in prims)
    return Looks(looks, tuple(reader.held)), tuple(dict.fromkeys(reader.notes))


class _Reader:
    """The pictures that were found so far, and what was not."""

    def __init__(self, beside: Beside) -> None:
        self.beside = beside
        self.numbers: dict[Any, int] = {}
        self.held: list[bytes] = []
        self.notes: list[str] = []

    def material(self, prim: Any) -> Material | None:
        surface = _surface(prim)
        if surface is None:
            return None
        base, channel = _source(surface, "diffuseColor")
        clear, clear_channel = _source(surface, "opacity")
        threshold = float(_value(surface, "opacityThreshold", 0.0))
        opacity = float(_value(surface, "opacity", 1.0) if clear is None else _scale(clear)[3])
        numbers: dict[Slot, int | None] = {
            "base_colour": None if base is None or channel != "rgb" else self.picture(base),
            "normal": None if (bumps := _source(surface, "normal")[0]) is None else self.picture(bumps),
            "metallic_roughness": self.metallic_roughness(surface),
        }
        pictures = {slot: number for slot, number in numbers.items() if number is not None}
        same = clear is not None and base is not None and clear.GetPrim() == base.GetPrim() and clear_channel == "a"
        if clear is not None and not same:
            self.notes.append(warning("an opacity that is not the alpha of its colour's picture is left out"))
            clear = None
        see_through = clear is not None or opacity < 1.0
        textured = {"metallic_roughness"} & set(pictures)
        tinted = base is not None and "base_colour" in pictures
        colour = _scale(base)[:3] if tinted else _value(surface, "diffuseColor", (0.18,) * 3)
        fields: dict[str, Any] = {
            "base_colour": (*np.clip(np.array(tuple(colour), dtype=float), 0.0, 1.0).tolist(), opacity),
            "metallic": 1.0 if textured else float(_value(surface, "metallic", 0.0)),
            "roughness": 1.0 if textured else float(_value(surface, "roughness", 0.5)),
            "alpha_mode": "OPAQUE" if not see_through else "MASK" if threshold > 0.0 else "BLEND",
            "alpha_cutoff": threshold if threshold > 0.0 else 0.5,
            "pictures": pictures,
        }
        if textured and _source(surface, "metallic")[0] is None and float(_value(surface, "metallic", 0.0)) < 1.0:
            fields["metallic"] = float(_value(surface, "metallic", 0.0))
        placed = base if base is not None else bumps
        try:
            return Material(**fields | ({} if placed is None else _placing(_placed(placed)[0])))
        except ValidationError as error:
            self.notes.append(absent_look(prim.GetName(), error))
            return None

    def content(self, texture: Any) -> bytes | None:
        """The file of a UsdUVTexture."""
        asset = _value(texture, "file")
        path = getattr(asset, "path", "")
        content = self.beside(path) if path else None
        if content is None:
            self.notes.append(absent_file(path))
        return content

    def held_as(self, key: Any, content: bytes | None) -> int | None:
        if content is None:
            return None
        self.numbers[key] = len(self.held)
        self.held.append(content)
        return self.numbers[key]

    def picture(self, texture: Any) -> int | None:
        path = getattr(_value(texture, "file"), "path", "")
        return self.numbers[path] if path in self.numbers else self.held_as(path, self.content(texture))

    def metallic_roughness(self, surface: Any) -> int | None:
        """The number of a picture as glTF takes it, made of one or two."""
        sources = {name: _source(surface, name) for name in GLTF_CHANNELS}
        there = {name: source for name, source in sources.items() if source[0] is not None}
        if not there:
            return None
        paths = {getattr(_value(texture, "file"), "path", "") for texture, _ in there.values()}
        if len(paths) == 1 and all(channel == GLTF_CHANNELS[name] for name, (_, channel) in there.items()):
            return self.picture(next(iter(there.values()))[0])
        key = tuple((name, getattr(_value(t, "file"), "path", ""), channel) for name, (t, channel) in there.items())
        if key in self.numbers:
            return self.numbers[key]
        pairs: dict[str, Channel] = {}
        for name, (texture, channel) in there.items():
            if (content := self.content(texture)) is not None:
                pairs[name] = content, CHANNELS.get(channel, 0)
        if not pairs:
            return None
        try:
            picture = metallic_roughness(pairs.get("metallic"), pairs.get("roughness"), label="picture of roughness")
        except MeshError as error:
            self.notes.append(absent_picture(error))
            return None
        return self.held_as(key, picture)


def _surface(prim: Any) -> Any | None:
    """The UsdPreviewSurface of the material ``prim``."""
    shader = import_module("pxr.UsdShade").Material(prim).ComputeSurfaceSource()[0]
    return shader if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface" else None


def _source(shader: Any, name: str) -> tuple[Any | None, str]:
    """The UsdUVTexture that the input ``name`` is connected to, and which of its outputs."""
    found = shader.GetInput(name)
    for attribute in found.GetValueProducingAttributes() if found else ():
        source = import_module("pxr.UsdShade").Shader(attribute.GetPrim())
        if source and source.GetIdAttr().Get() == "UsdUVTexture":
            return source, attribute.GetBaseName()
    return None, ""


def _scale(texture: Any) -> tuple[float, ...]:
    """What the texels of a UsdUVTexture are multiplied by, in [0, 1]."""
    return tuple(np.clip(np.array(tuple(_value(texture, "scale", (1.0,) * 4)), dtype=float), 0.0, 1.0).tolist())


def _placed(texture: Any) -> tuple[Any | None, Any | None]:
    """The UsdTransform2d that ``texture`` is placed by and the UsdPrimvarReader_float2 before it."""
    transform, shader, name = None, texture, "st"
    for _ in range(4):  # in a stranger's file the chain may be a ring
        if shader is None:
            break
        found = shader.GetInput(name)
        attributes = found.GetValueProducingAttributes() if found else ()
        shader = next((import_module("pxr.UsdShade").Shader(one.GetPrim()) for one in attributes), None)
        kind = shader.GetIdAttr().Get() if shader else None
        if kind != "UsdTransform2d":
            return transform, shader if kind == "UsdPrimvarReader_float2" else None
        transform, name = shader, "in"
    return transform, None


def _value(shader: Any, name: str, usual: Any = None) -> Any:
    """What the input ``name`` is, through the inputs that it is connected to; ``usual`` where it is not there, or is no
    number or vector of numbers where that is one."""
    found = shader.GetInput(name)
    for attribute in found.GetValueProducingAttributes() if found else ():
        value = attribute.Get()
        return usual if value is None or (usual is not None and not _is_like(value, usual)) else value
    return usual


def _is_like(value: Any, usual: Any) -> bool:
    try:
        return np.asarray(value, dtype=float).shape == np.shape(usual)
    except (TypeError, ValueError):
        return False


def _placing(transform: Any | None) -> dict[str, Any]:
    """``transform`` of coordinates whose origin is at the lower left, as KHR_texture_transform says it."""
    if transform is None:
        return {}
    angle = float(np.deg2rad(_value(transform, "rotation", 0.0)))
    sx, sy = map(float, _value(transform, "scale", (1.0, 1.0)))
    x, y = map(float, _value(transform, "translation", (0.0, 0.0)))
    # (u, v) -> R S (u, v) + t of ours; with v = 1 - v' on both sides.
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return {"rotation": angle, "scale": (sx, sy), "offset": (x - s * sy, 1.0 - y - c * sy)}
