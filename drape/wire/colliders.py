"""Colliders as clients name them: planes, boxes and capsules in the world's coordinates [m], the y axis up."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator

from drape.geometry import colliders

PLACE_LIMIT_M, SIZE_LIMIT_M = 1e6, 1e3
COLLIDER_LIMIT = 32

Place = Annotated[float, Field(ge=-PLACE_LIMIT_M, le=PLACE_LIMIT_M)]
Length = Annotated[float, Field(gt=0.0, le=SIZE_LIMIT_M)]
Point = tuple[Place, Place, Place]


class _Collider(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Plane(_Collider):
    """A solid half-space behind a plane, such as a floor or a wall."""

    kind: Literal["plane"]
    normal: Point = Field(
        default=(0.0, 1.0, 0.0),
        description="The direction from the plane to its free side. Its length does not matter but must not be 0.",
    )
    offset_m: Place = Field(default=0.0, description="The plane's distance from the origin along the normal [m].")

    @field_validator("normal")
    @classmethod
    def _has_a_direction(cls, normal: Point) -> Point:
        if not np.linalg.norm(normal) > 1e-6:
            raise ValueError("a normal needs a length above 1e-6")
        return normal

    def row(self) -> np.ndarray:
        """Returns the plane as a row (16,) of numbers (``drape.geometry.colliders.plane``)."""
        return colliders.plane(self.normal, self.offset_m)


class Box(_Collider):
    """A solid box, such as a seat, a table or a step."""

    kind: Literal["box"]
    centre: Point = Field(description="The centre of the box [m].")
    size: tuple[Length, Length, Length] = Field(description="The lengths of its edges [m].")
    turn: Point = Field(default=(0.0, 0.0, 0.0), description="Its rotation, as a rotation vector [rad].")

    def row(self) -> np.ndarray:
        """Returns the box as a row (16,) of numbers (``drape.geometry.colliders.box``)."""
        return colliders.box(self.centre, self.size, self.turn)


class Capsule(_Collider):
    """A solid capsule, such as a rail or an arm rest. With both ends in one point it is a ball."""

    kind: Literal["capsule"]
    ends: tuple[Point, Point] = Field(description="The two ends of its axis [m].")
    radius_m: Length = Field(description="Its radius [m].")

    def row(self) -> np.ndarray:
        """Returns the capsule as a row (16,) of numbers (``drape.geometry.colliders.capsule``)."""
        return colliders.capsule(*self.ends, self.radius_m)


Collider = Annotated[Plane | Box | Capsule, Field(discriminator="kind")]


def collider_rows(chosen: tuple[Plane | Box | Capsule, ...] | None) -> np.ndarray:
    """Returns the ``chosen`` colliders as rows (M, 16) in the world (``drape.geometry.colliders``), none for None."""
    return np.stack([collider.row() for collider in chosen]) if chosen else colliders.NONE
