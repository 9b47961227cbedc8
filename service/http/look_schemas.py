"""The JSON of how garments look."""

from __future__ import annotations

import numpy as np
from pydantic import BaseModel, Field

from drape.export.surface import Surface
from drape.files.looks import Material


class LooksDocument(BaseModel):
    """How a garment's materials look, and which faces have which. Pictures are at /garments/{id}/textures/{number}."""

    materials: list[Material | None] = Field(description="Of each material; null if its file says nothing of it.")
    runs: list[tuple[int, int, int]] = Field(description="The first face, the number of faces and their material.")

    @staticmethod
    def of(surface: Surface) -> LooksDocument:
        """The answer about what is drawn of a garment."""
        held = surface.face_material.astype(np.int64)
        starts = np.flatnonzero(np.diff(held, prepend=-1))
        counts = np.diff(starts, append=len(held))
        runs = [(int(at), int(count), int(held[at])) for at, count in zip(starts, counts, strict=True)]
        return LooksDocument(materials=list(surface.looks.materials), runs=runs)
