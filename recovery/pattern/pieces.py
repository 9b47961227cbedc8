"""The pieces to cut out of the cloth: panels with seam allowance, notches, grain line and label, on one sheet.

A cutting line leaves darts out, which stay closed, and goes into hollows narrower than two allowances.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pyclipper

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.geometry import boundary_distance, inside
from recovery.pattern.labels import Label, place_label
from recovery.pattern.sewing_pattern import Edge, EdgeRef, Panel, Pattern
from recovery.pattern.symmetry import Kind, find_symmetries

STEP_M = 0.002  # along the outline, between places whose gap is measured
SLIT_M = 0.001  # width of a cut in the middle of a narrow hollow; a quarter of a gap that is narrower than two
FAN_RAD = 0.1  # between the directions in which a gap is measured at a corner
ACROSS = -0.68  # the cosine between the ways to both sides of a hollow: of a wedge of 47 degrees, mitred by 2.5
NARROWEST_M = 2.5e-4  # half a gap
TIP_M, TIP_RAD = 0.004, 0.5  # a cut ends so far from a hollow's corner, which turns by more than so much
REACH = 1.1  # allowances from the outline, to where the middle of a hollow that widens is followed
TOLERANCE_M = 5e-5  # largest distance of a flattened curve from its own
UNIT_M = 1e-7  # unit of the offsetting, which counts in integers
MITRE_LIMIT = 2.5  # times the allowance; sharper corners are cut off square
SEAM_M, HEM_M = 0.01, 0.025  # allowances
NOTCH_DEPTH_M = 0.004
NOTCH_GAP_M = 0.003  # nearer notches are one
BACK_GAP_M = 0.008  # between the two notches in the middle of a seam of the back
SHORTEST_BACK_M = 0.04  # a seam of the back that is shorter has one notch too
HEM_BEND = 0.1  # an edge that bends by more than this share of its chord is faced and not turned up
FACING = 0.3  # least part of a panel's normal along z in front and behind; a panel with less is at a side
MIRROR_M = 1e-4  # panels that are each other's image within this are cut as a pair
GAP_M = 0.02
MARGIN_M = 0.01
FOOTER_M = 0.07  # height below the pieces, for the title and the square that shows the scale
SCALE_SQUARE_M = 0.05
CLOTH_WIDTH_M = 1.5
SEAM_MARK_M = 0.012  # inside the sewing line
FACED = "facing"  # ends the label of an edge at which a piece is sewn to its own copy

CLIPPER: Any = pyclipper  # compiled: a type checker does not see its names


def dart_legs(pattern: Pattern, panel: Panel, tolerance_m: float) -> set[int]:
    """Returns the numbers of the edges of ``panel`` that are legs of darts: neighbours that are sewn together, with a
    wedge between them. Curves are flattened to ``tolerance_m`` [m]."""
    sewn = {}
    for stitch in pattern.stitches:
        if stitch.first.panel == stitch.second.panel == panel.name:
            sewn |= {stitch.first.edge: stitch.second.edge, stitch.second.edge: stitch.first.edge}
    left, count = list(range(len(panel.edges))), len(panel.edges)

    def is_dart(first: int, second: int) -> bool:
        run = [(first + k) % count for k in range((second - first) % count + 1)]
        line = np.concatenate([geometry.flatten(panel, number, tolerance_m) for number in run])
        x, y = (line - line[0]).T
        width = float(np.linalg.norm(line[-1] - line[0]))
        return x @ np.roll(y, -1) < y @ np.roll(x, -1) and width < geometry.edge_length(panel, first)

    # Legs of several edges close from the tip on.
    while len(left) > 2 and (
        pair := next(
            (p for p in zip(left, left[1:] + left[:1], strict=True) if sewn.get(p[0]) == p[1] and is_dart(*p)), None
        )
    ):
        left = [number for number in left if number not in pair]
    return set(range(count)) - set(left)


def slits(polygon: np.ndarray, reach_m: float, mitre: float) -> list[tuple[np.ndarray, float]]:
    """Returns cuts into the hollows of the counter-clockwise ``polygon`` [m] (M, 2) that are narrower than twice
    ``reach_m`` [m]: for each its middle line [m] (N, 2), and half its width [m].

    A cut runs out of its hollow by ``mitre`` times ``reach_m``. A point of the middle line is the centre of the largest
    circle that touches the outline from outside at one place (the medial axis; Blum 1967). It counts where the circle
    touches the other side across the hollow.
    """
    side = np.roll(polygon, -1, axis=0) - polygon
    angle = np.arctan2(-side[:, 0], side[:, 1])  # of the normals
    turn = np.mod(np.roll(angle, -1) - angle + np.pi, 2.0 * np.pi) - np.pi
    places, angles, at_corner = [], [], []
    for start, along, normal, bend in zip(polygon, side, angle, turn, strict=True):
        count = max(1, int(np.ceil(np.linalg.norm(along) / STEP_M)))
        fan = max(0, int(bend / FAN_RAD))
        share = np.concatenate([(np.arange(count) + 0.5) / count, np.ones(fan)])
        places.append(start + share[:, None] * along)
        angles.append(normal + np.concatenate([np.zeros(count), bend * (np.arange(fan) + 0.5) / max(fan, 1)]))
        at_corner.append(np.arange(count + fan) >= count)
    point, normal, corner = np.concatenate(places), np.concatenate(angles), np.concatenate(at_corner)
    normal = np.stack([np.cos(normal), np.sin(normal)], axis=1)
    high = np.where(corner, mitre, REACH) * reach_m

    def is_free(radius: np.ndarray) -> np.ndarray:
        return boundary_distance(point + radius[:, None] * normal, polygon) > 0.999 * radius - 1e-7

    number = np.flatnonzero(~is_free(high))
    point, normal, high = (values[number] for values in (point, normal, high))
    corner, low = corner[number], np.zeros(len(number))
    for _ in range(14):
        middle = 0.5 * (low + high)
        free = is_free(middle)
        low, high = np.where(free, middle, low), np.where(free, high, middle)
    centre = point + low[:, None] * normal
    beyond = boundary_distance(centre + 0.1 * low[:, None] * normal, polygon) - boundary_distance(centre, polygon)
    faces = beyond < ACROSS * 0.1 * low
    tips = polygon[np.roll(turn, 1) < -TIP_RAD]
    clear = (np.linalg.norm(centre[:, None] - tips, axis=2) > TIP_M).all(axis=1)
    kept = np.flatnonzero((low > NARROWEST_M) & (faces | corner) & clear)
    cuts = []
    for run in np.split(kept, np.flatnonzero(np.diff(number[kept]) > 1) + 1):
        if len(run) > 1 and (faces[run] & (low[run] < reach_m)).any():
            # Beyond a neck the hollow widens: the cut goes on to where there is room.
            first, last = run[[0, -1]]
            while first > 0 and number[first - 1] == number[first] - 1 and low[first - 1] > low[first]:
                first -= 1
            while last + 1 < len(low) and number[last + 1] == number[last] + 1 and low[last + 1] > low[last]:
                last += 1
            cuts.append((centre[first : last + 1], min(0.5 * SLIT_M, 0.5 * float(low[run].min()))))
    return cuts


@dataclass(frozen=True, eq=False)
class Notch:
    """A small cut of ``NOTCH_DEPTH_M`` from ``point`` [m] (2,) on the cutting line along the unit vector ``inward``
    (2,)."""

    point: np.ndarray
    inward: np.ndarray


@dataclass(frozen=True, eq=False)
class Piece:
    """A panel ready to be cut, in the panel's own frame [m].

    ``sewing`` (N, 2) and ``cutting`` (M, 2) are closed polygons, the same without allowance; ``allowances_m`` [m] has
    one number for each edge; ``grain`` (2, 2) are the ends of a line along the warp; ``label`` lies inside the sewing
    line; ``seam_marks`` are places (2,) inside it, each with the number of the stitch there.
    """

    panel: Panel
    sewing: np.ndarray
    cutting: np.ndarray
    allowances_m: tuple[float, ...]
    notches: tuple[Notch, ...]
    grain: np.ndarray
    label: Label
    seam_marks: tuple[tuple[np.ndarray, str], ...]


@dataclass(frozen=True, eq=False)
class CuttingSheet:
    """A sheet of ``width_m`` by ``height_m`` [m] with its ``title`` and ``pieces``. ``offsets`` [m] (P, 2) are the
    origins of the panels' frames on it, from its lower left corner, y up."""

    title: str
    pieces: tuple[Piece, ...]
    offsets: np.ndarray
    width_m: float
    height_m: float


