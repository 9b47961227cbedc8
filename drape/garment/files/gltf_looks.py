"""The looks of a glTF file's materials (2.0, 3.9), with KHR_texture_transform and EXT_texture_webp."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from drape.errors import MeshError
from drape.files.gltf import GltfFile
from drape.files.gltf_json import excerpt
from drape.files.looks import Looks, Material, Slot
from drape.files.notes import absent_look, absent_picture


def gltf_looks(file: GltfFile, used: list[int | None]) -> tuple[Looks, tuple[str, ...]]:
    """Returns the looks of the materials of ``file`` with the numbers ``used``, in their order, and notes about
    pictures and looks that are left out. A look is None where the number is None, and where the material has none."""
    pictures: dict[str, int] = {}
    held: list[bytes] = []
    notes: list[str] = []

    def picture(texture: Any) -> int | None:
        try:
            entry = file.item("textures", _object(texture).get("index"), "materials")
            others = _object(entry.get("extensions"))
            source = next((_object(e).get("source") for e in others.values() if "source" in _object(e)), None)
            # The picture that every program reads comes before that of an extension.
            image = entry.get("source", source)
            if excerpt(image) not in pictures:
                content = file.picture(image)
                if content is None:
                    raise MeshError("picture", expected="a file beside", got="none", cure="Send it in the same zip.")
                pictures[excerpt(image)] = len(held)
                held.append(content)
            return pictures[excerpt(image)]
        except MeshError as error:
            notes.append(absent_picture(error))
            return None

    def material(number: int) -> Material | None:
        document = _object(file.item("materials", number, "primitives.material"))
        surface = _object(document.get("pbrMetallicRoughness"))
        glossy = _object(_object(document.get("extensions")).get("KHR_materials_pbrSpecularGlossiness"))
        base = surface.get("baseColorTexture") or glossy.get("diffuseTexture")
        textures: dict[Slot, Any] = {"base_colour": base, "normal": document.get("normalTexture")}
        textures["metallic_roughness"] = surface.get("metallicRoughnessTexture")
        placed = _object(_object(_object(base).get("extensions")).get("KHR_texture_transform"))
        numbers = {slot: picture(texture) for slot, texture in textures.items() if texture is not None}
        fields = {
            "base_colour": surface.get("baseColorFactor", glossy.get("diffuseFactor", (1.0,) * 4)),
            "metallic": surface.get("metallicFactor", 0.0 if glossy else 1.0),
            "roughness": surface.get("roughnessFactor", 1.0),
            "alpha_mode": document.get("alphaMode", "OPAQUE"),
            "alpha_cutoff": document.get("alphaCutoff", 0.5),
            "double_sided": document.get("doubleSided", False),
            "pictures": {slot: number for slot, number in numbers.items() if number is not None},
        }
        fields |= {key: placed[key] for key in ("offset", "rotation", "scale") if key in placed}
        try:
            return Material(**fields) if len(document.keys() - {"name", "extras"}) else None
        except ValidationError as error:
            notes.append(absent_look(f"material {number}", error))
            return None

    materials = tuple(None if number is None else material(number) for number in used)
    return Looks(materials, tuple(held)), tuple(dict.fromkeys(notes))


def _object(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
