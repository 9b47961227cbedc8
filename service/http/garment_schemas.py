"""Answers about garments: the bodies that they were modelled on, their materials, what they cover, and their sizes."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field

from drape.export.surface import Surface
from drape.files.looks import Material


class WearerLikely(BaseModel):
    """A body that a garment may have been modelled on, as the intake found it from the cloth."""

    height_m: float = Field(description="The height of the body, standing without shoes [m].")
    unit: str = Field(description="The unit of the file: its name, or its length in metres where it is between units.")
    up: str = Field(description="The axis of the file that points up.")
    facing: str = Field(description="The axis of the file along which the body faces.")
    arms_deg: float = Field(description="The angle of the upper arms below the horizontal [degrees].")
    sure: float = Field(
        description="How sure the body is, 0 to 1. It is low where another body fits nearly as well, or the cloth "
        "lies far off the skin."
    )
    words: str = Field(default="", description="The body in words.")
    options: dict[str, str] = Field(
        default={}, description="The parameters of `POST /garments` with which the same file is taken in on this body."
    )
    picture: str = Field(default="", description="A picture of the garment on this body: a PNG, base64.")


class WearerFound(WearerLikely):
    """The body that a garment was modelled on, as the intake found it from the cloth."""

    others: list[WearerLikely] = Field(
        default=[], description="At most two other bodies that are nearly as likely, the likelier first."
    )


class LooksDocument(BaseModel):
    """How a garment's materials look, and which faces have which material. The pictures of textures are at
    /garments/{id}/textures/{number}.
    """

    materials: list[Material | None] = Field(
        description="The looks of each material. Null for a material of which the file has none."
    )
    runs: list[tuple[int, int, int]] = Field(
        description="The faces in runs of one material: first face, number of faces, index of the material."
    )

    @staticmethod
    def of(surface: Surface) -> LooksDocument:
        """Returns the answer about the looks of ``surface``, what is drawn of a garment."""
        material = surface.face_material.astype(np.int64)
        starts = np.flatnonzero(np.diff(material, prepend=-1))
        counts = np.diff(starts, append=len(material))
        runs = [(int(at), int(count), int(material[at])) for at, count in zip(starts, counts, strict=True)]
        return LooksDocument(materials=list(surface.looks.materials), runs=runs)


class CoveredPrimitive(BaseModel):
    """The triangles of one primitive of a character's file that garments cover or replace."""

    node: int = Field(description="The index in the file of the node that has the mesh.")
    name: str = Field(description="The name of that node.")
    primitive: int = Field(description="The index of the primitive in its mesh.")
    triangles: int = Field(description="The number of triangles of the primitive.")
    ranges: list[int] = Field(
        description="The covered triangles: first triangle and count of each run, one run after the other."
    )
    hidden: list[int] = Field(
        description="The triangles of clothes that garments replace, as ``ranges``: leave them out."
    )


class CoveredFaces(BaseModel):
    """The faces of a character that lie wholly under its garments, and those of its own clothes that the garments
    replace.
    """

    deeper_m: float = Field(description="How much farther from the viewer a client should draw the covered faces [m].")
    share: float = Field(description="The share of the character's faces that are covered.")
    ranges: list[int] = Field(
        description="The covered faces of GET /avatars/{id}/mesh: first face and count of each "
        "run, one run after the other."
    )
    hidden: list[int] = Field(
        description="The faces of its own clothes that the garments replace, as ``ranges``: leave them out."
    )
    bare: int = Field(
        description="The number of faces of GET /avatars/{id}/bare, to be drawn where its clothes are left out. 0: "
        "there is no such file."
    )
    skin_colour: list[float] = Field(
        description="The mean colour of its skin, sRGB, 0 to 1; where no skin shows that of its face, or of all faces."
    )
    primitives: list[CoveredPrimitive] = Field(
        description="The covered triangles of each primitive of its file that moves with the skeleton: those of "
        "skinned meshes first, then those that hang on bones, parents before children."
    )


class SizeInfo(BaseModel):
    """A size of a garment: its length, and its girths without stress at chest, waist and hip. A girth is null where the
    garment does not go around the body.
    """

    size: str
    chest_m: float | None = None
    waist_m: float | None = None
    hip_m: float | None = None
    length_m: float = Field(description="The length from the garment's highest to its lowest point as it hangs [m].")
    cut_for: dict[str, tuple[float, float]] = Field(
        description="The least and the greatest girth [m] of the bodies that the size is cut for, by the measures that "
        "decide the size."
    )


class SizeAdvice(BaseModel):
    """The size of a garment that fits a body."""

    size: str
    words: str = Field(description="The reason: the girth that decides, and the girths that the size is cut for.")