def make_sheet(pattern: Pattern, *, allowance_m: float = SEAM_M, hem_m: float | None = None) -> CuttingSheet:
    """Returns all pieces of ``pattern`` with ``allowance_m`` [m] around each, in rows no wider than the cloth where
    they fit.

    Hems have ``hem_m`` [m]: by default 25 mm, or the seams' allowance where that is more, and nothing without a seam
    allowance. Raises ``InputError`` for allowances outside 0 to 0.1 m.
    """
    if hem_m is None:
        hem_m = max(HEM_M, allowance_m) if allowance_m else 0.0
    for name, value in (("allowance_m", allowance_m), ("hem_m", hem_m)):
        if not 0.0 <= value < 0.1:
            raise InputError(name, expected="0 to 0.1 m", got=f"{value}", cure="Pass metres: 0.01 is 1 cm.")
    twins = mirror_words(pattern)
    pieces = [_piece(pattern, panel, allowance_m, hem_m, twins.get(panel.name, ())) for panel in pattern.panels]
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
    return CuttingSheet(pattern.name, tuple(pieces), offsets, used, height)


def is_fold(edge: Edge) -> bool:
    """Returns whether an open edge lies on the fold of the cloth, by its label: it is not cut."""
    return re.search(r"(?<![a-z])fold(?![a-z])", (edge.label or "").lower()) is not None


