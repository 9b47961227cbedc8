"""Linear grading (section 3.3 of Yu, Cordier and Seo 2024): panels widened, lengthened and tapered to a target.

The paper measures lengths of open contours and their places along the bones; it does not say how control points follow.
Here every panel that is tied to no other has three numbers: x' = x (1 + a + c y), y' = y (1 + b) about the mean of its
corners. They are the least squares solution of linear equations:

- contours get the target's length;
- their centres move to the target's places, panels moving by the affine map from pattern to drape, joined at seams;
- both edges of a seam stay equally long;
- a number that nothing determines follows one common scale.

From size to size the corners of a pattern move as those of its base do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from drape.errors import InputError
from drape.garment.contours import Contour, Match
from recovery.fit.objective import sewable
from recovery.pattern import geometry
from recovery.pattern.bases import BASES
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.measurements import BodyMeasurements, in_size
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.sewing_pattern import EdgeRef, Pattern
from recovery.pattern.symmetry import Symmetries, correspondence, find_symmetries

NUMBERS = 3  # a, b, c of a panel
SEAM_WEIGHT = 3.0
PLACE_WEIGHT = 1.0  # weight of a displacement over REACH_M; a relative change of length has 1
REACH_M = 0.5
PRIOR_WEIGHT = 0.03
SHIFT_WEIGHT = 0.03
SMALLEST, LARGEST = 0.5, 2.0  # width and height of a graded panel over the base's


@dataclass(frozen=True, eq=False)
class Graded:
    """A graded ``pattern``, and for each of its P panels the ``widths`` and ``heights`` (P,) over the base's, and
    ``tapers`` (P,).

    A taper is how much wider [1/m] a panel becomes per metre of height. ``misfit`` is the largest error of a contour or
    seam that the grading left: a relative length, or a displacement over half a metre. It is NaN where nothing was
    graded.
    """

    pattern: Pattern
    widths: np.ndarray
    heights: np.ndarray
    tapers: np.ndarray
    misfit: float


def contour_edges(mesh: PatternMesh, contour: Contour) -> list[EdgeRef]:
    """Returns the unsewn edges of panels that lie on the border ``contour`` of the sewn ``mesh``."""
    inside = np.zeros(mesh.node_count, dtype=bool)
    inside[contour.loop] = True
    sewn = mesh.pattern.sewn
    return [
        ref
        for ref, vertices in mesh.edge_vertices.items()
        if ref not in sewn and inside[mesh.node_of_panel_vertex[vertices]].all()
    ]


def grade(
    mesh: PatternMesh, nodes: np.ndarray, contours: list[Contour], matches: list[Match], symmetries: Symmetries
) -> Graded:
    """Returns the pattern of ``mesh`` graded: ``contours`` of its drape at ``nodes`` [m] (N, 3) get, as nearly as
    possible, the lengths and places of the target's contours, which ``matches`` tell.

    ``symmetries`` of the pattern stay. Raises ``InputError`` where a panel would shrink below half or grow beyond twice
    its size.
    """
    pattern = mesh.pattern
    unknowns = _Unknowns(mesh, nodes, symmetries)
    measured = [*_contour_equations(unknowns, contours, matches), *_seam_equations(unknowns)]
    equations = [*measured, *_priors(unknowns)]
    rows, rights, weights = (np.array(part) for part in zip(*equations, strict=True))
    solution = np.linalg.lstsq(weights[:, None] * rows, weights * rights, rcond=1e-10)[0]
    own = solution[: unknowns.count]
    numbers = own.reshape(-1, NUMBERS)
    factors = 1.0 + numbers[:, :2]
    if factors.min() < SMALLEST or factors.max() > LARGEST:
        raise InputError(
            "target",
            expected=f"a garment of {SMALLEST:g} to {LARGEST:g} times the base's size",
            got=f"panels of {factors.min():.2f} to {factors.max():.2f} times",
            cure="Check the target's unit, and take a base pattern nearer to it.",
        )
    off = np.abs(rows[: len(measured)] @ solution - rights[: len(measured)])
    leaders = _leaders(pattern, symmetries)
    order = sorted(set(leaders))
    of_panel = numbers[[order.index(leader) for leader in leaders]]
    positions = mesh.controls.positions + (unknowns.moves @ own).reshape(-1, 2)
    return Graded(
        with_controls(pattern, mesh.controls, positions),
        1.0 + of_panel[:, 0],
        1.0 + of_panel[:, 1],
        of_panel[:, 2],
        float(off.max(initial=0.0)),
    )


Equation = tuple[np.ndarray, float, float]  # row (size,), right side, weight


class _Unknowns:
    """The ``size`` unknowns of a grading: ``count`` numbers of panels, three shifts of each in the world, one scale."""

    def __init__(self, mesh: PatternMesh, nodes: np.ndarray, symmetries: Symmetries) -> None:
        self.mesh, self.pattern = mesh, mesh.pattern
        self.moves = _moves(mesh.pattern, symmetries)  # (2 K, count)
        self.count = self.moves.shape[1]
        self.size = self.count + 3 * len(mesh.pattern.panels) + 1
        self._number = {panel.name: number for number, panel in enumerate(mesh.pattern.panels)}
        self._frames = [_frame(mesh, nodes, panel) for panel in range(len(mesh.pattern.panels))]

    def length(self, ref: EdgeRef) -> float:
        """Length [m] of an edge of the pattern."""
        return geometry.edge_length(self.pattern.panel(ref.panel), ref.edge)

    def lengthening(self, ref: EdgeRef) -> np.ndarray:
        """Derivative (size,) of an edge's length by the unknowns."""
        panel = self.pattern.panel(ref.panel)
        start, end = self._end_moves(ref)
        chord = geometry.chord(panel, ref.edge)[1]
        along = chord / np.linalg.norm(chord) * geometry.relative_length(panel.edges[ref.edge])
        row = np.zeros(self.size)
        row[: self.count] = along @ (end - start)
        return row

    def shift(self, ref: EdgeRef) -> np.ndarray:
        """Derivative (3, size) of the displacement in the world of an edge's middle."""
        panel = self._number[ref.panel]
        start, end = self._end_moves(ref)
        rows = np.zeros((3, self.size))
        rows[:, : self.count] = self._frames[panel] @ (0.5 * (start + end))
        rows[:, self.count + 3 * panel : self.count + 3 * panel + 3] = np.eye(3)
        return rows

    def _end_moves(self, ref: EdgeRef) -> tuple[np.ndarray, np.ndarray]:
        """Moves (2, count) of the corners at the start and the end of an edge."""
        corners = np.flatnonzero(self.mesh.controls.panel == self._number[ref.panel])
        start, end = corners[ref.edge], corners[(ref.edge + 1) % len(corners)]
        return self.moves[2 * start : 2 * start + 2], self.moves[2 * end : 2 * end + 2]


