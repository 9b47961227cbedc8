"""What answers say of an avatar."""

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
    """A part of a character's surface, as its skin, its hair or a piece of clothing."""

    name: str
    kind: Kind = Field(description="The kind of the part.")
    faces: int = Field(description="The number of its triangles.")
    sure: float = Field(description="How sure the kind is, 0 to 1. It is 1 where a client has set the kind.")
    bulky: bool = Field(
        default=False, description="Whether it stands far off the body. Garments on the upper half then replace it."
    )


class OwnGarment(BaseModel):
    """A garment that was made from a character's own clothes."""

    garment: str = Field(description="The garment's id, for requests that name the avatar.")
    kind: Kind
    parts: list[str] = Field(
        description="The names of the character's parts that it was made from. They are not drawn while it is worn."
    )


class AvatarFacts(BaseModel):
    """The facts about a character that answers hold, all but its id."""

    name: str
    digest: str
    joints: dict[str, str] = Field(description="The node of the character's skeleton for each of SMPL's joints.")
    found_by: Literal["vrm", "names", "shape", "told"] = Field(
        default="names",
        description="How the joints were found. vrm: by VRM's bones. names: by the names of nodes. shape: by the "
        "positions of nodes. told: a client named them (PATCH).",
    )
    confidence: float = Field(
        default=1.0, description="Where joints were found by shape: how much they are like a person's, 0 to 1."
    )
    notes: list[str] = Field(default=[], description="Sentences on what looks wrong with the character.")
    nodes: list[str] = Field(
        description="The names of all nodes of its file, parents first. The rotations of "
        "``rig_poses`` come in this order."
    )
    fit: dict[str, float] = Field(
        description="How far the surface of its trunk and limbs is from the body that stands for it [mm]: median_mm is "
        "the median, p95_mm the 95th percentile."
    )
    height_m: float
    rest_joints: list[list[float]] = Field(
        description="The joints at rest [m] of the body that stands for it, as in BodyDocument."
    )
    floor_m: float = Field(description="The height of its soles [m].")
    scale: float = Field(description="How many metres a unit of its file is.")
    vrm: str | None = Field(description="The version of VRM, 0 or 1. Null for a file that is no VRM.")
    vertices: int = Field(description="The number of vertices of its own surface.")
    parts: list[AvatarPart] = Field(
        default=[], description="The parts of its surface: skin, hair, clothes, things that it carries."
    )
    alive: list[OwnGarment] | None = Field(
        default=None,
        description="The garments made from its own clothes, the innermost first. Null where it was uploaded without "
        "`alive`.",
    )
    stiff: dict[str, str] = Field(
        default={},
        description="The parts of its own clothes that did not become garments, and why. They move with the skin.",
    )


class AvatarInfo(AvatarFacts):
    """A user's character, which can wear garments."""

    id: str


class AvatarWears(AvatarInfo):
    """A user's character, and which garments it can wear."""

    wears: dict[str, bool] = Field(description="Whether it can wear each garment, by the garments' ids.")
    wears_why: dict[str, str] = Field(
        description="The reason for each garment that it cannot wear, by the garment's id."
    )


def facts_of(wearer: Wearer, name: str, own: Sequence[Garment] | None, stiff: dict[str, str]) -> AvatarFacts:
    """Returns the facts of ``wearer``, an avatar with the id ``name``.

    ``own`` are the garments made from its own clothes, None if none were to be made. ``stiff`` says by the names of
    parts why others did not become garments.
    """
    parts = wearer.attire.parts
    alive = None if own is None else [
        OwnGarment(garment=own_id(name, garment), kind=garment.manifest[OWN]["kind"],
                   parts=[parts[number].name for number in garment.manifest[OWN]["parts"]])
        for garment in own
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
    """Returns the id of ``garment``, which was made from the own clothes of the avatar ``name``."""
    return f"{name}{MARK}{garment.manifest[OWN]['kind']}"