def hems(pattern: Pattern) -> set[EdgeRef]:
    """Returns the open edges that are turned up; the others, a neckline, an armhole or a waist, have a facing or a
    band.

    A label that says what an edge is decides. Otherwise it is turned up if it bends by less than ``HEM_BEND`` of its
    chord, and if it lies in the lower half of its panel, as placed, or stands upright like the cuff of a spread arm.
    """
    sewn = pattern.sewn
    edges = set()
    for ref in pattern.edge_refs():
        panel = pattern.panel(ref.panel)
        edge = panel.edges[ref.edge]
        if ref in sewn or is_fold(edge):
            continue
        label = (edge.label or "").lower()
        if any(word in label for word in ("neck", "waist", "collar", FACED)):
            continue
        if not any(word in label for word in ("hem", "cuff")):
            world = panel.placement.apply(panel.vertices)
            start, middle, end = panel.placement.apply(geometry.edge_points(panel, ref.edge, np.array([0.0, 0.5, 1.0])))
            upright = abs(end[1] - start[1]) > np.hypot(end[0] - start[0], end[2] - start[2])
            above = middle[1] > 0.5 * (world[:, 1].min() + world[:, 1].max())
            bend = np.abs(geometry.relative_curve(edge, np.linspace(0.0, 1.0, 9))[:, 1]).max()
            if bend > HEM_BEND or (above and not upright):
                continue
        edges.add(ref)
    return edges


def side_of(panel: Panel) -> str:
    """Returns "front", "back" or "side", by where the placed panel faces."""
    facing = float(panel.placement.matrix()[2, 2])
    return "front" if facing > FACING else "back" if facing < -FACING else "side"


def cut_count(panel: Panel) -> int:
    """Returns how many times a piece is cut: 2 for a band, as outside and facing, otherwise 1."""
    return 2 if any(FACED in (edge.label or "") for edge in panel.edges) else 1


def is_of_back(pattern: Pattern, ref: EdgeRef, other: EdgeRef) -> bool:
    """Returns whether of the panels of the edges ``ref`` and ``other``, which are sewn together, one is of the back and
    none of the front. Such a seam has two notches in its middle if it is longer than ``SHORTEST_BACK_M``."""
    sides = {side_of(pattern.panel(edge.panel)) for edge in (ref, other)}
    return "back" in sides and "front" not in sides


