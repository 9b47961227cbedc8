"""Unit, up axis and facing of a garment's file, as a client states them beside the body in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from drape.errors import BodyError
from drape.garment.mesh_checks import UNITS_M
from drape.garment.wearer_reading import AXES, USUAL_FRONTS, Reading

KEYS = ("unit", "up", "facing")


@dataclass(frozen=True)
class ReadingHints:
    """What is stated of a file's coordinates: ``unit``, its name and its length [m]; the axes ``up`` and ``front`` of
    the body, such as "+y". Each is None where nothing is stated."""

    unit: tuple[str, float] | None = None
    up: str | None = None
    front: str | None = None

    @property
    def reading(self) -> Reading | None:
        """Returns the reading of the file if unit and both axes are stated, else None."""
        return None if self.unit is None or not (self.up and self.front) else Reading(*self.unit, self.up, self.front)

    @property
    def turned(self) -> Reading | None:
        """Returns a reading in metres with the stated axes, and the usual one for an axis that is not stated; None if
        no axis is."""
        if self.up is None and self.front is None:
            return None
        up = self.up or ("+y" if self.front and self.front[1] != "y" else "+z")
        front = self.front or USUAL_FRONTS.get(up, USUAL_FRONTS[f"+{up[1]}"])[0]
        return Reading("m", 1.0, up, front)


NO_HINTS = ReadingHints()


def reading_hints(meaning: Any) -> tuple[ReadingHints, Any]:
    """Returns what ``meaning``, as ``avatars.parse_avatar`` returns it, states of the file's unit and axes; and
    ``meaning`` without that, None if a dictionary states nothing else. Raises ``BodyError`` for an unknown unit or
    axis, and where the body would face along the axis that is up."""
    if not isinstance(meaning, dict) or not set(KEYS) & set(meaning):
        return NO_HINTS, meaning
    unit, up, front = (meaning.get(key) for key in KEYS)
    reading = ReadingHints(
        None if unit is None else _unit(unit),
        None if up is None else _axis(up),
        None if front is None else _axis(front),
    )
    if reading.up and reading.front and reading.up[1] == reading.front[1]:
        cure = 'Give for example {"up": "z", "facing": "-y"}.'
        raise BodyError("avatar facing", expected=f"an axis across {reading.up}", got=reading.front, cure=cure)
    return reading, {key: value for key, value in meaning.items() if key not in KEYS} or None


def _unit(value: Any) -> tuple[str, float]:
    if isinstance(value, str) and value in UNITS_M:
        return value, UNITS_M[value]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < np.inf:
        expected = f"{', '.join(UNITS_M)}, or metres > 0"
        raise BodyError("avatar unit", expected=expected, got=repr(value)[:60], cure='Give for example {"unit": "cm"}.')
    named = next((name for name, scale in UNITS_M.items() if abs(scale / value - 1.0) < 1e-6), "free")
    return named, float(value)


def _axis(value: Any) -> str:
    axis = f"+{value}" if value in ("x", "y", "z") else value
    if axis not in AXES:
        cure = 'Give for example {"up": "z"}.'
        raise BodyError("avatar axis", expected="x, y, z, -x, -y or -z", got=repr(value)[:60], cure=cure)
    return axis
