"""How the materials of a mesh look: numbers of glTF's metallic-roughness model (2.0, 3.9) and pictures."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass as checked

MEDIA_TYPES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
Slot = Literal["base_colour", "normal", "metallic_roughness"]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Pair = tuple[float, float]


@checked(frozen=True, config=ConfigDict(allow_inf_nan=False))
class Material:
    """The look of one material.

    ``base_colour`` is linear RGBA, and a picture of it is multiplied by it. ``pictures`` holds, for each slot that has
    one, the number of a picture in the material's ``Looks``. ``offset``, ``rotation`` [rad] and ``scale`` place
    pictures as KHR_texture_transform does.
    """

    base_colour: tuple[Share, Share, Share, Share] = (1.0, 1.0, 1.0, 1.0)
    metallic: Share = 0.0
    roughness: Share = 0.85
    alpha_mode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    alpha_cutoff: Share = 0.5
    double_sided: bool = True
    pictures: dict[Slot, Annotated[int, Field(ge=0)]] = field(default_factory=dict)
    offset: Pair = (0.0, 0.0)
    rotation: float = 0.0
    scale: Pair = (1.0, 1.0)


_MATERIALS = TypeAdapter(list[Material | None])


@dataclass(frozen=True, eq=False)
class Looks:
    """How the materials of a mesh look: ``materials``, None where its file says nothing of one, and the ``pictures``
    that they show, each a PNG or JPEG file."""

    materials: tuple[Material | None, ...] = ()
    pictures: tuple[bytes, ...] = ()

    def material(self, index: int) -> Material | None:
        """Returns the look of material ``index``; None where there is none."""
        return self.materials[index] if index < len(self.materials) else None

    @property
    def digest(self) -> str:
        """The sha256 (hexadecimal) of materials and pictures; empty where no material has a look."""
        if not any(self.materials):
            return ""
        text = json.dumps(self.to_json(), sort_keys=True).encode()
        return hashlib.sha256(b"\0".join([text, *(hashlib.sha256(one).digest() for one in self.pictures)])).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """Returns the materials and how many bytes each picture has, as an object of JSON that ``looks_of`` reads."""
        materials = [None if one is None else asdict(one) for one in self.materials]
        return {"materials": materials, "picture_bytes": [len(one) for one in self.pictures]}


NO_LOOKS = Looks()


def media_type(picture: bytes) -> str:
    """Returns the media type of a PNG or JPEG file. Raises ``ValueError`` for any other bytes."""
    found = [kind for mark, kind in MEDIA_TYPES.items() if picture.startswith(mark)]
    if not found:
        raise ValueError("neither PNG nor JPEG")
    return found[0]


def looks_of(description: dict[str, Any], content: np.ndarray) -> Looks:
    """Returns the looks that ``description`` describes, which ``Looks.to_json`` returned. ``content`` (n,), uint8, are
    the bytes of all pictures, one after the other.

    Raises ``ValueError`` or ``TypeError`` where the two do not fit.
    """
    sizes = list(map(int, description["picture_bytes"]))
    materials, data = tuple(_MATERIALS.validate_python(description["materials"])), content.astype(np.uint8).tobytes()
    used = [number for look in materials if look for number in look.pictures.values()]
    if min(sizes, default=0) < 0 or sum(sizes) != len(data) or max(used, default=-1) >= len(sizes):
        raise ValueError("pictures that are not as long or as many as is told")
    ends = np.cumsum([0, *sizes]).tolist()
    pictures = tuple(data[start:end] for start, end in pairwise(ends))
    for picture in pictures:
        media_type(picture)
    return Looks(materials, pictures)


def replace_pictures(looks: Looks, cleaned: Sequence[bytes | None]) -> Looks:
    """Returns ``looks`` with the pictures ``cleaned`` in place of its own. Where one is None, materials show no
    picture."""
    numbers = [number for number, picture in enumerate(cleaned) if picture is not None]

    def changed(look: Material | None) -> Material | None:
        if look is None:
            return None
        pictures = {slot: numbers.index(number) for slot, number in look.pictures.items() if number in numbers}
        return replace(look, pictures=pictures)

    return Looks(tuple(map(changed, looks.materials)), tuple(picture for picture in cleaned if picture is not None))
