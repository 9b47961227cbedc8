"""The JSON of faces that lie under garments."""

from __future__ import annotations

from pydantic import BaseModel, Field


class CoveredPrimitive(BaseModel):
    """Covered triangles of one primitive of a character's file."""

    node: int = Field(description="The node of its mesh, by its number in the file.")
    name: str = Field(description="The name of that node.")
    primitive: int = Field(description="Its place among the mesh's primitives.")
    triangles: int = Field(description="How many it has.")
    ranges: list[int] = Field(description="First triangle and count of each run of them, one run after the other.")


class CoveredFaces(BaseModel):
    """Faces of a character that lie wholly under what it wears."""

    deeper_m: float = Field(description="How much further from the viewer they are best drawn [m].")
    share: float = Field(description="Of all its faces.")
    ranges: list[int] = Field(description="Of the faces of /avatars/{id}/mesh, as those of a primitive.")
    primitives: list[CoveredPrimitive] = Field(description="Of its file, in the order of its nodes.")
