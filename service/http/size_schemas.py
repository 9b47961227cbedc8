"""The JSON of sizes."""

from __future__ import annotations

from pydantic import BaseModel, Field


class SizeInfo(BaseModel):
    """A size of a garment: its girths without stress at the levels of the body that it goes around, and its length."""

    size: str
    chest_m: float | None = None
    waist_m: float | None = None
    hip_m: float | None = None
    length_m: float = Field(description="From its highest to its lowest point as it hangs [m].")
    cut_for: dict[str, tuple[float, float]] = Field(
        description="Least and greatest girth [m] of bodies that it is cut for, at the levels that decide."
    )


class SizeAdvice(BaseModel):
    """The size of a garment that a body takes."""

    size: str
    words: str = Field(description="Why: the girth that decides, and what the size is cut for.")
