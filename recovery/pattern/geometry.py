"""Curves, lengths and areas of panels, and checks that a pattern can be cut and sewn.

An edge's curve is kept relative to its chord: a point (a, b) lies at start + a d + b (d turned left), d the chord.
Shape and arc length per chord then do not change when the chord moves.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from drape.garment.sewing import line_distance
from recovery.pattern.sewing_pattern import Edge, EdgeKind, Panel, Pattern, Stitch

QUADRATURE_NODES, PIECES = 64, 8
TOUCH_M = 1e-9  # segments nearer than this meet
SMALLEST_PANEL_M, LARGEST_PANEL_M = 0.005, 5.0  # limits of the longer side of a panel's box
SMALLEST_GARMENT_M = 0.05  # least longer side of the largest panel's box


class SeamLine(NamedTuple):
    """A ``stitch``, the lengths ``first_m`` and ``second_m`` [m] of its edges, and ``mismatch``, the second less the
    first over their mean."""

    stitch: Stitch
    first_m: float
    second_m: float
    mismatch: float


# --- one edge, relative to its chord ---------------------------------------------------------------------------------


def relative_curve(edge: Edge, t: np.ndarray) -> np.ndarray:
    """Returns points (T, 2) of the curve of ``edge`` at parameters ``t`` (T,) in [0, 1], as (along, left) shares of its
    chord."""
    t = np.asarray(t, dtype=np.float64)
    if edge.kind is EdgeKind.CIRCLE:
        half = 2.0 * np.arctan(2.0 * edge.handles[0][1])  # half of the arc's angle, signed
        angle = half * (2.0 * t - 1.0)
        left = np.sin(0.5 * (half + angle)) * np.sin(0.5 * (half - angle)) / np.sin(half)
        return np.stack([0.5 + 0.5 * np.sin(angle) / np.sin(half), left], axis=1)
    return bernstein(edge.kind, t) @ np.array([(0.0, 0.0), *edge.handles, (1.0, 0.0)])


def bernstein(kind: EdgeKind, t: np.ndarray) -> np.ndarray:
    """Returns weights (T, 2 + H) of start, H handles and end of a Bezier edge at parameters ``t`` (T,) in [0, 1]."""
    s = 1.0 - t
    if kind is EdgeKind.LINE:
        return np.stack([s, t], axis=1)
    if kind is EdgeKind.QUADRATIC:
        return np.stack([s * s, 2.0 * s * t, t * t], axis=1)
    return np.stack([s**3, 3.0 * s * s * t, 3.0 * s * t * t, t**3], axis=1)


def relative_slope(edge: Edge, t: np.ndarray) -> np.ndarray:
    """Returns the derivative (T, 2) of ``relative_curve`` by t."""
    t = np.asarray(t, dtype=np.float64)
    if edge.kind is EdgeKind.CIRCLE:
        half = 2.0 * np.arctan(2.0 * edge.handles[0][1])
        angle = half * (2.0 * t - 1.0)
        return np.stack([np.cos(angle), -np.sin(angle)], axis=1) * (half / np.sin(half))
    steps = np.diff(np.array([(0.0, 0.0), *edge.handles, (1.0, 0.0)]), axis=0)
    lower = {EdgeKind.QUADRATIC: EdgeKind.LINE, EdgeKind.CUBIC: EdgeKind.QUADRATIC}
    if edge.kind is EdgeKind.LINE:
        return np.broadcast_to(steps, (len(t), 2))
    return len(steps) * bernstein(lower[edge.kind], t) @ steps


@lru_cache(maxsize=4096)
def relative_length(edge: Edge) -> float:
    """Returns the length of ``edge`` over that of its chord: 1 for a line."""
    if edge.kind is EdgeKind.LINE:
        return 1.0
    if edge.kind is EdgeKind.CIRCLE:
        half = 2.0 * np.arctan(2.0 * edge.handles[0][1])
        return float(half / np.sin(half))
    return float(arc_lengths(edge, np.array([1.0]))[0])


def arc_lengths(edge: Edge, t: np.ndarray) -> np.ndarray:
    """Returns arc lengths (T,) from the start of ``edge`` to the parameters ``t`` (T,), over the length of its chord,
    by Gauss's rule on eight pieces."""
    nodes, weights = _gauss()
    pieces, before = np.linspace(0.0, 1.0, PIECES + 1), _lengths_before(edge)
    place = np.clip(np.searchsorted(pieces, t, side="right") - 1, 0, PIECES - 1)
    low = pieces[place]
    at = low[:, None] + (t - low)[:, None] * nodes
    speed = np.hypot(*relative_slope(edge, at.reshape(-1)).T).reshape(at.shape)
    return before[place] + (speed @ weights) * (t - low)


