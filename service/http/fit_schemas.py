"""The JSON of measures of bodies, and of how garments fit."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from drape.wire.options import FabricChoice, SizeName
from service.http.schemas import Betas, PoseRows, Request

Given = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)] | None
HEIGHT = "Of the crown above the soles [m]."
CHEST = "Girth through the point of the chest that reaches furthest forward [m]."
WAIST = "Girth where the trunk is narrowest between hip and chest [m]."
HIP = "Girth through the point of the seat that reaches furthest back [m]."
INSEAM = "Of the crotch above the soles [m]."
SLEEVE = "From the shoulder joint over the elbow to the wrist [m]."
SHOULDER = "Between the points of both shoulders [m]."
WEIGHT = "The volume times 985 kg/m3 [kg]."


class MeasureNumbers(BaseModel):
    """Measures of a body at rest, by the names of ISO 8559-1 (``drape.body.measures``)."""

    height_m: float = Field(description=HEIGHT)
    chest_m: float = Field(description=CHEST)
    waist_m: float = Field(description=WAIST)
    hip_m: float = Field(description=HIP)
    inseam_m: float = Field(description=INSEAM)
    sleeve_m: float = Field(description=SLEEVE)
    shoulder_m: float = Field(description=SHOULDER)
    weight_kg: float = Field(description=WEIGHT)


class ShapeRequest(Request):
    """The measures that a body shall have, one or more; those that are left out come out as they are likely."""

    height_m: Given = Field(default=None, description=HEIGHT)
    chest_m: Given = Field(default=None, description=CHEST)
    waist_m: Given = Field(default=None, description=WAIST)
    hip_m: Given = Field(default=None, description=HIP)
    inseam_m: Given = Field(default=None, description=INSEAM)
    sleeve_m: Given = Field(default=None, description=SLEEVE)
    shoulder_m: Given = Field(default=None, description=SHOULDER)
    weight_kg: Given = Field(default=None, description=WEIGHT)


class LevelNumbers(BaseModel):
    """Heights [m] of the tapes, in the coordinates of the body at rest."""

    chest_m: float
    waist_m: float
    hip_m: float


class Range(BaseModel):
    """The least and the largest that a measure of this body can be."""

    least: float
    most: float


class MeasuresDocument(BaseModel):
    """A shape and its measures, and what this body can have."""

    betas: list[float]
    measures: MeasureNumbers
    levels: LevelNumbers
    ranges: dict[str, Range]


class ShapeDocument(BaseModel):
    """The likeliest shape that has the measures that were sent."""

    betas: list[float]
    measures: MeasureNumbers
    missed: dict[str, float] = Field(
        description="Of the measures that were sent those that this shape has not, by more than 5 mm or 0.5 kg: how "
        "much larger its own are."
    )


class FitRequest(Request):
    """Whose fit is asked for: a shape, a pose, and what the garment is made of."""

    betas: Betas | None = Field(default=None, description="Body shape; zeros if left out.")
    pose: PoseRows | None = Field(
        default=None, description="Where strain and pressure are looked at; the rest pose if left out."
    )
    fabric: FabricChoice | None = Field(default=None, description="As of POST /drape; the garment's own if left out.")
    size: SizeName | None = Field(default=None, description="As of POST /drape; M, or its only one, if left out.")
    vertices: bool = Field(default=False, strict=True, description="In JSON, also what is known of each vertex.")


class EaseNumbers(BaseModel):
    """Girths [m] at the level of a measure, of the garment without stress, and how much more it has than the body."""

    body_m: float
    garment_m: float
    ease_m: float


class RegionNumbers(BaseModel):
    """The cloth of a region of the body; strains are engineering strains."""

    area_m2: float
    warp: float = Field(description="Mean strain along the warp.")
    weft: float = Field(description="Mean strain along the weft.")
    high: float = Field(description="Strain that a twentieth of the cloth exceeds along warp or weft.")
    touching: float = Field(description="Share of the cloth that lies on the skin.")
    pressure_n_per_m2: float = Field(description="Mean pressure where it does [N/m2].")
    gap_m: float = Field(description="Mean distance from the skin [m].")


class FitDocument(BaseModel):
    """How a garment fits a body: in words, by levels and regions that it covers, and by vertices where asked for."""

    garment: str
    words: list[str]
    ease: dict[str, EaseNumbers]
    regions: dict[str, RegionNumbers]
    warp: list[float] | None = Field(default=None, description="Strain along the warp of each delivered vertex.")
    weft: list[float] | None = Field(default=None, description="And along the weft.")
    pressure: list[float] | None = Field(default=None, description="Pressure on the skin [N/m2], 0 off it.")