def mirror_words(pattern: Pattern) -> dict[str, tuple[str, ...]]:
    """Returns by a panel's name what else it is, as words: ("mirror of", NAME), ("same as", NAME) or ("symmetric",).
    Panels that are none of these are left out."""
    names = [panel.name for panel in pattern.panels]
    symmetries = find_symmetries(pattern, tolerance_m=MIRROR_M)
    words: dict[str, tuple[str, ...]] = {names[symmetry.first]: ("symmetric",) for symmetry in symmetries.within}
    for symmetry in symmetries.between:
        kind = "mirror of" if symmetry.kind is Kind.REFLECTION else "same as"
        words[names[symmetry.second]] = (kind, names[symmetry.first])
    return words


def _piece(pattern: Pattern, panel: Panel, allowance_m: float, hem_m: float, twin: tuple[str, ...]) -> Piece:
    sides = [geometry.flatten(panel, number, TOLERANCE_M)[:-1] for number in range(len(panel.edges))]
    sewing = np.concatenate(sides)
    turned_up = hems(pattern)
    legs, sewn = dart_legs(pattern, panel, TOLERANCE_M), pattern.sewn
    folds = {n for n, edge in enumerate(panel.edges) if EdgeRef(panel.name, n) not in sewn and is_fold(edge)}
    allowances = [hem_m if EdgeRef(panel.name, n) in turned_up else allowance_m for n in range(len(sides))]
    allowances = [0.0 if n in legs | folds else allowance for n, allowance in enumerate(allowances)]
    # A dart stays closed: the cutting line goes on across it.
    mouths = {n for n in legs if (n - 1) % len(sides) not in legs}
    lines = [side[:1] if n in mouths else side[: 0 if n in legs else None] for n, side in enumerate(sides)]
    far = [allowances[n - 1 if n in mouths else n] for n in range(len(sides))]
    cutting = offset(np.concatenate(lines) if legs else sewing, np.repeat(far, [len(line) for line in lines]))
    grain = _grain(sewing)
    marks, notches = [], []
    for number, stitch in enumerate(pattern.stitches):
        for ref, other in ((stitch.first, stitch.second), (stitch.second, stitch.first)):
            if ref.panel != panel.name:
                continue
            length = geometry.edge_length(panel, ref.edge)
            double = is_of_back(pattern, ref, other) and length > SHORTEST_BACK_M
            middle = 0.5 + 0.5 * BACK_GAP_M / length * np.array([-1.0, 1.0] if double else [0.0])
            share = np.array([0.5, *middle, 0.0, 1.0])
            points, inward = _inward(panel, ref, geometry.parameters_at(panel.edges[ref.edge], share))
            marks.append((points[0] + SEAM_MARK_M * inward[0], str(number + 1)))
            for point, direction in zip(points[1:], inward[1:], strict=True):
                notches.append(Notch(point - allowance_m * direction, direction))
    for first in mouths:
        last = next(n % len(sides) for n in range(first, first + len(sides)) if n % len(sides) not in legs)
        for n, end in (((first - 1) % len(sides), 1.0), (last, 0.0)):
            point, inward = _inward(panel, EdgeRef(panel.name, n), np.array([end]))
            notches.append(Notch(point[0] - allowances[n] * inward[0], inward[0]))
    kept: list[Notch] = []
    # In a hollow corner the foot of the perpendicular lies inside the piece, beside a hem outside of it.
    off_m = boundary_distance(np.array([notch.point for notch in notches]).reshape(-1, 2), cutting)
    for notch, off in zip(notches, off_m, strict=True):
        if off < 2e-4 and all(np.linalg.norm(notch.point - other.point) > NOTCH_GAP_M for other in kept):
            kept.append(notch)
    words = [pattern.name, panel.name, f"cut {cut_count(panel)}{' on the fold' if folds else ''}", *twin]
    words += [pattern.material] if pattern.material else []
    words.append(f"seam allowance {1000.0 * allowance_m:g} mm")
    if hem_m > allowance_m and hem_m in allowances:
        words.append(f"hem {1000.0 * hem_m:g} mm")
    return Piece(
        panel=panel,
        sewing=sewing,
        cutting=cutting,
        allowances_m=tuple(allowances),
        notches=tuple(kept),
        grain=grain,
        label=place_label(
            words, geometry.outline(panel, 1e-3), grain, np.array([point for point, _ in marks]).reshape(-1, 2)
        ),
        seam_marks=tuple(marks),
    )


