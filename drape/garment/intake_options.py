"""The options of an intake, and how a command line gives its fabric."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from drape.cloth.fabric_table import DEFAULT_FABRIC, fabric
from drape.errors import InputError
from drape.garment.mesh_checks import Unit, Up
from drape.garment.rest_detail import Rest
from drape.garment.sewing import Sewing

PATCH_SHARE_RANGE = (0.75, 2.2)  # what the network is trained on


@dataclass(frozen=True)
class IntakeOptions:
    """The options of an intake. ``unit`` and ``up``: the unit and the up axis of the file; "auto": as it lies best on
    the avatar.

    ``patches``: the number of patches over that of ``patch_count_for``. With 2 charts agree better, and frames take
    longer (docs/reference/quality.md measures the trade). ``rest``: what the cloth remembers of its shape
    (``rest_detail.rest_of``). ``fabric``: a name or the numbers of ``fabric_table.fabric``; None stands for the fabric
    of the garment's sewing, or else jersey. ``uv_unit_m``: metres of cloth per unit of uv, where uv are its panels.

    Raises ``InputError`` for ``patches`` outside ``PATCH_SHARE_RANGE``, an unknown fabric or rest, and a unit of uv
    that is not positive.
    """

    unit: Unit = "auto"
    up: Up = "auto"
    patches: float = 1.0
    rest: Rest = "auto"
    fabric: str | Mapping[str, Any] | None = None
    uv_unit_m: float | None = None

    def __post_init__(self) -> None:
        if self.fabric is not None:
            fabric(self.fabric)
        if self.rest not in get_args(Rest):
            expected = "one of " + ", ".join(get_args(Rest))
            raise InputError("rest", expected=expected, got=str(self.rest), cure="Take auto.")
        if self.uv_unit_m is not None and not 0.0 < self.uv_unit_m < np.inf:
            raise InputError(
                "uv unit", expected="metres > 0", got=f"{self.uv_unit_m:g}", cure="Leave it out if uv are no panels."
            )
        low, high = PATCH_SHARE_RANGE
        if not low <= self.patches <= high:
            raise InputError(
                "patches",
                expected=f"a number from {low:g} to {high:g}, over the usual number",
                got=f"{self.patches:g}",
                cure="Take 1, or 2 for charts that agree better.",
            )

    def completed_by(self, sewn: Sewing | None) -> IntakeOptions:
        """Returns these options with ``fabric`` filled in, and ``uv_unit_m``, from ``sewn`` where they are None;
        without ``sewn`` the fabric is the default one."""
        if sewn is None:
            return replace(self, fabric=self.fabric or DEFAULT_FABRIC)
        return replace(self, fabric=self.fabric or sewn.fabric, uv_unit_m=self.uv_unit_m or sewn.uv_unit_m)


DEFAULT_OPTIONS = IntakeOptions()


def read_fabric(text: str) -> str | dict[str, Any]:
    """Returns the fabric that a command line gives as ``text``: a name as it is, or a JSON object as a dictionary.
    Raises ``InputError`` for broken JSON."""
    if not text.lstrip().startswith("{"):
        return text
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(
            "fabric", expected="a name or a JSON object", got=str(error), cure="Correct the JSON."
        ) from error
