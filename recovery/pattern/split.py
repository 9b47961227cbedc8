"""Panels cut along new lines that are sewn again, and panels joined along a seam: the sewn garment stays as it is.

A line runs through one panel from outline to outline, and becomes an edge of both parts: one curve with the same
points, so that their lengths agree. Edges are divided exactly, by de Casteljau's construction. Where a divided edge is
sewn, its partner is divided at the same share of its length. All parts stay in their panel's frame and place.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.drafting import root
from recovery.pattern.geometry import inside
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, Pattern, Stitch

SAME = 1e-7  # places nearer than this share of an edge's length are one
LEFT_M = 2e-3  # least length that a strip leaves of the edges beside it
SAMPLES, FITS = 33, 6  # points of a curve that a parallel one follows, and times that their places on it are found
JOIN_M = 5e-4  # largest distance of edges that become one line of a joined panel


@dataclass(frozen=True, eq=False)
class Curve:
    """An edge of the kind ``kind`` by its ``points`` [m] (2 + H, 2) in the panel's frame: start, inner Bezier points or
    an arc's highest point, end."""

    kind: EdgeKind
    points: np.ndarray
    label: str | None = None

    def edge(self, start: int, end: int) -> Edge:
        """Returns the curve as an edge from corner ``start`` to corner ``end``."""
        handles = geometry.on_chord(self.points[1:-1], self.points[0], self.points[-1])
        if self.kind is EdgeKind.CIRCLE:
            handles = ((0.5, handles[0][1]),)
        return Edge(start, end, self.kind, handles, self.label)

    def at(self, t: np.ndarray) -> np.ndarray:
        """Returns points [m] (T, 2) of the curve at parameters ``t`` (T,) in [0, 1]."""
        start, end = self.points[0], self.points[-1]
        return geometry.off_chord(geometry.relative_curve(self.edge(0, 1), t), start, end - start)

    def slope(self, t: np.ndarray) -> np.ndarray:
        """Returns the derivative [m] (T, 2) of ``at`` by t."""
        return geometry.off_chord(
            geometry.relative_slope(self.edge(0, 1), t), np.zeros(2), self.points[-1] - self.points[0]
        )

    def crosses(self, y_m: float, low: float, high: float) -> float:
        """Returns the parameter between ``low`` and ``high`` at which the curve passes the height ``y_m`` [m]; at these
        two it lies on different sides of it."""
        return root(lambda t: self.at(np.array([t]))[0, 1] - y_m, low, high)

    def reversed(self) -> Curve:
        """Returns the same curve from its end to its start."""
        return replace(self, points=self.points[::-1])

    def cut(self, t: float) -> tuple[Curve, Curve]:
        """Returns the part of the curve up to the parameter ``t``, and the rest of it."""
        if self.kind is EdgeKind.CIRCLE:
            places = self.at(np.array([0.5 * t, t, 0.5 + 0.5 * t]))
            low = np.array([self.points[0], places[0], places[1]])
            return replace(self, points=low), replace(self, points=np.array([*places[1:], self.points[-1]]))
        low, high, row = [], [], self.points
        while len(row):
            low.append(row[0])
            high.append(row[-1])
            row = (1.0 - t) * row[:-1] + t * row[1:]
        return replace(self, points=np.array(low)), replace(self, points=np.array(high[::-1]))


def curves(panel: Panel) -> list[Curve]:
    """Returns the outline of ``panel`` as curves, edge by edge."""
    return [Curve(edge.kind, geometry.edge_controls(panel, n), edge.label) for n, edge in enumerate(panel.edges)]


def panel_of(like: Panel, name: str, outline: Sequence[Curve]) -> Panel:
    """Returns the panel ``like`` called ``name`` and with another ``outline``, in which each curve begins where the one
    before ends."""
    count = len(outline)
    corners = np.array([curve.points[0] for curve in outline])
    return replace(
        like, name=name, vertices=corners, edges=tuple(c.edge(n, (n + 1) % count) for n, c in enumerate(outline))
    )


