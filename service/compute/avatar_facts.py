"""The facts of an avatar that clients are told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, Field

from drape.avatar.attire_words import Kind
from drape.avatar.own_garments import MARK, OWN
from drape.avatar.wearer import Wearer
from drape.garment.cache import Garment


class AvatarPart(BaseModel):
    """One part of a character."""

    name: str
    kind: Kind = Field(description="What it is.")
    faces: int = Field(description="The number of its triangles.")
    sure: float = Field(description="How sure the kind is, 0 to 1; 1 where a client told it.")
    bulky: bool = Field(default=False, description="Whether it is a thing that comes off with what a top replaces.")


class OwnGarment(BaseModel):
    """A garment that a character came in."""

    garment: str = Field(description="Its id, for requests that name the avatar.")
    kind: Kind
    parts: list[str] = Field(description="The names of the parts that it was. They are not drawn while it is worn.")


class AvatarFacts(BaseModel):
    """The facts of an avatar that clients are told."""

    name: str
    digest: str
    joints: dict[str, str] = Field(description="The node of the character's skeleton for each of SMPL's joints.")
    found_by: Literal["vrm", "names", "shape", "told"] = Field(
        default="names",
        description="How the joints were found: by VRM's bones, by the names of nodes, by their "
        "places, or told by PATCH.",
    )
    confidence: float = Field(
        default=1.0, description="Of joints found by their places: how much these are like a person's, 0 to 1."
    )
    notes: list[str] = Field(default=[], description="Sentences on what looks wrong with the character.")
    nodes: list[str] = Field(
        description="The names of all nodes of its file, parents first. The rotations of "
        "``rig_poses`` come in this order."
    )
    fit: dict[str, float] = Field(
        description="The distances [mm] of its trunk and limbs from the body that stands for it."
    )
    height_m: float
    rest_joints: list[list[float]] = Field(
        description="The joints at rest [m] of the body that stands for it, as in BodyDocument."
    )
    floor_m: float = Field(description="The height of its soles [m].")
    scale: float = Field(description="How many metres a unit of its file is.")
    vrm: str | None = Field(description="The version of VRM, if the file is one.")
    vertices: int = Field(description="The number of vertices of its own surface.")
    parts: list[AvatarPart] = Field(
        default=[], description="What is what on the character: skin, hair, clothes, things that it carries."
    )
    alive: list[OwnGarment] | None = Field(
        default=None,
        description="Its own clothes as garments, the innermost first; null where it was sent without `alive`.",
    )
    stiff: dict[str, str] = Field(
        default={}, description="Why clothes of its stay on its skin as they are, by the names of parts."
    )


class AvatarInfo(AvatarFacts):
    """A user's character that wears garments."""

    id: str


class AvatarWears(AvatarInfo):
    """A user's character, and what it can wear."""

    wears: dict[str, bool] = Field(description="Whether it can wear each garment, by the garments' ids.")
    wears_why: dict[str, str] = Field(description="Why it cannot wear a garment.")


def facts_of(wearer: Wearer, name: str, own: Sequence[Garment] | None, stiff: dict[str, str]) -> AvatarFacts:
    """Returns the facts of ``wearer``, whose id is ``name``, that clients are told, and those of its ``own`` clothes if
    these were asked for.
    """
    parts = wearer.attire.parts
    alive = None if own is None else [
        OwnGarment(garment=own_id(name, one), kind=one.manifest[OWN]["kind"],
                   parts=[parts[number].name for number in one.manifest[OWN]["parts"]])
        for one in own
    ]  # fmt: skip
    return AvatarFacts(
        name=wearer.name,
        digest=wearer.digest,
        joints=wearer.joints,
        found_by=wearer.found_by,  # pyright: ignore[reportArgumentType]
        confidence=round(wearer.confidence, 3),
        notes=list(wearer.notes),
        nodes=list(wearer.nodes),
        fit={"median_mm": round(wearer.median_mm, 2), "p95_mm": round(wearer.p95_mm, 2)},
        height_m=round(wearer.height_m, 4),
        rest_joints=np.round(wearer.body.joints_template, 6).tolist(),
        floor_m=round(wearer.body.floor_m(), 6),
        scale=wearer.scale,
        vrm=wearer.vrm or None,
        vertices=len(wearer.vertices),
        parts=[AvatarPart(**part._asdict()) for part in parts],
        alive=alive,
        stiff=stiff,
    )


def own_id(name: str, garment: Garment) -> str:
    """The id of a ``garment`` that the avatar ``name`` came in."""
    return f"{name}{MARK}{garment.manifest[OWN]['kind']}"
