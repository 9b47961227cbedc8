"""The looks of an FBX file's materials, as ufbx tells them of every program's."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from drape.errors import MeshError
from drape.files.looks import Looks, Material, Slot
from drape.files.pictures import metallic_roughness
from drape.garment.files.mesh import Beside


def fbx_looks(
    materials: Sequence[dict[str, Any] | None], files: Sequence[tuple[list[str], bytes]], beside: Beside
) -> tuple[Looks, tuple[str, ...]]:
    """The looks of ``materials`` (``fbx_process``), with the pictures of ``files`` or ``beside``, and notes of what is
    not there."""
    numbers: dict[Any, int] = {}
    held: list[bytes] = []
    notes: list[str] = []

    def content(number: int) -> bytes | None:
        names, inside = files[number]
        named = next((name for name in names if name), "")
        found = inside or (beside(named) if named else None)
        if not found:
            notes.append(f"warning: {named!a:.80} is not beside the mesh: send it in the same zip")
        return found or None

    def kept(key: Any, found: bytes | None) -> int | None:
        if found is not None and key not in numbers:
            numbers[key] = len(held)
            held.append(found)
        return numbers.get(key)

    def rough(metal: int | None, roughness: int | None) -> int | None:
        """The number of the picture that glTF takes, made of one or two."""
        if (metal, roughness) in numbers:
            return numbers[metal, roughness]
        found = [None if one is None else content(one) for one in (metal, roughness)]
        channels = [None if one is None else (one, 0) for one in found]
        try:
            picture = metallic_roughness(*channels, label="picture of roughness") if any(channels) else None
        except MeshError as error:
            notes.append(f"warning: a picture is left out: {error}")
            picture = None
        return kept((metal, roughness), picture)

    def material(told: dict[str, Any] | None) -> Material | None:
        if told is None:
            return None
        shown = told["pictures"]
        metal, roughness, bumps = shown.get("metalness"), shown.get("roughness"), shown.get("normal_map")
        if bumps is None and "bump" in shown and re.search("nor|nrm", " ".join(files[shown["bump"]][0]).lower()):
            bumps = shown["bump"]  # what is called a bump is a height or, as often, a normal: its name tells
        plain: dict[Slot, int | None] = {"base_colour": shown.get("base_color"), "normal": bumps}
        slots: dict[Slot, int | None] = {
            slot: numbers[one] if one in numbers else kept(one, content(one))
            for slot, one in plain.items()
            if one is not None
        }
        slots["metallic_roughness"] = None if metal is None and roughness is None else rough(metal, roughness)
        pictures: dict[Slot, int] = {slot: number for slot, number in slots.items() if number is not None}
        packed, alpha = "metallic_roughness" in pictures, _share(told["opacity"], 1.0)
        colour = np.array(told["base_color"] or (0.8,) * 3, dtype=float) * _share(told["base_factor"], 1.0)
        rgb = (1.0, 1.0, 1.0) if "base_colour" in pictures else np.clip(np.nan_to_num(colour), 0.0, 1.0).tolist()
        return Material(
            (rgb[0], rgb[1], rgb[2], alpha),
            metallic=1.0 if packed and metal is not None else _share(told["metalness"], 0.0),
            roughness=1.0 if packed and roughness is not None else _share(told["roughness"], 0.85),
            alpha_mode="BLEND" if alpha < 1.0 else "OPAQUE",
            pictures=pictures,
        )

    looks = tuple(map(material, materials))
    return Looks(looks, tuple(held)), tuple(dict.fromkeys(notes))


def _share(value: float | None, usual: float) -> float:
    """``value`` within 0 and 1."""
    return min(max(float(value), 0.0), 1.0) if value is not None and np.isfinite(value) else usual
