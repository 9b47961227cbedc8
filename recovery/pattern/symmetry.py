"""Symmetries of a pattern (algorithm 1 of Yu, Cordier and Seo 2024), and the control points that they leave free.

Two panels are alike when a cyclic shift of their edges and one orthogonal matrix lay the outline of one on the other:
in the same order by a rotation, in reversed order by a reflection. A panel is symmetric when a reflection lays it on
itself. Tied panels move as one: a search has fewer unknowns, and its pattern keeps the symmetries.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations

import numpy as np

from recovery.pattern import geometry
from recovery.pattern.coordinates import Controls, control_points, with_controls
from recovery.pattern.sewing_pattern import EdgeKind, Panel, Pattern

TOLERANCE_M = 0.001  # root mean square between a panel and the image of its like; front and back differ by more
TIE_SHARE = 0.01  # alignments whose errors differ by less than this share of the tolerance are told apart by the grain


class Kind(StrEnum):
    """The kind of motion that lays one outline on the other."""

    ROTATION = "rotation"
    REFLECTION = "reflection"


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A motion that lays panel number ``first`` on panel number ``second``. Both numbers are the same for a panel that
    is symmetric itself.

    A point a of the first lies at (a - mean of first's corners) @ ``matrix`` (2, 2) + mean of second's corners. Edge e
    of the first corresponds to edge e + ``shift`` of the second for a rotation and to ``shift`` - e, run backwards, for
    a reflection. ``error_m`` [m] is the root mean square distance over corners and handles.
    """

    first: int
    second: int
    kind: Kind
    matrix: np.ndarray
    shift: int
    error_m: float

    def edge(self, number: int, count: int) -> int:
        """Returns the edge of the second panel that corresponds to edge ``number`` of the first, of ``count`` edges
        each."""
        return (self.shift + (number if self.kind is Kind.ROTATION else -number)) % count


@dataclass(frozen=True, eq=False)
class Symmetries:
    """The symmetries of a pattern: ``between`` two panels, where a panel is the second of one at most, and ``within``
    one panel. Both are empty for a pattern without symmetry."""

    between: tuple[Symmetry, ...]
    within: tuple[Symmetry, ...]

    def describe(self, pattern: Pattern) -> list[str]:
        """Returns a line for every symmetry, with the panels' names."""
        names = [panel.name for panel in pattern.panels]
        return [
            f"{names[s.second]} is {names[s.first]} by a {s.kind}, within {1e3 * s.error_m:.2g} mm"
            for s in self.between
        ] + [f"{names[s.first]} is symmetric by a {s.kind}, within {1e3 * s.error_m:.2g} mm" for s in self.within]


def find_symmetries(pattern: Pattern, *, tolerance_m: float = TOLERANCE_M) -> Symmetries:
    """Returns the symmetries of ``pattern`` whose error is at most ``tolerance_m`` [m].

    As in algorithm 1, a panel that is the image of an earlier one is not looked at again. So every panel is tied to at
    most one, and only the others are searched for a symmetry of their own. Of several equally good alignments, as for a
    rectangle, the one that keeps the grain upright is taken, a reflection before a rotation.
    """
    between: dict[int, Symmetry] = {}  # by the panel that is tied
    numbers = range(len(pattern.panels))
    for p, q in combinations(numbers, 2):
        if not {p, q} & between.keys() and (symmetry := _best(pattern, p, q, tolerance_m)) is not None:
            between[q] = symmetry
    within = [_best(pattern, p, p, tolerance_m) for p in numbers if p not in between]
    return Symmetries(tuple(between.values()), tuple(symmetry for symmetry in within if symmetry is not None))


def procrustes(first: np.ndarray, second: np.ndarray, *, reflect: bool) -> tuple[np.ndarray, float]:
    """Returns the orthogonal M (2, 2) that takes ``first`` (N, 2) nearest to ``second`` (N, 2), a reflection or a
    rotation as ``reflect`` says, and the error.

    Schoenemann (1966): with means removed and first^T second = U S V^T it is U V^T, its last column turned where the
    determinant asks for it. The error, in the unit of the points, is the root mean square of first @ M - second.
    """
    a, b = first - first.mean(axis=0), second - second.mean(axis=0)
    u, _, vt = np.linalg.svd(a.T @ b)
    wanted = -1.0 if reflect else 1.0
    matrix = u @ np.diag([1.0, wanted * np.linalg.det(u @ vt)]) @ vt
    return matrix, float(np.sqrt(((a @ matrix - b) ** 2).sum(axis=1).mean()))


