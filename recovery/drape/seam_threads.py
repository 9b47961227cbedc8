"""Sews placed panels round a body: threads shorten evenly until the seams meet, then their vertices are merged.

Seams that a file joins crosswise, left side of one panel to right side of the other, are exchanged before.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import torch

from drape.cloth.relaxation import Distance, Relaxation, principal_stretches
from drape.errors import InputError
from recovery import progress
from recovery.pattern import geometry
from recovery.pattern.pattern_mesh import PatternMesh
from recovery.pattern.sewing_pattern import Pattern, Stitch
from recovery.sim.skin_contact import SignedDistance

SEWING_GAP_M = 0.012  # cloth is kept this far off while it is sewn: inflated clear of the body
CLOSING_ROUNDS, CLOSED_ROUNDS, MERGED_ROUNDS = 100, 60, 60
OPEN_SEAM_M = 0.05  # a seam that stays open by more than this has the body between its sides
MOST_STRETCH = 1.6  # of nine triangles in ten; threads are stronger than cloth: a small garment is stretched, not open
CLEARLY_NEARER = 0.5  # share of the distance that an exchange leaves: no seam that is meant crosswise comes near it
LENGTH_SLACK = 0.02  # the exchanged seams may fit worse by this


class Sewn(NamedTuple):
    """A sewn garment: ``nodes`` [m] (N, 3), the largest gap ``gap_m`` [m] of a seam before its vertices were merged,
    and the principal stretches ``stretch`` (F, 2) of the triangles, the larger first."""

    nodes: np.ndarray
    gap_m: float
    stretch: np.ndarray


def in_numpy(distance: SignedDistance) -> Distance:
    """Returns the signed ``distance`` as a function of an array of points [m] (N, 3): to distances [m] (N,) and
    gradients (N, 3), made unit vectors."""

    def query(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with torch.no_grad():
            value, gradient = distance(torch.from_numpy(np.ascontiguousarray(points)))
        slope = gradient.numpy()
        return value.numpy(), slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)

    return query


def sewn_relaxation(
    mesh: PatternMesh,
    distance: Distance,
    *,
    gap_m: float | np.ndarray = SEWING_GAP_M,
    creases: np.ndarray | None = None,
) -> Relaxation:
    """Returns a ``Relaxation`` of the sewn garment's nodes, which keep ``gap_m`` [m], one number or (N,), from the skin
    and fold freely at the nodes ``creases``."""
    return Relaxation(mesh.faces, mesh.rest[mesh.panel_faces], distance, gap_m=gap_m, creases=creases)


def sew(
    mesh: PatternMesh,
    placed: np.ndarray,
    distance: Distance,
    *,
    gap_m: float | np.ndarray = SEWING_GAP_M,
    creases: np.ndarray | None = None,
) -> Sewn:
    """Returns the garment sewn from panel vertices ``placed`` at [m] (P, 3), clear of the body.

    Panel vertices keep ``gap_m`` [m], one number or (P,), from the skin meanwhile. ``creases`` (n,) are nodes of seams
    that stay folded, as a collar's. Raises ``InputError`` if a seam cannot close, or only by stretching the cloth
    beyond what any garment bears.
    """
    panels = Relaxation(mesh.panel_faces, mesh.rest[mesh.panel_faces], distance, gap_m=gap_m, threads=mesh.seam_pairs)
    x, start = placed, panels.thread_lengths(placed)
    for number in range(CLOSING_ROUNDS + CLOSED_ROUNDS):
        progress.tick(f"seams close, round {number + 1} of {CLOSING_ROUNDS + CLOSED_ROUNDS}")
        x = panels.step(x, start * max(0.0, 1.0 - (number + 1) / CLOSING_ROUNDS))
    gaps = panels.thread_lengths(x)
    if len(gaps) and gaps.max() > OPEN_SEAM_M:
        stitch = mesh.pattern.stitches[int(mesh.seam_of_pair[gaps.argmax()])]
        raise InputError(
            f"stitch {stitch.first} to {stitch.second}",
            expected="edges that meet round the body",
            got=f"{100 * gaps.max():.1f} cm between them",
            cure="Check the placement of both panels and the axes they were placed in (--axes).",
        )
    gaps_m = mesh.nodes_from(gap_m[:, None])[:, 0] if isinstance(gap_m, np.ndarray) else gap_m
    merged = sewn_relaxation(mesh, distance, gap_m=gaps_m, creases=creases)
    nodes = mesh.nodes_from(x)
    for number in range(MERGED_ROUNDS):
        progress.tick(f"seams merged, round {number + 1} of {MERGED_ROUNDS}")
        nodes = merged.step(nodes)
    stretch = principal_stretches(mesh.faces, mesh.rest[mesh.panel_faces], nodes)
    if (most := float(np.quantile(stretch[:, 0], 0.9))) > MOST_STRETCH:
        raise InputError(
            "pattern",
            expected=f"cloth that reaches round the body, stretched by at most {100 * (MOST_STRETCH - 1.0):.0f} %",
            got=f"{100 * (most - 1.0):.0f} %",
            cure="Size the pattern up (--scale), and check its unit (--units-in-meter).",
        )
    return Sewn(nodes, float(gaps.max(initial=0.0)), stretch)


# --- crossed seams ---------------------------------------------------------------------------------------------------


def uncross_stitches(pattern: Pattern) -> tuple[Pattern, tuple[str, ...]]:
    """Returns ``pattern`` with crossed pairs of stitches exchanged, and a sentence on each pair.

    Two stitches between the same two panels are crossed where their edges, panels as placed, come to lie twice as near
    with the partners exchanged, and the lengths still fit.
    """
    stitches, notes = list(pattern.stitches), []
    for i, j in combinations(range(len(stitches)), 2):
        before = (stitches[i], stitches[j])
        after = _exchanged(*before)
        if after is None:
            continue
        near, far = (sum(float(geometry.stitch_ends(pattern, s).sum()) for s in pair) for pair in (after, before))
        if near < CLEARLY_NEARER * far and _misfit(pattern, after) <= _misfit(pattern, before) + LENGTH_SLACK:
            stitches[i], stitches[j] = after
            notes.append(
                f"stitches {i + 1} and {j + 1} join {before[0].first} to {before[0].second} and {before[1].first} to "
                f"{before[1].second} crosswise, their ends {100 * far / 4:.0f} cm apart; exchanged, they are "
                f"{100 * near / 4:.0f} cm apart"
            )
    return replace(pattern, stitches=tuple(stitches)), tuple(notes)


def _exchanged(stitch: Stitch, other: Stitch) -> tuple[Stitch, Stitch] | None:
    """The stitches with their partners exchanged; None where they do not join the same two panels."""
    if stitch.first.panel == stitch.second.panel or stitch.right_to_wrong != other.right_to_wrong:
        return None
    if (other.first.panel, other.second.panel) == (stitch.second.panel, stitch.first.panel):
        other = replace(other, first=other.second, second=other.first)
    if (other.first.panel, other.second.panel) != (stitch.first.panel, stitch.second.panel):
        return None
    return replace(stitch, second=other.second), replace(other, second=stitch.second)


def _misfit(pattern: Pattern, pair: tuple[Stitch, Stitch]) -> float:
    """The larger share by which the two edges of a stitch differ in length."""
    return max(abs(seam.mismatch) for seam in geometry.seams(replace(pattern, stitches=pair)))