def partners(pattern: Pattern) -> dict[EdgeRef, Stitch]:
    """Returns the stitch of every sewn edge, with its sides exchanged where needed so that this edge is its first."""
    turned = [replace(stitch, first=stitch.second, second=stitch.first) for stitch in pattern.stitches]
    return {stitch.first: stitch for stitch in (*pattern.stitches, *turned)}


def seam_length(pattern: Pattern, ref: EdgeRef, sewn: Mapping[EdgeRef, Stitch]) -> float:
    """Returns the length [m] of the edge ``ref``, or if it is ``sewn`` the mean length of both edges of its seam."""
    refs = [ref, sewn[ref].second] if ref in sewn else [ref]
    return float(np.mean([geometry.edge_length(pattern.panel(side.panel), side.edge) for side in refs]))


def divide_edges(
    pattern: Pattern, places: Mapping[EdgeRef, Sequence[float]]
) -> tuple[Pattern, dict[EdgeRef, list[EdgeRef]]]:
    """Returns ``pattern`` with new corners at ``places``, shares of the lengths of edges in [0, 1], and for each old
    edge the edges that it is divided into, in order.

    Partners of sewn edges are divided at the same shares, and a seam becomes as many seams.
    """
    sewn = partners(pattern)
    wanted: dict[EdgeRef, list[float]] = defaultdict(list)
    for ref, shares in places.items():
        wanted[ref] += shares
        if ref in sewn:
            stitch = sewn[ref]
            wanted[stitch.second] += [share if stitch.right_to_wrong else 1.0 - share for share in shares]
    panels, pieces = [], {}
    for panel in pattern.panels:
        outline = []
        for number, curve in enumerate(curves(panel)):
            ref = EdgeRef(panel.name, number)
            parts = _divided(curve, _apart(wanted[ref]))
            pieces[ref] = [EdgeRef(panel.name, len(outline) + n) for n in range(len(parts))]
            outline += parts
        panels.append(panel_of(panel, panel.name, outline))
    stitches = []
    for stitch in pattern.stitches:
        second = pieces[stitch.second]
        pairs = zip(pieces[stitch.first], second if stitch.right_to_wrong else second[::-1], strict=True)
        stitches += [replace(stitch, first=a, second=b) for a, b in pairs]
    return replace(pattern, panels=tuple(panels), stitches=tuple(stitches), template={}), pieces


def _apart(shares: Sequence[float]) -> list[float]:
    """``shares`` in order, each once, without those at the ends."""
    apart: list[float] = []
    for share in sorted(shares):
        if SAME < share < 1.0 - SAME and (not apart or share - apart[-1] > SAME):
            apart.append(share)
    return apart


def _divided(curve: Curve, shares: Sequence[float]) -> list[Curve]:
    parts, before = [], 0.0
    for t in geometry.parameters_at(curve.edge(0, 1), np.array(shares)).tolist() if shares else []:
        low, curve = curve.cut((t - before) / (1.0 - before))
        parts.append(low)
        before = t
    return [*parts, curve]


