"""Requests and answers about measures of bodies, and about how garments fit."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, Field

from drape.wire.options import FabricChoice, SizeName
from service.http.schemas import Betas, PoseRows, Request

Given = Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=True)] | None
HEIGHT = "The height of the crown above the soles [m]."
CHEST = "The girth at the point of the chest that reaches furthest forward [m]."
WAIST = "The girth where the trunk is narrowest between hip and chest [m]."
HIP = "The girth at the point of the seat that reaches furthest back [m]."
INSEAM = "The height of the crotch above the soles [m]."
SLEEVE = "The length from the shoulder joint over the elbow to the wrist [m]."
SHOULDER = "The breadth between the points of both shoulders [m]."
WEIGHT = "The mass [kg]: the volume times 985 kg/m3."


class MeasureNumbers(BaseModel):
    """The measures of a body at rest, close to those of ISO 8559-1."""

    height_m: float = Field(description=HEIGHT)
    chest_m: float = Field(description=CHEST)
    waist_m: float = Field(description=WAIST)
    hip_m: float = Field(description=HIP)
    inseam_m: float = Field(description=INSEAM)
    sleeve_m: float = Field(description=SLEEVE)
    shoulder_m: float = Field(description=SHOULDER)
    weight_kg: float = Field(description=WEIGHT)


class ShapeRequest(Request):
    """One or more measures that a body should have. A measure that is left out gets its likeliest value."""

    height_m: Given = Field(default=None, description=HEIGHT)
    chest_m: Given = Field(default=None, description=CHEST)
    waist_m: Given = Field(default=None, description=WAIST)
    hip_m: Given = Field(default=None, description=HIP)
    inseam_m: Given = Field(default=None, description=INSEAM)
    sleeve_m: Given = Field(default=None, description=SLEEVE)
    shoulder_m: Given = Field(default=None, description=SHOULDER)
    weight_kg: Given = Field(default=None, description=WEIGHT)


class LevelNumbers(BaseModel):
    """The heights [m] at which girths are measured: y coordinates of the body at rest."""

    chest_m: float
    waist_m: float
    hip_m: float


class Range(BaseModel):
    """The least and the greatest value that a measure can have on this body, in the unit of the measure."""

    least: float
    most: float


class MeasuresDocument(BaseModel):
    """A shape, its measures, and the range of each measure on this body."""

    betas: list[float] = Field(description="The shape coefficients.")
    measures: MeasureNumbers
    levels: LevelNumbers
    ranges: dict[str, Range] = Field(description="The range of each measure, by the measure's name.")


class ShapeDocument(BaseModel):
    """The likeliest shape with the given measures, and all measures of it."""

    betas: list[float] = Field(description="The shape coefficients.")
    measures: MeasureNumbers
    missed: dict[str, float] = Field(
        description="The given measures that the shape misses by more than 5 mm or 0.5 kg, and by how much it is "
        "larger there."
    )


class FitRequest(Request):
    """The shape of the body, its pose, the fabric and the size for which a fit is asked."""

    betas: Betas | None = Field(default=None, description="The shape coefficients of the body. Left out: zeros.")
    pose: PoseRows | None = Field(
        default=None, description="The pose in which strain and pressure are measured. Left out: the rest pose."
    )
    fabric: FabricChoice | None = Field(
        default=None, description="The fabric, as in POST /drape. Left out: the garment's own."
    )
    size: SizeName | None = Field(
        default=None, description="The size, as in POST /drape. Left out: M, or the only size that the garment has."
    )
    vertices: bool = Field(
        default=False, strict=True, description="Whether a JSON answer also holds strain and pressure of each vertex."
    )


class EaseNumbers(BaseModel):
    """The girths [m] of the body and of the garment without stress at one height, and the ease: how much larger the
    garment's is.
    """

    body_m: float
    garment_m: float
    ease_m: float


class RegionNumbers(BaseModel):
    """The cloth on a region of the body. Strains are engineering strains: 0.01 is one per cent longer than at rest."""

    area_m2: float = Field(description="The area of the cloth on the region [m2].")
    warp: float = Field(description="The mean strain along the warp.")
    weft: float = Field(description="The mean strain along the weft.")
    high: float = Field(description="The strain along warp or weft that a twentieth of the cloth exceeds.")
    touching: float = Field(description="The share of the cloth that lies on the skin, 0 to 1.")
    pressure_n_per_m2: float = Field(description="The mean pressure [N/m2] of the cloth that lies on the skin.")
    gap_m: float = Field(description="The mean distance of the cloth from the skin [m].")


class FitDocument(BaseModel):
    """How a garment fits a body: in words, by the heights and regions that it covers, and by vertex if the request asks
    for that.
    """

    garment: str = Field(description="The id of the garment.")
    words: list[str] = Field(description="Sentences on the fit.")
    ease: dict[str, EaseNumbers] = Field(
        description="The ease at each height that the garment goes around, by its name."
    )
    regions: dict[str, RegionNumbers] = Field(description="The cloth on each region of the body, by the region's name.")
    warp: list[float] | None = Field(default=None, description="The strain along the warp at each delivered vertex.")
    weft: list[float] | None = Field(default=None, description="The strain along the weft at each delivered vertex.")
    pressure: list[float] | None = Field(
        default=None,
        description="The pressure of each delivered vertex on the skin [N/m2]; 0 where the cloth does not touch it.",
    )
