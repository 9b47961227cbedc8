"""Options of a drape, written once: REST, stream, Python client, command line and page read this file.

A new option is a field here and the stage of the service that reads it. Left out, or null, an option is the service's
own setting; older clients keep working.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from annotated_types import Len
from pydantic import BaseModel, ConfigDict, Field

from drape.errors import did_you_mean
from drape.wire.colliders import COLLIDER_LIMIT, Collider

# Every list stops at its first mistake: the answer tells one, and a million of them take seconds to write down.
FIRST_ONLY = Field(fail_fast=True)
LAYER_LIMIT = 64  # far beyond what a service drapes, which says how many that is
SizeName = Annotated[str, Field(min_length=1, max_length=40)]  # which sizes there are, garments say
Identifier = Annotated[str, Field(min_length=1, max_length=120)]
Geometry = Literal["vertices", "jets"]
Inertia = Literal["mesh", "network"]
TierName = Literal["instant", "fast", "balanced", "accurate"]
Resolution = Literal["delivered", "fine"]
FoldsBy = Literal["server", "client"]


class Worn(BaseModel):
    """The garment that is draped, or several worn over each other, and in which size."""

    garment: Identifier | None = None
    garments: Annotated[list[Identifier], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="Instead of garment: several worn over each other, the innermost first.",
    )
    size: SizeName | Annotated[list[SizeName | None], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="S, M, L or XL of garments that have sizes (GET /garments), or a list of these by layer (null: M). "
        "Left out: M.",
    )


class FabricNumbers(BaseModel):
    """A fabric by the numbers of ``drape.cloth.fabric.Fabric``, which checks them."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    warp_n_per_m: float = Field(description="Stiffness against stretch along the warp [N/m].")
    weft_n_per_m: float = Field(description="And along the weft [N/m].")
    cross_n_per_m: float = Field(description="How much stretch of one pulls on the other [N/m].")
    shear_n_per_m: float = Field(description="Stiffness against shear [N/m], four times a laboratory's modulus.")
    bending_warp_j: float = Field(description="Rigidity of bending along the warp [N m].")
    bending_bias_j: float = Field(description="At 45 degrees to it [N m].")
    bending_weft_j: float = Field(description="And along the weft [N m].")
    density_kg_m2: float = Field(description="Mass per area [kg/m2].")


FabricChoice = Annotated[str, Field(min_length=1, max_length=40)] | FabricNumbers


class DrapeOptions(BaseModel):
    """Choices of a client. Names are those of Python; an alias is the name on the wire."""

    model_config = ConfigDict(frozen=True)

    push_out: bool | None = Field(
        default=None,
        description="Bring vertices out of the body and of garments below: folds lift them, without folds they are "
        "pushed; the service's setting if left out.",
    )
    knob: float | None = Field(
        default=None,
        alias="motion",
        ge=0.0,
        le=1.0,
        allow_inf_nan=False,
        description="How much the cloth follows motion: 0 as if at rest, 1 (default) in full.",
    )
    inertia: Inertia | None = Field(
        default=None,
        description="The source of inertia: the cloth's own mass on a coarse mesh, or the network, where the model "
        "knows motion; the service's setting if left out, network for jets.",
    )
    tier: TierName | Literal["exact"] | None = Field(
        default=None,
        description="How much is computed: a name for values of passes and folds (GET /tiers). Values named beside it "
        "win; the service's setting, balanced, if left out. exact, of clips alone: cloth at rest that does not pass "
        "through itself, as a job.",
    )
    passes: int | None = Field(
        default=None,
        ge=0,
        le=64,
        strict=True,
        description="How many corrections of the network run: fewer are faster; the tier's if left out.",
    )
    folds: int | None = Field(
        default=None,
        ge=0,
        le=16,
        strict=True,
        description="Steps of the cloth solver per frame: folds that grow and stay. 0 has none; the tier's if left "
        "out, none of jets.",
    )
    coarse: bool | None = Field(
        default=None,
        strict=True,
        description="With folds: a coarse cloth takes the steps, and the fine one settles around it; without, they are "
        "the fine cloth's. The tier's if left out.",
    )
    safe_folds: int | None = Field(
        default=None,
        ge=0,
        le=16,
        strict=True,
        description="With folds: steps of a frame whose pose is unlike those that the network was trained on, where "
        "they are more than folds. Left out: those of the tier accurate, or no more where folds are named.",
    )
    settle: int | None = Field(
        default=None,
        ge=1,
        le=64,
        strict=True,
        description="With folds: how many times as many steps a frame without a past gets; 8 if left out.",
    )
    cloth_contact: bool | None = Field(
        default=None,
        strict=True,
        description="With folds: cloth feels cloth, a garment itself and the garments below it. Left out: it does.",
    )
    folds_by: FoldsBy = Field(
        default="server",
        description="Who takes the steps of folds: the server, or with jets the client, by GET /garments/{id}/folds; "
        "the server then computes the network alone. One garment, without colliders.",
    )
    fabric: FabricChoice | Annotated[tuple[FabricChoice | None, ...], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="What the garments are made of: a name of GET /fabrics, numbers, or a list of these by layer, the "
        "innermost first (null: the garment's own). Left out: each garment's own.",
    )
    hidden: Annotated[tuple[Identifier, ...], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="Ids of garments that nobody sees, below others: they do not come. Nothing of them is computed but "
        "what a visible garment over them feels.",
    )
    colliders: Annotated[tuple[Collider, ...], Len(0, COLLIDER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="What else cloth lies on, in the world's coordinates: planes, boxes and capsules.",
    )
    geometry: Geometry = Field(
        default="vertices",
        description="Form of the answer: vertices, or the posed jets of the patches, for GET /garments/{id}/jets.",
    )
    resolution: Resolution = Field(
        default="delivered",
        description="The mesh: the delivered one, or the finer one that intake made where that is coarse.",
    )
    pixels_per_m: float | None = Field(
        default=None,
        gt=0.0,
        allow_inf_nan=False,
        description="Pixels of the picture per metre of the garment. Below 100 it is far away: the least "
        "tier unless passes or folds are named beside it, and coordinates of 8 bits; left out, it is near.",
    )


def wire_names(model: type[BaseModel]) -> dict[str, str]:
    """The names on the wire of the fields of ``model``, by their names in Python."""
    return {name: field.alias or name for name, field in model.model_fields.items()}


def options_document(options: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a request for ``options`` by their names in Python; None leaves one to the service.

    Raises ``TypeError`` for an option that does not exist, as Python does for an argument.
    """
    unknown = options.keys() - DrapeOptions.model_fields.keys()
    if unknown:
        known, first = ", ".join(DrapeOptions.model_fields), min(unknown)
        hint = did_you_mean(first, DrapeOptions.model_fields, f"There are {known}.")
        raise TypeError(f"no such option: {', '.join(sorted(unknown))}. {hint}")
    names = wire_names(DrapeOptions)
    return {names[name]: value for name, value in options.items() if value is not None}
