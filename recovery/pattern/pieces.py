"""The pieces to cut out of the cloth: panels with seam allowance, notches, grain line and label, on one sheet."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pyclipper

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.model import EdgeRef, Panel, Pattern
from recovery.pattern.triangulate import boundary_distance, inside

TOLERANCE_M = 5e-5  # of flattened curves
UNIT_M = 1e-7  # of the offsetting, which counts in integers
MITRE_LIMIT = 2.5  # times the allowance; sharper corners are cut off square
NOTCH_DEPTH_M = 0.004
NOTCH_GAP_M = 0.003  # nearer notches are one
GAP_M = 0.02
MARGIN_M = 0.01
FOOTER_M = 0.07  # below the pieces: title and the square that shows the scale
SCALE_SQUARE_M = 0.05
CLOTH_WIDTH_M = 1.5
LABEL_WIDTH_M, LABEL_HEIGHT_M = 0.065, 0.03

CLIPPER: Any = pyclipper  # compiled: a type checker does not see its names


@dataclass(frozen=True, eq=False)
class Notch:
    """A small cut from ``point`` [m] (2,) on the cutting line along ``inward`` (2,)."""

    point: np.ndarray
    inward: np.ndarray


@dataclass(frozen=True, eq=False)
class Piece:
    """A panel ready to be cut, in the panel's own frame [m].

    ``sewing`` (N, 2) and ``cutting`` (M, 2) are closed polygons, equal without allowance; ``grain`` (2, 2) runs along
    the warp; ``seam_marks`` are places inside the sewing line and the numbers of the stitches there.
    """

    panel: Panel
    sewing: np.ndarray
    cutting: np.ndarray
    notches: tuple[Notch, ...]
    grain: np.ndarray
    label: tuple[str, ...]
    label_at: np.ndarray
    seam_marks: tuple[tuple[np.ndarray, str], ...]


@dataclass(frozen=True, eq=False)
class Sheet:
    """Pieces on a sheet of ``width_m`` by ``height_m``, y up; ``offsets`` [m] are the origins of the panels' frames."""

    title: str
    pieces: tuple[Piece, ...]
    offsets: np.ndarray
    width_m: float
    height_m: float


def make_sheet(pattern: Pattern, *, allowance_m: float = 0.01) -> Sheet:
    """All pieces of ``pattern`` with ``allowance_m`` around each, in rows no wider than the cloth where they fit."""
    if not 0.0 <= allowance_m < 0.1:
        raise InputError("allowance_m", expected="0 to 0.1 m", got=f"{allowance_m}", cure="Pass metres: 0.01 is 1 cm.")
    pieces = [_piece(pattern, panel, allowance_m) for panel in pattern.panels]
    lows = np.array([piece.cutting.min(axis=0) for piece in pieces])
    sizes = np.array([np.ptp(piece.cutting, axis=0) for piece in pieces])
    width = max(CLOTH_WIDTH_M, float(sizes[:, 0].max()) + 2.0 * MARGIN_M)
    offsets = np.zeros((len(pieces), 2))
    x, row_top, row_height, used = MARGIN_M, 0.0, 0.0, 0.0
    for number in np.argsort(-sizes[:, 1], kind="stable"):
        if x > MARGIN_M and x + sizes[number, 0] + MARGIN_M > width:
            x, row_top, row_height = MARGIN_M, row_top + row_height + GAP_M, 0.0
        offsets[number] = np.array([x, row_top]) - lows[number] * [1.0, 0.0]
        x += sizes[number, 0] + GAP_M
        row_height = max(row_height, float(sizes[number, 1]))
        used = max(used, x - GAP_M + MARGIN_M)
    # Rows were stacked downwards from the top edge; turn them y up.
    height = row_top + row_height + MARGIN_M + FOOTER_M
    highs = lows[:, 1] + sizes[:, 1]
    offsets[:, 1] = height - MARGIN_M - offsets[:, 1] - highs
    used = max(used, SCALE_SQUARE_M + 0.25)
    return Sheet(pattern.name, tuple(pieces), offsets, used, height)