def part_panel(
    pattern: Pattern, name: str, ends: tuple[int, int], line: Sequence[Curve], called: str
) -> tuple[Pattern, Callable[[EdgeRef], EdgeRef]]:
    """Returns ``pattern`` with the panel ``name`` cut in two along ``line`` and sewn there again, and a function from
    an old edge to what that edge is now.

    ``ends`` are edges: those from the first up to the second become the panel ``called``, which stands after the rest.
    ``line`` runs from the start of the second end to the start of the first. Raises ``InputError`` for a line that
    leaves the panel.
    """
    panel, (first, last) = pattern.panel(name), ends
    outline = curves(panel)
    count = len(outline)
    edges = [(first + n) % count for n in range((last - first) % count)]
    left = [(last + n) % count for n in range((first - last) % count)]
    parts = [
        panel_of(panel, called, [*(outline[n] for n in edges), *line]),
        panel_of(panel, name, [*(outline[n] for n in left), *(curve.reversed() for curve in line[::-1])]),
    ]
    middles = np.concatenate([curve.at(np.linspace(0.0, 1.0, SAMPLES + 2)[1:-1]) for curve in line])
    crossing = any(geometry.first_crossing(geometry.outline(part)) is not None for part in parts)
    if crossing or not inside(middles, geometry.outline(panel)).all():
        raise InputError(
            called,
            expected=f"a line inside the panel {name}",
            got="one that leaves it",
            cure="Take a smaller width, or another panel.",
        )
    moved = {EdgeRef(name, old): EdgeRef(called, new) for new, old in enumerate(edges)}
    moved |= {EdgeRef(name, old): EdgeRef(name, new) for new, old in enumerate(left)}

    def now(ref: EdgeRef) -> EdgeRef:
        return moved.get(ref, ref)

    sewn = [replace(stitch, first=now(stitch.first), second=now(stitch.second)) for stitch in pattern.stitches]
    for n in range(len(line)):
        sewn.append(Stitch(EdgeRef(called, len(edges) + n), EdgeRef(name, len(left) + len(line) - 1 - n)))
    place = [other.name for other in pattern.panels].index(name)
    panels = [*pattern.panels[:place], parts[1], parts[0], *pattern.panels[place + 1 :]]
    order = None if pattern.panel_order is None else (*pattern.panel_order, called)
    return replace(pattern, panels=tuple(panels), stitches=tuple(sewn), panel_order=order, template={}), now


# --- strips beside edges ---------------------------------------------------------------------------------------------


class Chain(NamedTuple):
    """Edges ``refs`` of one panel, in the order of its outline, along which a strip is cut off. The strip becomes the
    panel ``called``."""

    refs: tuple[EdgeRef, ...]
    called: str


def strips(pattern: Pattern, chains: Sequence[Chain], width_m: float) -> Pattern:
    """Returns ``pattern`` with a strip of ``width_m`` [m] cut off along every one of ``chains`` and sewn on again.

    The width is measured along the edges beside a chain, which may be seams: so strips of neighbouring panels meet.
    Raises ``InputError`` where such an edge is too short, or the line would leave its panel.
    """
    sewn = partners(pattern)
    places: dict[EdgeRef, list[float]] = defaultdict(list)
    for chain in chains:
        before, after = edges_beside(pattern, chain)
        for ref, from_start in ((before, False), (after, True)):
            length = seam_length(pattern, ref, sewn)
            if not 0.0 < width_m <= length - LEFT_M:
                raise InputError(
                    chain.called,
                    expected=f"a width of up to {length - LEFT_M:.3f} m, since {ref} beside it is {length:.3f} m long",
                    got=f"{width_m:g} m",
                    cure="Take a smaller width.",
                )
            places[ref].append(width_m / length if from_start else 1.0 - width_m / length)
    borders = [edges_beside(pattern, chain) for chain in chains]
    pattern, pieces = divide_edges(pattern, places)
    cuts: list[list[EdgeRef]] = []
    for chain, (before, after) in zip(chains, borders, strict=True):
        inner = [piece for ref in chain.refs for piece in pieces[ref]]
        cuts.append([pieces[before][-1], *inner, pieces[after][0]])
    for number, chain in enumerate(chains):
        refs = cuts[number]
        name, outline = refs[0].panel, curves(pattern.panel(refs[0].panel))
        ends = refs[0].edge, (refs[-1].edge + 1) % len(outline)
        line = parallel(
            [outline[ref.edge] for ref in refs[1:-1]], width_m, outline[ends[0]].points[0], outline[ends[1]].points[0]
        )
        pattern, now = part_panel(pattern, name, ends, [curve.reversed() for curve in line[::-1]], chain.called)
        cuts = [[now(ref) for ref in refs] for refs in cuts]
    return pattern