def _contour_equations(unknowns: _Unknowns, contours: list[Contour], matches: list[Match]) -> Iterator[Equation]:
    """Contours get the lengths of their counterparts, panel by panel, and their places."""
    for match in matches:
        refs = contour_edges(unknowns.mesh, contours[match.source])
        total = sum(unknowns.length(ref) for ref in refs)
        for panel in sorted({ref.panel for ref in refs}):
            own = [ref for ref in refs if ref.panel == panel]
            share = sum(unknowns.length(ref) for ref in own)
            row = np.sum([unknowns.lengthening(ref) for ref in own], axis=0) / share
            yield row, match.length_ratio - 1.0, float(np.sqrt(share / total))
        centre = np.sum([unknowns.length(ref) / total * unknowns.shift(ref) for ref in refs], axis=0)
        yield match.place.direction @ centre / REACH_M, match.move_m / REACH_M, PLACE_WEIGHT


def _seam_equations(unknowns: _Unknowns) -> Iterator[Equation]:
    """Both edges of a seam stay equally long and move together."""
    for stitch in unknowns.pattern.stitches:
        mean = 0.5 * (unknowns.length(stitch.first) + unknowns.length(stitch.second))
        yield (unknowns.lengthening(stitch.first) - unknowns.lengthening(stitch.second)) / mean, 0.0, SEAM_WEIGHT
        for row in (unknowns.shift(stitch.first) - unknowns.shift(stitch.second)) / REACH_M:
            yield row, 0.0, PLACE_WEIGHT