def _piece(pattern: Pattern, panel: Panel, allowance_m: float) -> Piece:
    sewing = geometry.outline(panel, TOLERANCE_M)
    cutting = offset(sewing, allowance_m)
    grain = _grain(sewing)
    marks, notches = [], []
    for number, stitch in enumerate(pattern.stitches):
        for ref in (stitch.first, stitch.second):
            if ref.panel != panel.name:
                continue
            ends_and_middle = geometry.equal_parameters(panel.edges[ref.edge], 2)
            points, inward = _inward(panel, ref, ends_and_middle)
            marks.append((points[1] + 0.012 * inward[1], str(number + 1)))
            for point, direction in zip(points[[1, 0, 2]], inward[[1, 0, 2]], strict=True):
                notches.append(Notch(point - allowance_m * direction, direction))
    kept: list[Notch] = []
    for notch in notches:
        # In a hollow corner the foot of the perpendicular lies inside the piece.
        on_line = boundary_distance(notch.point[None], cutting)[0] < 2e-4
        if on_line and all(np.linalg.norm(notch.point - other.point) > NOTCH_GAP_M for other in kept):
            kept.append(notch)
    label = [pattern.name, panel.name, "cut 1"]
    label += [pattern.material] if pattern.material else []
    label.append(f"seam allowance {1000.0 * allowance_m:g} mm")
    return Piece(
        panel=panel,
        sewing=sewing,
        cutting=cutting,
        notches=tuple(kept),
        grain=grain,
        label=tuple(label),
        label_at=_label_place(sewing, grain.mean(axis=0)),
        seam_marks=tuple(marks),
    )


def _inward(panel: Panel, ref: EdgeRef, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (T, 2) of an edge and unit normals (T, 2) towards the inside of its counter-clockwise panel."""
    tangents = geometry.edge_tangents(panel, ref.edge, t)
    return geometry.edge_points(panel, ref.edge, t), np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)


def offset(polygon: np.ndarray, distance_m: float) -> np.ndarray:
    """The counter-clockwise ``polygon`` [m] (N, 2) widened by ``distance_m`` >= 0, corners mitred."""
    if distance_m == 0.0:
        return polygon
    offsetter = CLIPPER.PyclipperOffset(MITRE_LIMIT)
    path = np.round(polygon / UNIT_M).astype(np.int64).tolist()
    offsetter.AddPath(path, CLIPPER.JT_MITER, CLIPPER.ET_CLOSEDPOLYGON)
    outer = [np.array(found) for found in offsetter.Execute(distance_m / UNIT_M) if CLIPPER.Orientation(found)]
    return max(outer, key=lambda found: abs(CLIPPER.Area(found.tolist()))) * UNIT_M


def _label_place(polygon: np.ndarray, grain_middle: np.ndarray) -> np.ndarray:
    """The start of the label: right of the grain line, or left of it if there is more room and it is needed."""
    right, left = np.inf, np.inf
    for below in (0.0, 0.5, 1.0):
        y = grain_middle[1] - below * LABEL_HEIGHT_M
        x = _crossings(polygon, 1, y) - grain_middle[0]
        right, left = min(right, *x[x > 0.0], np.inf), min(left, *-x[x < 0.0], np.inf)
    across = 0.008 if right > LABEL_WIDTH_M + 0.01 or right >= left else -LABEL_WIDTH_M
    return grain_middle + np.array([across, 0.0])


def _crossings(polygon: np.ndarray, axis: int, value: float) -> np.ndarray:
    """The other coordinate (N,) of where the sides of ``polygon`` cross the line x_axis = ``value``."""
    a, along = polygon, np.roll(polygon, -1, axis=0) - polygon
    crossing = (a[:, axis] > value) != (np.roll(a[:, axis], -1) > value)
    share = (value - a[crossing, axis]) / along[crossing, axis]
    return a[crossing, 1 - axis] + share * along[crossing, 1 - axis]


def _grain(polygon: np.ndarray) -> np.ndarray:
    """The grain line (2, 2): the middle six tenths of the longest upright stretch inside near the middle."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    best = np.array([low, high])
    length = -1.0
    for share in (0.5, 0.4, 0.6, 0.3, 0.7):
        x = low[0] + share * (high[0] - low[0])
        for bottom, top in pairwise(np.sort(_crossings(polygon, 0, x)).tolist()):
            middle = np.array([[x, 0.5 * (bottom + top)]])
            if inside(middle, polygon)[0] and top - bottom > 1.2 * length:
                length = top - bottom
                best = np.array([[x, bottom + 0.2 * length], [x, top - 0.2 * length]])
    return best