def _best(pattern: Pattern, p: int, q: int, tolerance_m: float) -> Symmetry | None:
    first, second = pattern.panels[p], pattern.panels[q]
    if len(first.edges) != len(second.edges):
        return None
    count = len(first.edges)
    symmetries: list[Symmetry] = []
    # Within a panel only reflections are asked for: left and right, as in the paper.
    for kind in (Kind.REFLECTION,) if p == q else (Kind.REFLECTION, Kind.ROTATION):
        for shift in range(count):
            candidate = Symmetry(p, q, kind, np.eye(2), shift, np.inf)
            if any(
                edge.kind is not second.edges[candidate.edge(number, count)].kind
                for number, edge in enumerate(first.edges)
            ):
                continue
            matrix, error = procrustes(*_matched(first, second, candidate), reflect=kind is Kind.REFLECTION)
            if error <= tolerance_m:
                symmetries.append(replace(candidate, matrix=matrix, error_m=error))
    if not symmetries:
        return None
    least = min(s.error_m for s in symmetries)
    good = [s for s in symmetries if s.error_m <= least + TIE_SHARE * tolerance_m]
    return max(good, key=lambda s: (round(float(s.matrix[1, 1]), 2), s.kind is Kind.REFLECTION, -s.error_m))


def _matched(first: Panel, second: Panel, symmetry: Symmetry) -> tuple[np.ndarray, np.ndarray]:
    """Corners, handles and highest points of arcs of both panels (N, 2) in corresponding order."""
    count = len(first.edges)
    turned = symmetry.kind is Kind.REFLECTION
    points = ([], [])
    for number in range(count):
        other = symmetry.edge(number, count)
        points[0].append(geometry.edge_controls(first, number)[:-1])
        mine = geometry.edge_controls(second, other)
        points[1].append((mine[::-1] if turned else mine)[:-1])
    return np.concatenate(points[0]), np.concatenate(points[1])


# --- free control points ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FreeControls:
    """Control points as a linear function of free values: positions (K, 2) = ``origin`` + ``basis`` @ values.

    ``origin`` [m] (K, 2) has the symmetries exactly; ``basis`` (2 K, Z) has orthonormal columns, so a step of one
    millimetre in ``values`` [m] (Z,) moves the control points by one millimetre in all.
    """

    controls: Controls
    origin: np.ndarray
    basis: np.ndarray

    @property
    def count(self) -> int:
        """The number of free values."""
        return self.basis.shape[1]

    def positions(self, values: np.ndarray) -> np.ndarray:
        """Returns the control points [m] (K, 2) for free ``values`` [m] (Z,)."""
        return self.origin + (self.basis @ values).reshape(-1, 2)

    def values(self, positions: np.ndarray) -> np.ndarray:
        """Returns the free values [m] (Z,) whose control points are nearest to ``positions`` [m] (K, 2)."""
        return self.basis.T @ (positions - self.origin).reshape(-1)


def symmetrised(pattern: Pattern, symmetries: Symmetries) -> Pattern:
    """Returns ``pattern`` with ``symmetries`` made exact: every panel is the mean of those that it is tied to, curves
    too."""
    every = control_points(pattern, free_curves=True)
    pattern = _with_mean_arcs(pattern, symmetries)
    return with_controls(pattern, every, _mean_positions(every, pattern, symmetries))


def free_controls(pattern: Pattern, symmetries: Symmetries) -> FreeControls:
    """Returns the corners of ``pattern`` as far as ``symmetries`` leave them free.

    The axis of a symmetric panel and the motion between two panels stay as they are. A panel's place in its own plane
    means nothing and stays free. Pass a pattern that is ``symmetrised``: curves keep their differences.
    """
    controls = control_points(pattern)
    tie = _projection(controls, pattern, symmetries)
    # The image of the tie, by Gram and Schmidt from its columns in order: a column is one coordinate and its images.
    columns: list[np.ndarray] = []
    for column in tie.T:
        for _ in range(2):
            for other in columns:
                column = column - (other @ column) * other
        if (length := np.linalg.norm(column)) > 1e-6:
            columns.append(column / length)
    return FreeControls(controls, _mean_positions(controls, pattern, symmetries), np.stack(columns, axis=1))


def _points_of(controls: Controls, panel: int) -> dict[tuple[int, int], int]:
    """Rows of a panel's control points by edge and handle."""
    rows = np.flatnonzero(controls.panel == panel)
    return {(int(controls.edge[row]), int(controls.handle[row])): int(row) for row in rows}


