"""The JSON of sizes."""

from __future__ import annotations

from pydantic import BaseModel, Field


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