def edges_beside(pattern: Pattern, chain: Chain) -> tuple[EdgeRef, EdgeRef]:
    """Returns the edges of the panel before and after ``chain``."""
    name, count = chain.refs[0].panel, len(pattern.panel(chain.refs[0].panel).edges)
    return EdgeRef(name, (chain.refs[0].edge - 1) % count), EdgeRef(name, (chain.refs[-1].edge + 1) % count)


def parallel(chain: Sequence[Curve], width_m: float, start: np.ndarray, end: np.ndarray) -> list[Curve]:
    """Returns curves ``width_m`` [m] to the left of those of ``chain``, one for each, from ``start`` to ``end`` [m]
    (2,).

    Where an end lies at another distance, as on sides that lean, the distance changes evenly along the first or last
    curve. Lines stay lines; other curves become cubic ones, fitted by least squares.
    """
    t = np.linspace(0.0, 1.0, SAMPLES)
    normals = []
    for curve in chain:
        slope = curve.slope(t)
        normals.append(np.stack([-slope[:, 1], slope[:, 0]], axis=1) / np.linalg.norm(slope, axis=1, keepdims=True))
    corners = [start]
    for curve, before, after in zip(chain[1:], normals[:-1], normals[1:], strict=True):
        a, b = before[-1], after[0]
        corners.append(curve.points[0] + width_m * (a + b) / (1.0 + float(a @ b)))
    corners.append(end)
    offsets = []
    for curve, normal, low, high in zip(chain, normals, corners[:-1], corners[1:], strict=True):
        if curve.kind is EdgeKind.LINE:
            offsets.append(Curve(EdgeKind.LINE, np.array([low, high])))
            continue
        points = curve.at(t) + width_m * normal
        points += np.outer(1.0 - t, low - points[0]) + np.outer(t, high - points[-1])
        offsets.append(Curve(EdgeKind.CUBIC, fit_curve(points)))
    return offsets


def fit_curve(points: np.ndarray) -> np.ndarray:
    """Returns the Bezier points [m] (4, 2) of the cubic curve nearest to ``points`` [m] (N, 2), from the first to the
    last of them.

    At first the points are taken to lie evenly in the curve's parameter. Then the points' parameters and the curve's
    handles are corrected in turn. The handles are moved by distances across the curve alone (Gauss and Newton's steps).
    """
    t = np.linspace(0.0, 1.0, len(points))
    ends = points[[0, -1]]
    weights = geometry.bernstein(EdgeKind.CUBIC, t)
    handles = np.linalg.lstsq(weights[:, 1:3], points - weights[:, [0, 3]] @ ends, rcond=None)[0]
    for _ in range(FITS):
        curve = Curve(EdgeKind.CUBIC, np.array([ends[0], *handles, ends[1]]))
        slope = curve.slope(t)
        t = np.clip(t + ((points - curve.at(t)) * slope).sum(axis=1) / (slope**2).sum(axis=1), 0.0, 1.0)
        slope = curve.slope(t)
        normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1) / np.linalg.norm(slope, axis=1, keepdims=True)
        weights = geometry.bernstein(EdgeKind.CUBIC, t)
        rows = (weights[:, 1:3, None] * normal[:, None]).reshape(-1, 4)
        far = ((points - curve.at(t)) * normal).sum(axis=1)
        handles = handles + np.linalg.lstsq(rows, far, rcond=1e-9)[0].reshape(2, 2)
    return np.array([ends[0], *handles, ends[1]])


# --- a level line, and joined panels ---------------------------------------------------------------------------------


