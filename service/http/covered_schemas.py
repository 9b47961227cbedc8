"""The JSON of faces that lie under garments."""

from __future__ import annotations

from pydantic import BaseModel, Field


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
