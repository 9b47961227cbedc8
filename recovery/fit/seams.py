"""Seams that can be sewn, as a constraint: both edges of every stitch keep the ratio of lengths that the base asks for.

A term of the loss lets seams give way to a target. What is cut must not. So the search stays on the surface of free
values z where g(z) = 0, with one equation a stitch: g = ln(first edge / second edge) - ln(ratio).
An edge is its chord times a constant, so the derivative of g is exact. A step goes along the surface, and Newton's
method with the shortest correction brings it back.
"""

from __future__ import annotations

import numpy as np

from drape.errors import InputError
from recovery.pattern import geometry
from recovery.pattern.coordinates import with_controls
from recovery.pattern.sewing_pattern import EdgeRef, Pattern
from recovery.pattern.symmetry import FreeControls, Symmetries, free_controls

EVEN = 0.005  # a base whose edges differ by less has no ease there: its seams are made equal
EXACT = 1e-10  # of a length: what Newton leaves
NEWTON_LIMIT = 30
RANK = 1e-9  # of the largest singular value: mirrored stitches say the same twice


def wanted_ratios(base: Pattern) -> np.ndarray:
    """Returns for each stitch of ``base`` the ratio (S,) of its first edge's length to its second's; 1 where the base
    has no ease."""
    ratio = np.array([seam.first_m / seam.second_m for seam in geometry.seams(base)])
    return np.where(np.abs(ratio - 1.0) <= EVEN, 1.0, ratio)


def ease_left(pattern: Pattern, base: Pattern) -> np.ndarray:
    """Relative differences (S,) of the first edges of ``pattern`` from what the stitches of ``base`` ask for."""
    return np.array([seam.first_m / seam.second_m for seam in geometry.seams(pattern)]) / wanted_ratios(base) - 1.0


class SeamConstraint:
    """The stitches of ``pattern``, whose corners are ``free``, in the ratios that those of ``base`` ask for."""

    def __init__(self, pattern: Pattern, free: FreeControls, base: Pattern) -> None:
        self.free = free
        self._number = {panel.name: number for number, panel in enumerate(pattern.panels)}
        sides = [[getattr(stitch, side) for stitch in pattern.stitches] for side in ("first", "second")]
        self._chords = np.stack([self._chord_rows(refs) for refs in sides])  # (2, S, 2 coordinates, 1 + Z)
        per_chord = [
            np.array([geometry.relative_length(pattern.panel(ref.panel).edges[ref.edge]) for ref in refs])
            for refs in sides
        ]
        self.offset = np.log(per_chord[0]) - np.log(per_chord[1]) - np.log(wanted_ratios(base))

    def _chord_rows(self, refs: list[EdgeRef]) -> np.ndarray:
        """Chords (S, 2, 1 + Z) of edges as linear functions of (1, z)."""
        rows = np.concatenate([self.free.origin.reshape(-1, 1), self.free.basis], axis=1).reshape(
            len(self.free.controls), 2, -1
        )
        chords = np.zeros((len(refs), *rows.shape[1:]))
        for number, ref in enumerate(refs):
            corners = np.flatnonzero(self.free.controls.panel == self._number[ref.panel])
            chords[number] = rows[corners[(ref.edge + 1) % len(corners)]] - rows[corners[ref.edge]]
        return chords

    def apart(self, values: np.ndarray) -> np.ndarray:
        """g (S,) at ``values`` [m] (Z,): the relative difference of every seam from what is asked for."""
        chords = self._chords @ np.concatenate([[1.0], values])
        length = np.log(np.linalg.norm(chords, axis=2))
        return length[0] - length[1] + self.offset

    def slopes(self, values: np.ndarray) -> np.ndarray:
        """The derivatives (S, Z) [1/m] of ``apart``."""
        chords = self._chords @ np.concatenate([[1.0], values])
        along = chords / (chords**2).sum(axis=2, keepdims=True)
        rows = np.einsum("esc,escz->esz", along, self._chords[..., 1:])
        return rows[0] - rows[1]

    def along(self, values: np.ndarray) -> np.ndarray:
        """Orthonormal directions (Z, M) in which no seam changes, to first order."""
        _, size, ways = np.linalg.svd(self.slopes(values), full_matrices=True)
        rank = int((size > RANK * max(size.max(initial=0.0), 1e-30)).sum())
        return ways[rank:].T

    def kept(self, values: np.ndarray) -> np.ndarray | None:
        """Returns the values [m] (Z,) nearest to ``values`` at which all seams have their ratios; None where Newton's
        method finds none."""
        values = np.array(values, dtype=np.float64)
        for _ in range(NEWTON_LIMIT):
            apart = self.apart(values)
            if np.abs(apart).max(initial=0.0) <= EXACT:
                return values
            if not np.isfinite(apart).all():
                return None
            values = values - np.linalg.lstsq(self.slopes(values), apart, rcond=RANK)[0]
        return None


def sewable(pattern: Pattern, base: Pattern, symmetries: Symmetries) -> Pattern:
    """Returns ``pattern`` with its corners moved as little as makes its seams those that ``base`` asks for.

    ``symmetries`` of the pattern stay. Raises ``InputError`` where no corners do.
    """
    free = free_controls(pattern, symmetries)
    values = SeamConstraint(pattern, free, base).kept(np.zeros(free.count))
    if values is None:
        raise InputError(
            "seams",
            expected="edges that can be made as long as those they are sewn to",
            got="corners that cannot be moved so",
            cure="Check the base's seams: python -m recovery.pattern show.",
        )
    return with_controls(pattern, free.controls, free.positions(values))
