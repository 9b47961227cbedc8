"""Options of a drape, written once: REST, stream, Python client, command line and page read this file.

A new option is a field here and the stage of the service that reads it; what only experts and measurements set is a
field of ``Advanced``. Left out, or null, an option is the service's own setting; older clients keep working. Release
0.1 is the last that takes the fields of ``Advanced`` beside ``advanced`` too.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal, Self

from annotated_types import Len
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from drape.errors import did_you_mean
from drape.wire.colliders import COLLIDER_LIMIT, Collider

LOGGER = logging.getLogger(__name__)
# Every list stops at its first mistake: the answer tells one, and a million of them take seconds to write down.
FIRST_ONLY = Field(fail_fast=True)
LAYER_LIMIT = 64  # far beyond the number that a service drapes, which it tells
SizeName = Annotated[str, Field(min_length=1, max_length=40)]
Identifier = Annotated[str, Field(min_length=1, max_length=120)]
Geometry = Literal["vertices", "jets"]
Inertia = Literal["mesh", "network"]
TierName = Literal["instant", "fast", "balanced", "accurate"]
Resolution = Literal["delivered", "fine"]
FoldsBy = Literal["server", "client"]


class WornGarments(BaseModel):
    """The garment that is draped, or several worn over each other, and in which size."""

    garment: Identifier | None = None
    garments: Annotated[list[Identifier], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="The ids of several garments worn over each other, the innermost first. Takes the place of "
        "garment.",
    )
    size: SizeName | Annotated[list[SizeName | None], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="S, M, L or XL, for garments that have sizes (GET /garments), or a list with a size for each "
        "garment. null, or left out: M.",
    )


class FabricNumbers(BaseModel):
    """A fabric by its numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    warp_n_per_m: float = Field(description="The stiffness against stretch along the warp [N/m].")
    weft_n_per_m: float = Field(description="The stiffness against stretch along the weft [N/m].")
    cross_n_per_m: float = Field(
        description="The coupling of warp and weft: the tension along one when the other is stretched [N/m]."
    )
    shear_n_per_m: float = Field(
        description="The stiffness against shear [N/m]: four times the shear modulus of a laboratory."
    )
    bending_warp_j: float = Field(description="The bending rigidity along the warp [N m].")
    bending_bias_j: float = Field(description="The bending rigidity at 45 degrees to the warp [N m].")
    bending_weft_j: float = Field(description="The bending rigidity along the weft [N m].")
    density_kg_m2: float = Field(description="The mass per area [kg/m2].")


FabricChoice = Annotated[str, Field(min_length=1, max_length=40)] | FabricNumbers


