"""The looks of an FBX file's materials, as ufbx tells them of every program's."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from drape.errors import MeshError
from drape.files.looks import Looks, Material, Slot
from drape.files.notes import absent_file, absent_picture
from drape.files.pictures import metallic_roughness
from drape.garment.files.mesh import Beside


def fbx_looks(
    materials: Sequence[dict[str, Any] | None], files: Sequence[tuple[list[str], bytes]], beside: Beside
) -> tuple[Looks, tuple[str, ...]]:
    """Returns the looks of ``materials``, in their order, and notes about pictures that are missing or left out.
    ``materials``: dictionaries as ``drape.files.fbx`` reads them; where one is None its look is None. ``files``: for
    each picture its possible names and its bytes, empty if it is not in the file; such pictures are read by
    ``beside``."""
    numbers: dict[Any, int] = {}
    held: list[bytes] = []
    notes: list[str] = []

    def content(number: int) -> bytes | None:
        names, inside = files[number]
        named = next((name for name in names if name), "")
        payload = inside or (beside(named) if named else None)
        if not payload:
            notes.append(absent_file(named))
        return payload or None

    def kept(key: Any, picture: bytes | None) -> int | None:
        if picture is not None and key not in numbers:
            numbers[key] = len(held)
            held.append(picture)
        return numbers.get(key)

    def rough(metal: int | None, roughness: int | None) -> int | None:
        """The number of the picture that glTF takes, made of one or two."""
        if (metal, roughness) in numbers:
            return numbers[metal, roughness]
        contents = [None if number is None else content(number) for number in (metal, roughness)]
        channels = [None if payload is None else (payload, 0) for payload in contents]
        try:
            picture = metallic_roughness(*channels, label="picture of roughness") if any(channels) else None
        except MeshError as error:
            notes.append(absent_picture(error))
            picture = None
        return kept((metal, roughness), picture)

    def material(record: dict[str, Any] | None) -> Material | None:
        if record is None:
            return None
        shown = record["pictures"]
        metal, roughness, bumps = shown.get("metalness"), shown.get("roughness"), shown.get("normal_map")
        if bumps is None and "bump" in shown and re.search("nor|nrm", " ".join(files[shown["bump"]][0]).lower()):
            bumps = shown["bump"]  # a bump is a height or, as often, a normal map: its name says which
        plain: dict[Slot, int | None] = {"base_colour": shown.get("base_color"), "normal": bumps}
        slots: dict[Slot, int | None] = {
            slot: numbers[number] if number in numbers else kept(number, content(number))
            for slot, number in plain.items()
            if number is not None
        }
        slots["metallic_roughness"] = None if metal is None and roughness is None else rough(metal, roughness)
        pictures: dict[Slot, int] = {slot: number for slot, number in slots.items() if number is not None}
        packed, alpha = "metallic_roughness" in pictures, _share(record["opacity"], 1.0)
        colour = np.array(record["base_color"] or (0.8,) * 3, dtype=float) * _share(record["base_factor"], 1.0)
        rgb = (1.0, 1.0, 1.0) if "base_colour" in pictures else np.clip(np.nan_to_num(colour), 0.0, 1.0).tolist()
        return Material(
            (rgb[0], rgb[1], rgb[2], alpha),
            metallic=1.0 if packed and metal is not None else _share(record["metalness"], 0.0),
            roughness=1.0 if packed and roughness is not None else _share(record["roughness"], 0.85),
            alpha_mode="BLEND" if alpha < 1.0 else "OPAQUE",
            pictures=pictures,
        )

    looks = tuple(map(material, materials))
    return Looks(looks, tuple(held)), tuple(dict.fromkeys(notes))


def _share(value: float | None, usual: float) -> float:
    """``value`` within 0 and 1."""
    return min(max(float(value), 0.0), 1.0) if value is not None and np.isfinite(value) else usual
