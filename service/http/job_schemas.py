"""Answers about jobs: uploads, and clips of tier exact."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from service.http.garment_schemas import WearerFound


class FrameTold(BaseModel):
    """The figures of a frame of a clip of tier exact."""

    frame: int = Field(description="The number of the frame in the clip, from 0.")
    force_share: float = Field(
        description="The norm of the forces left at all vertices, divided by the cloth's weight."
    )
    depth_m: float = Field(description="How deep the cloth lies in the skin at its deepest point [m].")
    energy_j: float = Field(description="The energy of the cloth on the body [J]. Heights count from the root.")
    start_j: float = Field(description="The energy of the frame's drape of tier accurate [J].")
    crossings: int = Field(description="The number of pairs of cloth triangles that cross.")
    start_crossings: int = Field(description="The number of such pairs in the frame's drape of tier accurate.")
    steps: int = Field(description="The number of Newton's steps.")


class JobInfo(BaseModel):
    """The state of an upload, or of a clip of tier exact."""

    id: str
    name: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    stage: str | None = Field(default=None, description="The name of the stage that a running job is in.")
    share: float = Field(
        default=0.0,
        description="The share of the work that is done, 0 to 1. For an upload it follows the usual times of the "
        "stages.",
    )
    garment: str | None = Field(
        default=None,
        description="The id of the garment of a finished upload; of several garments in its file the outermost.",
    )
    garments: list[str] = Field(
        default=[], description="The ids of all garments of a finished upload, the innermost first."
    )
    wearer: WearerFound | None = Field(
        default=None,
        description="The body on which a finished upload was modelled, as it was found from the cloth. Null if the "
        "upload named it.",
    )
    avatar: str | None = Field(default=None, description="The id of the avatar of a finished upload of a character.")
    problem: dict[str, Any] | None = Field(default=None, description="The refusal that ended a failed job.")
    notes: list[str] = Field(
        default=[], description="Sentences on what was left out of a finished job or looks wrong with it."
    )
    frames: int | None = Field(default=None, description="The number of frames of a clip.")
    told: list[FrameTold] = Field(
        default=[], description="The figures of the frames of a clip that are finished, in order."
    )