def _inward(panel: Panel, ref: EdgeRef, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (T, 2) of an edge and unit normals (T, 2) towards the inside of its counter-clockwise panel."""
    tangents = geometry.edge_tangents(panel, ref.edge, t)
    return geometry.edge_points(panel, ref.edge, t), np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)


def offset(polygon: np.ndarray, distance_m: float | np.ndarray) -> np.ndarray:
    """Returns the counter-clockwise ``polygon`` [m] (N, 2) widened by ``distance_m`` [m] >= 0, corners mitred: a
    polygon [m] (M, 2).

    The distance is one for all sides, or one each (N,), that of the side from point n to the next. A corner meets where
    its two lines do; one that would stick out farther than ``MITRE_LIMIT`` times its distance is cut off.
    """
    if not np.any(distance_m):
        return polygon
    side = np.roll(polygon, -1, axis=0) - polygon
    length = np.linalg.norm(side, axis=1)
    polygon, side = polygon[length > UNIT_M], side[length > UNIT_M]
    far = np.broadcast_to(distance_m, length.shape)[length > UNIT_M]
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / length[length > UNIT_M][:, None]
    path: list[np.ndarray] = []
    for corner, n0, n1, d0, d1 in zip(polygon, np.roll(normal, 1, axis=0), normal, np.roll(far, 1), far, strict=True):
        path += _corner(corner, n0, n1, d0, d1)
    # Where the outline is hollow the lines cross themselves: what is wound once is the piece, and what is sewn.
    whole = [np.round(np.array(line) / UNIT_M).astype(np.int64).tolist() for line in (path, polygon)]
    parts = CLIPPER.SimplifyPolygons(whole, CLIPPER.PFT_POSITIVE)
    for middle, half_width in slits(polygon, float(far.max()), 1.1 * MITRE_LIMIT):
        knife, cut = CLIPPER.PyclipperOffset(), CLIPPER.Pyclipper()
        knife.AddPath(np.round(middle / UNIT_M).astype(np.int64).tolist(), CLIPPER.JT_MITER, CLIPPER.ET_OPENBUTT)
        cut.AddPaths(parts, CLIPPER.PT_SUBJECT, True)
        cut.AddPaths(knife.Execute(half_width / UNIT_M), CLIPPER.PT_CLIP, True)
        parts = cut.Execute(CLIPPER.CT_DIFFERENCE, CLIPPER.PFT_POSITIVE, CLIPPER.PFT_NONZERO)
    return np.array(max(parts, key=lambda part: abs(CLIPPER.Area(part)))) * UNIT_M


def _corner(corner: np.ndarray, n0: np.ndarray, n1: np.ndarray, d0: float, d1: float) -> list[np.ndarray]:
    """Where the lines at ``d0`` and ``d1`` [m] of both sides of a corner meet, or the two ends of its cut."""
    sine, cosine = n0[0] * n1[1] - n0[1] * n1[0], float(n0 @ n1)
    largest = max(d0, d1)
    if cosine > 0.0 and abs(sine) < 1e-6:
        ends = [corner + d0 * n0, corner + d1 * n1]
        return ends[:1] if d0 == d1 else ends
    # n0 . p = d0 and n1 . p = d1.
    point = np.array([d0 * n1[1] - d1 * n0[1], d1 * n0[0] - d0 * n1[0]]) / (sine if abs(sine) > 1e-12 else 1e-12)
    if cosine > 0.0 and np.linalg.norm(point) > MITRE_LIMIT * largest:
        return [corner + d0 * n0, corner + d1 * n1]
    if np.linalg.norm(point) <= MITRE_LIMIT * largest:
        return [corner + point]
    if sine < 0.0:  # hollow: the lines go round the corner, and cross themselves
        return [corner + d0 * n0, corner, corner + d1 * n1]
    along0, along1 = np.array([-n0[1], n0[0]]), np.array([n1[1], -n1[0]])
    return [corner + d0 * n0 + d0 * along0, corner + d1 * n1 + d1 * along1]


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