@lru_cache(maxsize=4096)
def _lengths_before(edge: Edge) -> np.ndarray:
    """Arc length per chord (PIECES + 1,) from the start to where each piece begins, and to the end."""
    nodes, weights = _gauss()
    ends = pairwise(np.linspace(0.0, 1.0, PIECES + 1).tolist())
    whole = [(np.hypot(*relative_slope(edge, a + (b - a) * nodes).T) @ weights) * (b - a) for a, b in ends]
    return np.concatenate([[0.0], np.cumsum(whole)])


@lru_cache(maxsize=1)
def _gauss() -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_NODES)
    return 0.5 * (nodes + 1.0), 0.5 * weights


@lru_cache(maxsize=4096)
def equal_parameters(edge: Edge, segments: int) -> np.ndarray:
    """Returns the parameters (segments + 1,) that cut ``edge`` into parts of equal arc length, from 0 to 1. The array
    is shared and not writeable."""
    parameters = parameters_at(edge, np.linspace(0.0, 1.0, segments + 1))
    parameters.flags.writeable = False  # all callers share it
    return parameters


def parameters_at(edge: Edge, share: np.ndarray) -> np.ndarray:
    """Returns the parameters (T,) at the shares ``share`` (T,) in [0, 1] of the arc length of ``edge`` from its start;
    0 and 1 are exact."""
    share = np.asarray(share, dtype=np.float64)
    if edge.kind in (EdgeKind.LINE, EdgeKind.CIRCLE):
        return share.copy()
    total = relative_length(edge)
    low, high = np.zeros(len(share)), np.ones(len(share))
    for _ in range(50):  # bisection: also right where the speed vanishes
        middle = 0.5 * (low + high)
        short = arc_lengths(edge, middle) < share * total
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.where(share <= 0.0, 0.0, np.where(share >= 1.0, 1.0, 0.5 * (low + high)))


# --- edges and outlines of a panel -----------------------------------------------------------------------------------