class Advanced(BaseModel):
    """Settings for experts and measurements. Each one that is left out is chosen by the tier or by the service."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    passes: int | None = Field(
        default=None,
        ge=0,
        le=64,
        strict=True,
        description="How many corrections of the network run. Fewer are faster. Left out: the tier's number.",
    )
    folds: int | None = Field(
        default=None,
        ge=0,
        le=16,
        strict=True,
        description="How many steps the solver of folds takes in each frame. 0: no folds. Left out: the tier's "
        "number; for jets that no client folds 0.",
    )
    coarse: bool | None = Field(
        default=None,
        strict=True,
        description="With folds: whether a coarse cloth takes the steps and the fine cloth settles around it. "
        "Otherwise the fine cloth takes them. Left out: as the tier does.",
    )
    safe_folds: int | None = Field(
        default=None,
        ge=0,
        le=16,
        strict=True,
        description="With folds: the least number of steps for a frame whose pose is unlike those of training. Left "
        "out: the number of tier accurate; if the request names folds, no more than folds.",
    )
    settle: int | None = Field(
        default=None,
        ge=1,
        le=64,
        strict=True,
        description="With folds: the factor on the number of steps for a frame without a past. Left out: 8.",
    )
    cloth_contact: bool | None = Field(
        default=None,
        strict=True,
        description="With steps of folds: whether a garment keeps off itself. With them or tier instant: whether the "
        "garments of an outfit press on each other; otherwise push_out parts them. Left out: true.",
    )
    push_out: bool | None = Field(
        default=None,
        description="Whether cloth is moved out of the body, and out of the garments below where layers do not press "
        "on each other (cloth_contact). Left out: true.",
    )
    inertia: Inertia | None = Field(
        default=None,
        description="Where inertia comes from. mesh: the cloth's own mass. network: the network, if the model is "
        "dynamic. Left out: the service's setting; for jets that no client folds network.",
    )


def _with_old_names(schema: dict[str, Any]) -> None:
    """Tells in ``schema`` of the options of ``Advanced`` at their old place, as deprecated."""
    for name, told in Advanced.model_json_schema()["properties"].items():
        schema["properties"][name] = told | {"deprecated": True, "description": f"Old name of advanced.{name}."}


class DrapeOptions(BaseModel):
    """The options of a drape. A field has its name in Python; an alias is its name on the wire."""

    model_config = ConfigDict(frozen=True, json_schema_extra=_with_old_names)

    knob: float | None = Field(
        default=None,
        alias="motion",
        ge=0.0,
        le=1.0,
        allow_inf_nan=False,
        description="How much inertia moves the cloth. 0: none. 1: in full. Left out: 1; with tier exact, which takes "
        "nothing else, 0.",
    )
    tier: TierName | Literal["exact"] | None = Field(
        default=None,
        description="How much is computed: a name for values of passes, folds and coarse (GET /tiers). A value of "
        "advanced wins over the tier's. Left out: the service's setting, balanced. exact is for "
        "clips alone: the answer is a job that seeks cloth at rest that does not pass through itself.",
    )
    folds_by: FoldsBy = Field(
        default="server",
        description="Who takes the steps of folds. server: the service. client: the client, which needs jets, one "
        "garment of cloth without colliders, and GET /garments/{id}/folds.",
    )
    fabric: FabricChoice | Annotated[tuple[FabricChoice | None, ...], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="The fabric of the garments: a name of GET /fabrics, the numbers of a fabric, or a list with a "
        "fabric for each garment, the innermost first. null, or left out: the garment's own fabric.",
    )
    hidden: Annotated[tuple[Identifier, ...], Len(1, LAYER_LIMIT), FIRST_ONLY] | None = Field(
        default=None,
        description="The ids of garments of this request that the viewer does not see. The answer leaves them out. "
        "The others are draped as in the whole outfit.",
    )
    colliders: Annotated[tuple[Collider, ...], Len(0, COLLIDER_LIMIT), FIRST_ONLY] | None = Field(
        default=None, description="Planes, boxes and capsules that the cloth collides with, in the world's coordinates."
    )
    geometry: Geometry = Field(
        default="vertices",
        description="The form of the answer. vertices: positions. jets: the posed jets of the patches, which a "
        "client turns into vertices by GET /garments/{id}/jets.",
    )
    resolution: Resolution = Field(
        default="delivered",
        description="The mesh of the answer. delivered: that of the garment's file. fine: the finer mesh that intake "
        "made if the file's is coarse, or the cloth under the drawn mesh of a garment that is hung (GET /garments).",
    )
    pixels_per_m: float | None = Field(
        default=None,
        gt=0.0,
        allow_inf_nan=False,
        description="How many pixels of the picture a metre of the garment takes. Below 100 the garment is far away: "
        "if advanced names nothing it gets tier instant, and a stream's FRAMEs have 8 bits in any case. Left "
        "out: it is near.",
    )
    advanced: Advanced = Field(
        default_factory=Advanced,
        description="What is computed, number by number, for those whom no tier suits. A value that is named here wins "
        "over the tier's.",
    )

    @model_validator(mode="before")
    @classmethod
    def _lift(cls, given: Any) -> Any:
        """Puts options of ``Advanced`` that stand beside ``advanced``, their place before, into it."""
        if not isinstance(given, Mapping):
            return given
        flat = {name: given[name] for name in Advanced.model_fields if given.get(name) is not None}
        others = {name: value for name, value in given.items() if name not in Advanced.model_fields}
        nested = others.pop("advanced", None)
        if not flat or not isinstance(nested, (Mapping, Advanced, type(None))):
            return others | ({} if nested is None else {"advanced": nested})
        Advanced.model_validate(flat)  # refused by the names that the client wrote
        nested = {name: value for name, value in dict(nested or ()).items() if value is not None}
        for name, value in flat.items():
            _tell_moved(name)
            if nested.get(name, value) != value:
                raise _said_twice(name, value)
        return others | {"advanced": flat | nested}

    def updated(self, **values: Any) -> Self:
        """Returns a copy of these options with ``values`` by the names of fields here or of ``Advanced``."""
        deep = {name: values.pop(name) for name in Advanced.model_fields if name in values}
        return self.model_copy(update=values | {"advanced": self.advanced.model_copy(update=deep)})


@cache
def _tell_moved(name: str) -> None:
    """Logs, once a process, that the option ``name`` has another place."""
    LOGGER.warning("option %s: write advanced.%s; release 0.1 is the last that takes it as it came", name, name)


def _said_twice(name: str, value: Any) -> ValidationError:
    """The refusal of the option ``name`` that came at both places with different values."""
    fault = PydanticCustomError(
        "said_twice", "the value of advanced.{name}, or one of the two left out", {"name": name}
    )
    return ValidationError.from_exception_data("options", [{"type": fault, "loc": (name,), "input": value}])


def wire_names(model: type[BaseModel]) -> dict[str, str]:
    """Returns the names on the wire of the fields of ``model``, by their names in Python."""
    return {name: field.alias or name for name, field in model.model_fields.items()}


def options_document(options: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the JSON fields of a request for ``options``, which have their names in Python; those that are None are
    left out.

    Raises ``TypeError`` for an option that does not exist, as Python does for an argument.
    """
    known = DrapeOptions.model_fields.keys()
    unknown = options.keys() - known - Advanced.model_fields.keys()
    if unknown:
        there = f"There are {', '.join(known)}, and in advanced {', '.join(Advanced.model_fields)}."
        hint = did_you_mean(min(unknown), [*known, *Advanced.model_fields], there)
        raise TypeError(f"no such option: {', '.join(sorted(unknown))}. {hint}")
    names = wire_names(DrapeOptions)
    return {names.get(name, name): value for name, value in options.items() if value is not None}
