"""Labels that lie inside their piece: as large as the room allows, clear of the grain line and the seams' numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from recovery.pattern.geometry import inside

HEIGHTS_M = (0.006, 0.005, 0.004, 0.003, 0.0025, 0.002, 0.0015)  # heights of capitals and figures that are tried
LINE_SHARE = 1.4  # distance of base lines over the height of the text
WIDTH_SHARE = 0.85  # width of a letter over the height of capitals, the mean over a word of a wide face
CLEAR_M = 0.003  # least distance from the sewing line and the grain
READABLE_M = 0.003  # height of letters: lower ones are turned upright if that makes them larger
GRID = 16  # places tried along each side of the piece's box


class Label(NamedTuple):
    """A text of ``lines`` on a piece, in letters ``height_m`` [m] high. The base line of the first begins at ``at`` [m]
    (2,) in the panel's frame.

    An ``upright`` label runs along the grain, from bottom to top.
    """

    lines: tuple[str, ...]
    at: np.ndarray
    height_m: float
    upright: bool = False

    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Returns the lower left and the upper right corner [m] (2,) of the text."""
        width, height = _size(self.lines, self.height_m)
        below = height - self.height_m
        low, high = ((-self.height_m, 0.0), (below, width)) if self.upright else ((0.0, -below), (width, self.height_m))
        return self.at + np.array(low), self.at + np.array(high)

    def baselines(self) -> list[tuple[np.ndarray, str]]:
        """Returns the start [m] (2,) of every line's base line, and the line."""
        step = LINE_SHARE * self.height_m * np.array([1.0, 0.0] if self.upright else [0.0, -1.0])
        return [(self.at + number * step, line) for number, line in enumerate(self.lines)]


def _size(lines: Sequence[str], height_m: float) -> tuple[float, float]:
    """Width and height [m] of a text, with the parts of letters below the last line."""
    return WIDTH_SHARE * height_m * max(map(len, lines)), height_m * (1.3 + LINE_SHARE * (len(lines) - 1))


def place_label(
    lines: Sequence[str],
    outline: np.ndarray,
    grain: np.ndarray,
    marks: np.ndarray,
    heights_m: Sequence[float] = HEIGHTS_M,
) -> Label:
    """Returns the label of ``lines`` inside ``outline`` [m] (N, 2), at the nearest place to the middle of the grain
    line.

    The first of ``heights_m`` [m] that fits is taken; upright only where a level one could not be read. The line
    ``grain`` [m] (2, 2) and the points ``marks`` [m] (M, 2) stay clear. Where none fits, the last lies at the grain
    line's middle.
    """
    middle = grain.mean(axis=0)
    # Sides in steps shorter than any letter is high: a box that none of them touches is inside or outside as a whole.
    rim = _dense(outline, heights_m[-1])
    line = _dense(grain, heights_m[-1])
    level = [(height, False) for height in heights_m]
    readable = [trial for trial in level if trial[0] >= READABLE_M]
    for height, upright in (*readable, *((height, True) for height in heights_m), *level[len(readable) :]):
        size = np.array(_size(lines, height))[:: -1 if upright else 1]
        low, room = outline.min(axis=0), np.ptp(outline, axis=0) - size
        if room.min() <= 0.0:
            continue
        steps = np.linspace(0.0, 1.0, GRID)
        places = low + np.stack(np.meshgrid(steps, steps), axis=2).reshape(-1, 2) * room
        fits = inside(places + 0.5 * size, outline)
        for points, gap_m in ((rim, CLEAR_M), (line, CLEAR_M), (marks, height)):
            fits[fits] = ~_touches(places[fits], size, points, gap_m)
        if fits.any():
            off = np.linalg.norm(places + 0.5 * size - middle, axis=1)
            corner = places[np.where(fits, off, np.inf).argmin()]
            at = corner + ([height, 0.0] if upright else [0.0, size[1] - height])
            return Label(tuple(lines), at, height, upright)
    return Label(tuple(lines), middle, heights_m[-1])


def _dense(line: np.ndarray, step_m: float) -> np.ndarray:
    """Points (M, 2) at most ``step_m`` [m] apart on the closed ``line`` (N, 2)."""
    side = np.roll(line, -1, axis=0) - line
    counts = np.maximum(1, np.ceil(np.linalg.norm(side, axis=1) / step_m)).astype(np.int64)
    start = np.repeat(np.arange(len(line)), counts)
    share = (np.arange(len(start)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[start]
    return line[start] + share[:, None] * side[start]


def _touches(places: np.ndarray, size: np.ndarray, points: np.ndarray, gap_m: float) -> np.ndarray:
    """Whether any of ``points`` (M, 2) comes nearer than ``gap_m`` to the box of each place (P,)."""
    off = points[None] - places[:, None]
    within = ((off > -gap_m) & (off < size + gap_m)).all(axis=-1)
    return np.asarray(within.any(axis=-1))