def chord(panel: Panel, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the start [m] (2,) of edge ``number`` in the panel's frame, and its chord [m] (2,), from there to its
    end."""
    edge = panel.edges[number]
    return panel.vertices[edge.start], panel.vertices[edge.end] - panel.vertices[edge.start]


def off_chord(relative: np.ndarray, start: np.ndarray, chord: np.ndarray) -> np.ndarray:
    """Returns points [m] (N, 2) for the (along, left) shares ``relative`` (N, 2) of the ``chord`` [m] (2,) that begins
    at ``start`` [m] (2,)."""
    return start + relative[:, :1] * chord + relative[:, 1:] * np.array([-chord[1], chord[0]])


def on_chord(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[tuple[float, float], ...]:
    """Returns the (along, left) shares of ``points`` [m] (N, 2) by the chord from ``start`` to ``end`` [m] (2,)."""
    chord, arm = end - start, points - start
    along, left = arm @ chord, arm @ np.array([-chord[1], chord[0]])
    squared = max(float(chord @ chord), 1e-300)
    return tuple(zip((along / squared).tolist(), (left / squared).tolist(), strict=True))


def edge_points(panel: Panel, number: int, t: np.ndarray) -> np.ndarray:
    """Returns points [m] (T, 2) of edge ``number``, in the panel's frame, at parameters ``t`` (T,) in [0, 1]."""
    return off_chord(relative_curve(panel.edges[number], t), *chord(panel, number))


def edge_controls(panel: Panel, number: int) -> np.ndarray:
    """Returns start, H handles and end [m] (2 + H, 2) of edge ``number``, in the panel's frame."""
    relative = np.array([(0.0, 0.0), *panel.edges[number].handles, (1.0, 0.0)])
    return off_chord(relative, *chord(panel, number))


def edge_tangents(panel: Panel, number: int, t: np.ndarray) -> np.ndarray:
    """Returns unit tangents (T, 2) of edge ``number`` at parameters ``t`` (T,); the direction of the chord where the
    slope vanishes."""
    _, along = chord(panel, number)
    slope = relative_slope(panel.edges[number], t)
    tangents = slope[:, :1] * along + slope[:, 1:] * np.array([-along[1], along[0]])
    length = np.linalg.norm(tangents, axis=1, keepdims=True)
    straight = along / np.linalg.norm(along)
    return np.where(length > 1e-9 * np.linalg.norm(along), tangents / np.maximum(length, 1e-300), straight)


def edge_length(panel: Panel, number: int) -> float:
    """Returns the arc length [m] of edge ``number``."""
    return float(np.linalg.norm(chord(panel, number)[1])) * relative_length(panel.edges[number])


def flatten(panel: Panel, number: int, tolerance_m: float) -> np.ndarray:
    """Returns points [m] (N, 2) on edge ``number``, in the panel's frame, from its start to its end, between which
    straight segments leave the curve by at most ``tolerance_m`` [m]."""
    edge = panel.edges[number]
    if edge.kind is EdgeKind.LINE:
        return edge_points(panel, number, np.array([0.0, 1.0]))
    samples = edge_points(panel, number, np.linspace(0.0, 1.0, 65))
    bend = np.linalg.norm(np.diff(samples, n=2, axis=0), axis=1).max() * 64.0**2  # largest second derivative
    segments = max(2, int(np.ceil(np.sqrt(1.1 * bend / (8.0 * tolerance_m)))))
    return edge_points(panel, number, np.linspace(0.0, 1.0, segments + 1))


def outline(panel: Panel, tolerance_m: float = 1e-4) -> np.ndarray:
    """Returns the outline of ``panel`` as a closed polygon [m] (N, 2) in its frame, within ``tolerance_m`` [m]; the
    first point is not repeated."""
    return np.concatenate([flatten(panel, number, tolerance_m)[:-1] for number in range(len(panel.edges))])


def area(panel: Panel) -> float:
    """Returns the area [m^2] inside the curved outline of ``panel``; negative where it runs clockwise."""
    nodes, weights = _gauss()
    total = 0.0
    for number, edge in enumerate(panel.edges):
        start, along = chord(panel, number)
        x, y = relative_curve(edge, nodes).T
        dx, dy = relative_slope(edge, nodes).T
        total += 0.5 * (start[0] * along[1] - start[1] * along[0])  # under the chord
        total += 0.5 * float((x * dy - y * dx) @ weights) * float(along @ along)  # between chord and curve
    return float(total)


def seams(pattern: Pattern) -> list[SeamLine]:
    """Returns a ``SeamLine`` for each stitch of ``pattern``, in order."""
    result = []
    for stitch in pattern.stitches:
        first, second = (edge_length(pattern.panel(ref.panel), ref.edge) for ref in (stitch.first, stitch.second))
        result.append(SeamLine(stitch, first, second, 2.0 * (second - first) / (first + second)))
    return result


def stitch_ends(pattern: Pattern, stitch: Stitch, *, reverse: bool = False) -> np.ndarray:
    """Returns the distances [m] (2,) in the world between the corners that ``stitch`` joins at each of its ends, panels
    as placed. With ``reverse`` it is sewn the other way round."""
    ends = []
    for ref in (stitch.first, stitch.second):
        panel = pattern.panel(ref.panel)
        edge = panel.edges[ref.edge]
        ends.append(panel.placement.apply(panel.vertices[[edge.start, edge.end]]))
    turned = ends[1] if stitch.right_to_wrong != reverse else ends[1][::-1]
    return np.linalg.norm(ends[0] - turned, axis=1)


# --- checks ----------------------------------------------------------------------------------------------------------


def first_crossing(polygon: np.ndarray) -> np.ndarray | None:
    """Returns a point [m] (2,) where the closed ``polygon`` [m] (N, 2) meets itself, or None. Neighbouring sides may
    share their end."""
    start, end = polygon, np.roll(polygon, -1, axis=0)
    count = len(polygon)
    low, high = np.minimum(start, end) - TOUCH_M, np.maximum(start, end) + TOUCH_M
    i, j = np.triu_indices(count, k=1)
    near = ((low[i] <= high[j]) & (low[j] <= high[i])).all(axis=1)
    i, j = i[near], j[near]
    apart = np.minimum(j - i, count - (j - i))
    d = end - start
    # Neighbours share an end; they cross only where one folds back onto the other.
    at_corner = np.where(j - i == 1, j, i)  # the corner between neighbours
    before = np.where(j - i == 1, i, j)
    turn = _cross(d[before], d[at_corner])
    scale = np.linalg.norm(d[before], axis=1) * np.linalg.norm(d[at_corner], axis=1)
    folded = (apart == 1) & (np.abs(turn) <= 1e-12 * scale) & ((d[before] * d[at_corner]).sum(axis=1) < 0.0)
    if folded.any():
        return start[at_corner[folded][0]]
    i, j = i[apart > 1], j[apart > 1]
    gap, place = _segment_distance(start[i], d[i], start[j], d[j])
    return place[gap.argmin()] if len(gap) and gap.min() <= TOUCH_M else None


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _segment_distance(p: np.ndarray, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances (K,) of segments p + [0, 1] u and q + [0, 1] v, and a point (K, 2) where they are least."""
    det = _cross(u, v)
    safe = np.where(det == 0.0, 1.0, det)
    s, t = _cross(q - p, v) / safe, _cross(q - p, u) / safe
    crossing = (det != 0.0) & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    distance, place = np.where(crossing, 0.0, np.inf), p + s[:, None] * u
    for point, base, along in ((p, q, v), (p + u, q, v), (q, p, u), (q + v, p, u)):
        share = np.clip(
            ((point - base) * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-300), 0.0, 1.0
        )
        nearest = base + share[:, None] * along
        gap = np.linalg.norm(point - nearest, axis=1)
        closer = gap < distance
        distance = np.where(closer, gap, distance)
        place = np.where(closer[:, None], nearest, place)
    return distance, place


def check_pattern(pattern: Pattern) -> None:
    """Raises ``InputError`` for panels that run clockwise, cross themselves, or have sizes that no garment has."""
    largest = 0.0
    for panel in pattern.panels:
        polygon = outline(panel)
        size = float(np.ptp(polygon, axis=0).max())
        largest = max(largest, size)
        if not SMALLEST_PANEL_M <= size <= LARGEST_PANEL_M:
            _refuse_size(f"panel {panel.name}", f"{SMALLEST_PANEL_M} to {LARGEST_PANEL_M} m", size)
        if (place := first_crossing(polygon)) is not None:
            raise InputError(
                f"panel {panel.name}",
                expected="an outline that does not cross itself",
                got=f"edges that meet at ({place[0]:.4f}, {place[1]:.4f}) m",
                cure="Move the corners or flatten the curves around that point.",
            )
        if area(panel) <= 0.0:
            raise InputError(
                f"panel {panel.name}",
                expected="a counter-clockwise outline, the right side of the cloth up",
                got=f"a clockwise one of area {area(panel):.6f} m^2",
                cure="Mirror the panel (garmentcode.mirror_panel) or reverse its edges.",
            )
    if largest < SMALLEST_GARMENT_M:
        _refuse_size("pattern", f"a panel of at least {SMALLEST_GARMENT_M} m", largest)


def _refuse_size(name: str, expected: str, size: float) -> None:
    raise InputError(
        name,
        expected=f"lengths in metres, {expected}",
        got=f"{size:.4g} m",
        cure="Check the unit: units_in_meter is 100 for centimetres, 1000 for millimetres.",
    )


def inside(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Returns which of ``points`` (N, 2) lie inside the closed ``polygon`` (M, 2), bool (N,), by counting crossings."""
    within = np.zeros(len(points), dtype=bool)
    x, y = points.T
    for (ax, ay), (bx, by) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if ay != by:
            crossing = ((ay > y) != (by > y)) & (x < ax + (y - ay) * ((bx - ax) / (by - ay)))
            within ^= crossing
    return within


def boundary_distance(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Returns the distances [m] (N,) of ``points`` [m] (N, 2) from the sides of the closed ``polygon`` [m] (M, 2)."""
    return line_distance(points, np.concatenate([polygon, polygon[:1]]))