def cut_level(pattern: Pattern, name: str, y_m: float, called: str) -> Pattern:
    """Returns ``pattern`` with the panel ``name`` cut across its grain at the height ``y_m`` [m] of its own frame and
    sewn there again; the upper part is ``called``.

    Raises ``InputError`` unless the line crosses the outline twice.
    """
    places: list[tuple[EdgeRef, float]] = []
    downward = []
    for number, curve in enumerate(curves(pattern.panel(name))):
        t = np.linspace(0.0, 1.0, 8 * SAMPLES)
        above = curve.at(t)[:, 1] > y_m
        for k in np.flatnonzero(above[1:] != above[:-1]).tolist():
            edge, there = curve.edge(0, 1), curve.crosses(y_m, t[k], t[k + 1])
            share = float(geometry.arc_lengths(edge, np.array([there]))[0]) / geometry.relative_length(edge)
            places.append((EdgeRef(name, number), share))
            downward.append(bool(above[k]))
    if len(places) != 2 or places[0][0] == places[1][0]:
        raise InputError(
            called,
            expected=f"a level line that crosses two edges of {name}",
            got=f"{len(places)} crossings at {y_m:.3f} m",
            cure="Take another depth.",
        )
    pattern, pieces = divide_edges(pattern, {ref: [share] for ref, share in places})
    upper, lower = (places[downward.index(way)][0] for way in (False, True))
    ends = pieces[upper][-1].edge, pieces[lower][-1].edge
    outline = curves(pattern.panel(name))
    line = Curve(EdgeKind.LINE, np.array([outline[ends[1]].points[0], outline[ends[0]].points[0]]))
    return part_panel(pattern, name, ends, [line], called)[0]


def join_panels(pattern: Pattern, number: int, called: str) -> Pattern:
    """Returns ``pattern`` with the two panels of stitch ``number`` as one panel ``called``, in the frame and place of
    the first.

    Raises ``InputError`` where their edges do not lie on each other within ``JOIN_M``.
    """
    stitch = pattern.stitches[number]
    first, second = (pattern.panel(ref.panel) for ref in (stitch.first, stitch.second))
    outline, other = curves(first), curves(second)
    moved, apart = lay_edge_on(outline[stitch.first.edge], other[stitch.second.edge].reversed())
    if stitch.right_to_wrong or first is second or apart > JOIN_M:
        raise InputError(
            called,
            expected="two panels whose edges lie on each other, right side beside right side",
            got=f"{stitch.first} and {stitch.second}, {1e3 * apart:.1f} mm apart",
            cure="Leave them two panels.",
        )
    a, b = stitch.first.edge, stitch.second.edge
    left = [(a + 1 + n) % len(outline) for n in range(len(outline) - 1)]
    right = [(b + 1 + n) % len(other) for n in range(len(other) - 1)]
    whole = [outline[n] for n in left] + [replace(other[n], points=moved(other[n].points)) for n in right]
    panel = panel_of(first, called, whole)
    where = {EdgeRef(first.name, old): EdgeRef(called, new) for new, old in enumerate(left)}
    where |= {EdgeRef(second.name, old): EdgeRef(called, len(left) + new) for new, old in enumerate(right)}
    sewn = [
        replace(other, first=where.get(other.first, other.first), second=where.get(other.second, other.second))
        for other in pattern.stitches
        if other is not stitch
    ]
    panels = [panel if old is first else old for old in pattern.panels if old is not second]
    return replace(pattern, panels=tuple(panels), stitches=tuple(sewn), panel_order=None, template={})


def lay_edge_on(edge: Curve, other: Curve) -> tuple[Callable[[np.ndarray], np.ndarray], float]:
    """Returns the rigid motion of points [m] (N, 2) that lays the edge ``other`` on ``edge``, chord on chord, and how
    far [m] the two are apart then, at most."""
    chords = [complex(*(curve.points[-1] - curve.points[0])) for curve in (edge, other)]
    turn = chords[0] / chords[1] / abs(chords[0] / chords[1])
    rotation = np.array([[turn.real, turn.imag], [-turn.imag, turn.real]])
    middle = [0.5 * (curve.points[0] + curve.points[-1]) for curve in (edge, other)]

    def moved(points: np.ndarray) -> np.ndarray:
        return (points - middle[1]) @ rotation + middle[0]

    shares = np.linspace(0.0, 1.0, SAMPLES)
    lines = [curve.at(geometry.parameters_at(curve.edge(0, 1), shares)) for curve in (edge, other)]
    return moved, float(np.linalg.norm(lines[0] - moved(lines[1]), axis=1).max())