def correspondence(controls: Controls, pattern: Pattern, symmetry: Symmetry) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rows (n,) in ``controls`` of the first panel's control points, and the rows (n,) of the second's that
    they correspond to."""
    count = len(pattern.panels[symmetry.first].edges)
    own, other = _points_of(controls, symmetry.first), _points_of(controls, symmetry.second)
    pairs = []
    for (edge, handle), row in own.items():
        target = symmetry.edge(edge, count)
        if symmetry.kind is Kind.REFLECTION:
            handles = sum((target, h) in other for h in (1, 2))
            # Backwards: an edge's start is the other's end, its first handle the last.
            key = ((target + 1) % count, 0) if handle == 0 else (target, handles + 1 - handle)
        else:
            key = (target, handle)
        pairs.append((row, other[key]))
    rows = np.array(pairs, dtype=np.int64)
    return rows[:, 0], rows[:, 1]


def _mean_positions(controls: Controls, pattern: Pattern, symmetries: Symmetries) -> np.ndarray:
    """Control points [m] (K, 2) that have the symmetries exactly, each panel about the mean of its own corners."""
    corners = [(controls.panel == panel) & (controls.handle == 0) for panel in range(len(pattern.panels))]
    means = np.array([controls.positions[rows].mean(axis=0) for rows in corners])[controls.panel]
    offsets = controls.positions - means
    return means + (_projection(controls, pattern, symmetries) @ offsets.reshape(-1)).reshape(-1, 2)


def _projection(controls: Controls, pattern: Pattern, symmetries: Symmetries) -> np.ndarray:
    """The orthogonal projection (2 K, 2 K) of moves of the control points onto those that keep the symmetries."""
    size = 2 * len(controls)
    total = np.eye(size)
    for panel in range(len(pattern.panels)):
        between = [s for s in symmetries.between if s.first == panel]
        itself = [s for s in symmetries.within if s.first == panel]
        if not (between or itself):
            continue
        # Spread: moves of this panel's points to those of every image.
        own = np.flatnonzero(controls.panel == panel)
        mirror = np.eye(2 * len(own))
        place = {int(row): number for number, row in enumerate(own)}
        for symmetry in itself:
            rows, images = correspondence(controls, pattern, symmetry)
            mirror = 0.5 * (mirror + _move_matrix(rows, images, symmetry.matrix, place, place))
        rows_all, spread = [own], [np.eye(2 * len(own))]
        for symmetry in between:
            rows, images = correspondence(controls, pattern, symmetry)
            there = np.sort(images)
            spread.append(_move_matrix(rows, images, symmetry.matrix, place, {int(r): n for n, r in enumerate(there)}))
            rows_all.append(there)
        stacked = np.concatenate(spread) @ mirror  # mirror is a projection and the blocks of spread are orthogonal
        index = (2 * np.concatenate(rows_all)[:, None] + np.arange(2)).reshape(-1)
        total[np.ix_(index, index)] = stacked @ stacked.T / len(spread)
    return total


def _move_matrix(
    rows: np.ndarray, images: np.ndarray, matrix: np.ndarray, place: dict[int, int], there: dict[int, int]
) -> np.ndarray:
    """Matrix (2 n, 2 n) from moves of points to those of their images."""
    result = np.zeros((2 * len(rows), 2 * len(rows)))
    for row, image in zip(rows.tolist(), images.tolist(), strict=True):
        i, j = there[image], place[row]
        result[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = matrix.T
    return result


def _with_mean_arcs(pattern: Pattern, symmetries: Symmetries) -> Pattern:
    """Arcs that correspond get the mean of their heights; a reflection run backwards keeps a height's sign."""
    heights = [
        np.array([edge.handles[0][1] if edge.kind is EdgeKind.CIRCLE else 0.0 for edge in panel.edges])
        for panel in pattern.panels
    ]
    for first, own in enumerate(heights):
        images = {s.second: _edges(s, len(own)) for s in symmetries.between if s.first == first}
        mean = np.mean([own, *(heights[second][edges] for second, edges in images.items())], axis=0)
        for symmetry in symmetries.within:
            if symmetry.first == first:
                mean = 0.5 * (mean + mean[_edges(symmetry, len(own))])
        for second, edges in {first: np.arange(len(own)), **images}.items():
            heights[second][edges] = mean
    panels = []
    for panel, row in zip(pattern.panels, heights, strict=True):
        edges = [
            replace(edge, handles=((0.5, float(height)),)) if edge.kind is EdgeKind.CIRCLE else edge
            for edge, height in zip(panel.edges, row, strict=True)
        ]
        panels.append(replace(panel, edges=tuple(edges)))
    return replace(pattern, panels=tuple(panels))


def _edges(symmetry: Symmetry, count: int) -> np.ndarray:
    """The edges (count,) of the second panel that correspond to those of the first."""
    return np.array([symmetry.edge(number, count) for number in range(count)])
