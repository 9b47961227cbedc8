"""Answers about who wore a garment."""

from __future__ import annotations

from pydantic import BaseModel, Field


class WearerLikely(BaseModel):
    """A body that may have worn a garment, by its cloth."""

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
    """Who wore a garment, by its cloth."""

    others: list[WearerLikely] = Field(
        default=[], description="At most two bodies that are nearly as likely, the likelier first; none when sure."
    )
