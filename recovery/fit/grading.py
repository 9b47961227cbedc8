"""Linear grading (section 3.3 of Yu, Cordier and Seo 2024): panels widened, lengthened and tapered to a target.

The paper says what is measured, lengths of open contours and their places along the bones, not how control points
follow. Here every panel that is tied to none has three numbers: x' = x (1 + a + c y), y' = y (1 + b) about the mean of
its corners. They are the least squares solution of linear equations: contours get the target's length; their centres
move to its places, panels carried along by the affine map from pattern to drape and joined at the seams; both
edges of a seam stay as long as each other; and all that says nothing follows one common scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.errors import InputError
from recovery.fit.contours import Contour, Match
from recovery.pattern import geometry
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.mesh import PatternMesh
from recovery.pattern.model import EdgeRef, Pattern
from recovery.pattern.symmetry import Symmetries, correspondence

NUMBERS = 3  # a, b, c of a panel
SEAM_WEIGHT = 3.0
PLACE_WEIGHT = 1.0  # of a displacement over REACH_M, beside a relative change of length
REACH_M = 0.5
PRIOR_WEIGHT = 0.03
SHIFT_WEIGHT = 0.03
SMALLEST, LARGEST = 0.5, 2.0  # width and height of a graded panel over the base's


@dataclass(frozen=True, eq=False)
class Graded:
    """The graded ``pattern``; for every panel the ``widths`` and ``heights`` (P,) over the base's, and ``tapers`` (P,).

    A taper is how much wider [1/m] a panel becomes per metre of height. ``misfit`` is the largest relative length or
    displacement (over half a metre) that the grading could not follow.
    """

    pattern: Pattern
    widths: np.ndarray
    heights: np.ndarray
    tapers: np.ndarray
    misfit: float


def contour_edges(mesh: PatternMesh, contour: Contour) -> list[EdgeRef]:
    """The edges of the panels that ``contour`` of the sewn ``mesh`` consists of."""
    inside = np.zeros(mesh.node_count, dtype=bool)
    inside[contour.loop] = True
    sewn = {ref for stitch in mesh.pattern.stitches for ref in (stitch.first, stitch.second)}
    return [
        ref
        for ref, vertices in mesh.edge_vertices.items()
        if ref not in sewn and inside[mesh.node_of_panel_vertex[vertices]].all()
    ]


def grade(
    mesh: PatternMesh, nodes: np.ndarray, contours: list[Contour], matches: list[Match], symmetries: Symmetries
) -> Graded:
    """The pattern of ``mesh`` graded so that ``contours`` of its drape at ``nodes`` [m] (N, 3) go to their ``matches``.

    ``symmetries`` of the pattern stay. Raises ``InputError`` where a panel would shrink below half or grow beyond twice
    its size.
    """
    pattern = mesh.pattern
    controls = control_points(pattern)
    moves = _moves(pattern, symmetries)  # (2 K, numbers)
    count = moves.shape[1]
    # Unknowns: the panels' numbers, each panel's shift in the world, and the common scale.
    size = count + 3 * len(pattern.panels) + 1
    row_of = {(int(p), int(e)): k for k, (p, e) in enumerate(zip(controls.panel, controls.edge, strict=True))}
    number_of = {panel.name: number for number, panel in enumerate(pattern.panels)}
    frames = [_frame(mesh, nodes, panel) for panel in range(len(pattern.panels))]

    def ends(ref: EdgeRef) -> tuple[int, int]:
        panel = number_of[ref.panel]
        return row_of[panel, ref.edge], row_of[panel, (ref.edge + 1) % len(pattern.panels[panel].edges)]

    def lengthening(ref: EdgeRef) -> np.ndarray:
        """Derivative (size,) of an edge's length by the unknowns."""
        panel = pattern.panel(ref.panel)
        start, end = ends(ref)
        chord = geometry.chord(panel, ref.edge)[1]
        along = chord / np.linalg.norm(chord) * geometry.relative_length(panel.edges[ref.edge])
        row = np.zeros(size)
        row[:count] = along @ (moves[2 * end : 2 * end + 2] - moves[2 * start : 2 * start + 2])
        return row

    def shift(ref: EdgeRef) -> np.ndarray:
        """Derivative (3, size) of the displacement in the world of an edge's middle."""
        panel = number_of[ref.panel]
        start, end = ends(ref)
        rows = np.zeros((3, size))
        middle = 0.5 * (moves[2 * start : 2 * start + 2] + moves[2 * end : 2 * end + 2])
        rows[:, :count] = frames[panel] @ middle
        rows[:, count + 3 * panel : count + 3 * panel + 3] = np.eye(3)
        return rows

    def length(ref: EdgeRef) -> float:
        return geometry.edge_length(pattern.panel(ref.panel), ref.edge)

    equations: list[tuple[np.ndarray, float, float]] = []  # row, right side, weight
    for match in matches:
        refs = contour_edges(mesh, contours[match.source])
        total = sum(length(ref) for ref in refs)
        for panel in sorted({ref.panel for ref in refs}):
            own = [ref for ref in refs if ref.panel == panel]
            share = sum(length(ref) for ref in own)
            row = np.sum([lengthening(ref) for ref in own], axis=0) / share
            equations.append((row, match.length_ratio - 1.0, float(np.sqrt(share / total))))
        centre = np.sum([length(ref) / total * shift(ref) for ref in refs], axis=0)
        equations.append((match.place.direction @ centre / REACH_M, match.move_m / REACH_M, PLACE_WEIGHT))
    for stitch in pattern.stitches:
        mean = 0.5 * (length(stitch.first) + length(stitch.second))
        equations.append(((lengthening(stitch.first) - lengthening(stitch.second)) / mean, 0.0, SEAM_WEIGHT))
        for row in (shift(stitch.first) - shift(stitch.second)) / REACH_M:
            equations.append((row, 0.0, PLACE_WEIGHT))
    told = len(equations)
    for number in range(count):
        row = np.zeros(size)
        row[number] = 1.0 if number % NUMBERS < 2 else REACH_M
        row[-1] = -1.0 if number % NUMBERS < 2 else 0.0
        equations.append((row, 0.0, PRIOR_WEIGHT))
    for number in range(count, size - 1):  # or directions that nearly agree would be told apart by long shifts
        row = np.zeros(size)
        row[number] = 1.0 / REACH_M
        equations.append((row, 0.0, SHIFT_WEIGHT))
    matrix = np.array([weight * row for row, _, weight in equations])
    right = np.array([weight * value for _, value, weight in equations])
    found = np.linalg.lstsq(matrix, right, rcond=1e-10)[0]
    numbers = found[:count].reshape(-1, NUMBERS)
    factors = 1.0 + numbers[:, :2]
    if factors.min() < SMALLEST or factors.max() > LARGEST:
        raise InputError(
            "target",
            expected=f"a garment of {SMALLEST:g} to {LARGEST:g} times the base's size",
            got=f"panels of {factors.min():.2f} to {factors.max():.2f} times",
            cure="Check the target's unit, and take a base pattern nearer to it.",
        )
    positions = controls.positions + (moves @ found[:count]).reshape(-1, 2)
    off = np.abs(matrix[:told] @ found - right[:told]) / np.array([weight for _, _, weight in equations[:told]])
    leaders = _leaders(pattern, symmetries)
    order = sorted(set(leaders))
    of_panel = numbers[[order.index(leader) for leader in leaders]]
    return Graded(
        with_controls(pattern, controls, positions),
        1.0 + of_panel[:, 0],
        1.0 + of_panel[:, 1],
        of_panel[:, 2],
        float(off.max(initial=0.0)),
    )


def graded_again(first: Graded, second: Graded) -> Graded:
    """``second``, which graded the pattern of ``first``, with the factors of both over the first one's base.

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
    """``pattern`` as it is, all factors one; its misfit is not known."""
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
