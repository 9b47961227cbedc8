"""Answers about garments: who wore them, how they look, what they cover, and their sizes."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field

from drape.export.surface import Surface
from drape.files.looks import Material


class WearerLikely(BaseModel):
    """A body that may have worn a garment, as it was found from the cloth."""

    height_m: float = Field(description="Standing, without shoes.")
    unit: str = Field(description="Of the file: a unit's name, or a size between the units in metres.")
    up: str = Field(description="The axis of the file that is up.")
    facing: str = Field(description="The axis of the file that the body faces along.")
    arms_deg: float = Field(description="How far the upper arms hang below the horizontal.")
    sure: float = Field(description="0 to 1: low where another body fits nearly as well, or the cloth lies far off.")
    words: str = Field(default="", description="The same in words.")
    options: dict[str, str] = Field(
        default={}, description="The fields of `POST /garments` that take the same file in on this body."
    )
    picture: str = Field(default="", description="The garment on this body: a PNG, base64.")


class WearerFound(WearerLikely):
    """The body that wore a garment, as it was found from the cloth."""

    others: list[WearerLikely] = Field(
        default=[], description="At most two bodies that are nearly as likely, the likelier first; none when sure."
    )


class LooksDocument(BaseModel):
    """How a garment's materials look, and which faces have which. Pictures are at /garments/{id}/textures/{number}."""

    materials: list[Material | None] = Field(description="Of each material; null if its file says nothing of it.")
    runs: list[tuple[int, int, int]] = Field(description="The first face, the number of faces and their material.")

    @staticmethod
    def of(surface: Surface) -> LooksDocument:
        """Returns the answer about the looks of what is drawn of a garment."""
        held = surface.face_material.astype(np.int64)
        starts = np.flatnonzero(np.diff(held, prepend=-1))
        counts = np.diff(starts, append=len(held))
        runs = [(int(at), int(count), int(held[at])) for at, count in zip(starts, counts, strict=True)]
        return LooksDocument(materials=list(surface.looks.materials), runs=runs)


class CoveredPrimitive(BaseModel):
    """The triangles of one primitive of a character's file that garments cover or hide."""

    node: int = Field(description="The number in the file of the node that has the mesh.")
    name: str = Field(description="The name of that node.")
    primitive: int = Field(description="The place of the primitive in its mesh.")
    triangles: int = Field(description="The number of triangles of the primitive.")
    ranges: list[int] = Field(
        description="The covered triangles: first triangle and count of each run, one run after the other."
    )
    hidden: list[int] = Field(description="The triangles that are taken off, as ``ranges``.")


class CoveredFaces(BaseModel):
    """The faces of a character that lie wholly under its garments, and those of its clothes that come off."""

    deeper_m: float = Field(description="How much further from the viewer a client should draw the faces [m].")
    share: float = Field(description="The share of the character's faces that are covered.")
    ranges: list[int] = Field(
        description="The covered faces of GET /avatars/{id}/mesh: first face and count of each "
        "run, one run after the other."
    )
    hidden: list[int] = Field(
        description="The faces of its own clothes that the garments replace, as ``ranges``: leave them out."
    )
    bare: int = Field(
        description="The number of faces of GET /avatars/{id}/bare, to be drawn where its clothes are left out."
    )
    skin_colour: list[float] = Field(description="The mean colour of its skin, sRGB, 0 to 1.")
    primitives: list[CoveredPrimitive] = Field(
        description="The covered triangles of each primitive of its file, in the order of the file's nodes."
    )


class SizeInfo(BaseModel):
    """A size of a garment: its length, and its girths without stress at the levels of the body that it goes around."""

    size: str
    chest_m: float | None = None
    waist_m: float | None = None
    hip_m: float | None = None
    length_m: float = Field(description="The length from the garment's highest to its lowest point as it hangs [m].")
    cut_for: dict[str, tuple[float, float]] = Field(
        description="The least and the greatest girth [m] of the bodies that the size is cut for, at the levels that "
        "decide."
    )


class SizeAdvice(BaseModel):
    """The size of a garment that fits a body."""

    size: str
    words: str = Field(description="The reason: the girth that decides, and the girths that the size is cut for.")
