"""What the service tells of jobs: uploads, and clips of tier exact."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from service.http.garment_schemas import WearerFound


class FrameTold(BaseModel):
    """The figures of a frame of tier exact."""

    frame: int
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
    """Returns the state of an upload, or of a clip of tier exact."""

    id: str
    name: str
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    stage: str | None = Field(default=None, description="While the job runs: what its process does.")
    share: float = Field(
        default=0.0,
        description="How much of the work is done, 0 to 1. It follows the usual times of the stages and is no clock.",
    )
    garment: str | None = Field(
        default=None, description="Of an uploaded garment that is done: its id; of several in a file the outermost."
    )
    garments: list[str] = Field(
        default=[], description="Of an uploaded garment that is done: the garments in the file, the innermost first."
    )
    wearer: WearerFound | None = Field(
        default=None, description="Of an uploaded garment whose avatar nobody named: the body that was found in it."
    )
    avatar: str | None = Field(default=None, description="Of an uploaded character that is done: the avatar's id.")
    problem: dict[str, Any] | None = Field(default=None, description="Of a job that failed: the refusal.")
    notes: list[str] = Field(
        default=[], description="Of a job that is done: sentences on what was left out or looks wrong."
    )
    frames: int | None = Field(default=None, description="Of a clip: the number of its frames.")
    told: list[FrameTold] = Field(
        default=[], description="Of a clip: the figures of the frames that are finished, in order."
    )