def _priors(unknowns: _Unknowns) -> Iterator[Equation]:
    """Widths and heights follow the common scale, tapers and shifts stay near zero."""
    for number in range(unknowns.count):
        row = np.zeros(unknowns.size)
        row[number] = 1.0 if number % NUMBERS < 2 else REACH_M
        row[-1] = -1.0 if number % NUMBERS < 2 else 0.0
        yield row, 0.0, PRIOR_WEIGHT
    for number in range(unknowns.count, unknowns.size - 1):  # long shifts would tell directions apart that nearly agree
        row = np.zeros(unknowns.size)
        row[number] = 1.0 / REACH_M
        yield row, 0.0, SHIFT_WEIGHT


def combine_grades(first: Graded, second: Graded) -> Graded:
    """Returns the grading ``second``, which graded the pattern of ``first``, with factors over the base of ``first``.

    Squares of tapers are left out of the factors, as they are of both gradings.
    """
    return Graded(
        second.pattern,
        first.widths * second.widths,
        first.heights * second.heights,
        first.tapers * second.widths + first.widths * first.heights * second.tapers,
        second.misfit,
    )


def ungraded(pattern: Pattern) -> Graded:
    """Returns ``pattern`` as a grading that changed nothing: widths and heights are 1, tapers 0, the misfit is NaN."""
    ones = np.ones(len(pattern.panels))
    return Graded(pattern, ones, ones, 0.0 * ones, float("nan"))


def _leaders(pattern: Pattern, symmetries: Symmetries) -> list[int]:
    """For every panel the one whose image it is, or itself."""
    leaders = list(range(len(pattern.panels)))
    for symmetry in symmetries.between:
        leaders[symmetry.second] = symmetry.first
    return leaders


def _moves(pattern: Pattern, symmetries: Symmetries) -> np.ndarray:
    """Moves (2 K, 3 R) of the corners by the numbers of the R panels that are tied to none."""
    controls = control_points(pattern)
    leaders = _leaders(pattern, symmetries)
    order = sorted(set(leaders))
    moves = np.zeros((2 * len(controls), NUMBERS * len(order)))
    for block, panel in enumerate(order):
        rows = np.flatnonzero(controls.panel == panel)
        x, y = (controls.positions[rows] - controls.positions[rows].mean(axis=0)).T
        first = NUMBERS * block
        moves[2 * rows, first], moves[2 * rows + 1, first + 1], moves[2 * rows, first + 2] = x, y, x * y
        for symmetry in symmetries.between:
            if symmetry.first != panel:
                continue
            sources, images = correspondence(controls, pattern, symmetry)
            block_columns = slice(first, first + NUMBERS)
            for source, image in zip(sources.tolist(), images.tolist(), strict=True):
                own = moves[2 * source : 2 * source + 2, block_columns]
                moves[2 * image : 2 * image + 2, block_columns] = symmetry.matrix.T @ own
    return moves


def _frame(mesh: PatternMesh, nodes: np.ndarray, panel: int) -> np.ndarray:
    """The linear part (3, 2) of the affine map nearest to that from a panel to its drape."""
    mine = mesh.panel == panel
    flat, world = mesh.rest[mine], nodes[mesh.node_of_panel_vertex[mine]]
    flat, world = flat - flat.mean(axis=0), world - world.mean(axis=0)
    return np.linalg.lstsq(flat, world, rcond=None)[0].T


def in_other_size(
    pattern: Pattern, base: str, body: BodyMeasurements, settings: Mapping[str, float], size: str
) -> Pattern:
    """Returns ``pattern``, which fits ``body`` as its size M, in ``size``. ``base`` is the name of the base that it was
    made from, drafted for ``body`` with ``settings`` by name.

    A corner moves as far as that of the base moves from M to ``size``, and then as little as restores the ratios of
    seams and the base's symmetries. Raises ``InputError`` for a base that is a file, or has no such size.
    """
    if base not in BASES:
        raise InputError(
            "--sizes",
            expected=f"a base that is drafted: {', '.join(sorted(BASES))}",
            got=base,
            cure="Leave --sizes out: panels of a file do not say how they grow.",
        )
    drafts = [BASES[base](measured, **settings) for measured in (body, in_size(body, size))]
    middle, other = (control_points(draft).positions for draft in drafts)
    controls = control_points(pattern)
    grown = with_controls(pattern, controls, controls.positions + other - middle)
    return sewable(grown, pattern, find_symmetries(drafts[0]))
