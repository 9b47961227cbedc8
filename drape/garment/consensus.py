"""Chart consensus: tables by which overlapping charts are brought to agree, and those of their strain.

A few vertices of every patch are its anchors. Where the blend of all charts puts the anchors, each
chart is fitted anew by least squares, weighted by the roots of the blend's weights: between the weights
themselves, which leave the rims of charts apart, and equal ones, which cost energy (docs/log.md). The fit
is linear, so it is a constant matrix per patch; its cost does not grow with the mesh. Afterwards a chart
says nearly what its neighbours say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drape.garment.cache import CHARTS_PER_VERTEX
from drape.garment.charts import rows_of_patches
from drape.geometry import jets

ANCHORS_PER_PATCH = 12  # within the patch; its chart also covers three times as many of its neighbours'
MEMBERS = 56  # most anchors of a chart, one more than are used; most charts have 48
FIT_COUNT = jets.HEIGHT_COUNT + jets.IN_PLANE_COUNT  # rows of a fit: the height's order, then the in-plane order
RIDGE = 1e-4  # of the mean diagonal of the normal equations
TRACE_SHARE = 0.3  # how much the strain's trace adds to the force: Poisson's effect
# Strain is measured at the centre of a patch and on a ring round it [patch scales]; half a patch is about 0.42 wide.
RING, RING_COUNT = 0.4, 6
STRAIN_POINTS = 1 + RING_COUNT


@dataclass(frozen=True, eq=False)
class Consensus:
    """The constant tables by which the charts of K patches are brought to agree; float64. They agree at A anchors, a
    few vertices of each patch.

    ``anchor`` (A,): the anchors, as vertices of the garment. ``member`` (K, 56): the anchors that each patch covers, as
    rows of ``anchor``; ``slot`` (K, 56): which of the anchor's four charts the patch is. Unused columns of both, and of
    ``fit``, hold zeros. ``fit`` (K, 21, 56) takes values at the members to coefficients: 15 of order 4 for the height,
    then 6 of order 2 for the plane. ``rest`` (K, 21, 3): the coefficients of the rest positions in the patch's frame
    [patch scales].

    ``tangent`` (K, 7, 3, 2): derivatives by (u, v) of the rest jet at ``strain_points``. ``orthonormal`` (K, 7, 2, 2):
    upper triangular matrices; ``tangent @ orthonormal`` has orthonormal columns.
    """

    anchor: np.ndarray
    member: np.ndarray
    slot: np.ndarray
    fit: np.ndarray
    rest: np.ndarray
    tangent: np.ndarray
    orthonormal: np.ndarray


def strain_points() -> np.ndarray:
    """Returns the seven places (u, v) (7, 2) of a patch at which strain is measured: its centre and a ring around
    it."""
    angle = np.arange(RING_COUNT) * (2.0 * np.pi / RING_COUNT)
    return np.concatenate([np.zeros((1, 2)), RING * np.stack([np.cos(angle), np.sin(angle)], axis=1)])


def strain_places(patch_jet: np.ndarray, patch_scale: np.ndarray) -> np.ndarray:
    """Returns the positions [m] (K, 7, 3) of the ``strain_points`` of patches at rest, in the frames of the patches.
    ``patch_jet`` (K, 27) are the jets at rest, ``patch_scale`` (K,) [m per unit of u, v]."""
    points = np.broadcast_to(strain_points(), (len(patch_scale), STRAIN_POINTS, 2))
    scale = patch_scale.astype(np.float64)[:, None, None]
    return scale * jets.evaluate_jet(patch_jet.astype(np.float64)[:, None], points)


def consensus(
    chart_patch: np.ndarray,
    chart_uv: np.ndarray,
    chart_weight: np.ndarray,
    chart_local: np.ndarray,
    patch_jet: np.ndarray,
    patch_scale: np.ndarray,
) -> Consensus:
    """Returns the tables of a garment of K patches and V vertices. The arguments are the arrays of its ``Atlas`` of the
    same names; ``chart_local`` [m] (V, 4, 3) is what ``Atlas.chart_local`` returns."""
    count = len(patch_scale)
    anchor = _anchors(chart_patch, chart_uv, chart_weight, count)
    patch, weight = chart_patch[anchor], chart_weight[anchor].astype(np.float64)
    uv = chart_uv[anchor].astype(np.float64)
    local = chart_local[anchor] / patch_scale.astype(np.float64)[patch][..., None]
    member, slot = (np.zeros((count, MEMBERS), dtype=np.int64) for _ in range(2))
    fit, rest = np.zeros((count, FIT_COUNT, MEMBERS)), np.zeros((count, FIT_COUNT, 3))
    for k, (rows, slots) in enumerate(_held(patch, weight, count)):
        bases = (jets.basis(uv[rows, slots], order) for order in (jets.HEIGHT_ORDER, jets.IN_PLANE_ORDER))
        made = np.concatenate([_weighted_fit(basis, np.sqrt(weight[rows, slots])) for basis in bases])
        member[k, : len(rows)], slot[k, : len(rows)], fit[k, :, : len(rows)] = rows, slots, made
        rest[k] = made @ local[rows, slots]
    points = np.broadcast_to(strain_points(), (count, STRAIN_POINTS, 2))
    jet = patch_jet.astype(np.float64)[:, None]
    by_u, by_v = jets.evaluate_jet(jet, points, u_times=1), jets.evaluate_jet(jet, points, v_times=1)
    tangent = np.stack([by_u, by_v], axis=-1)
    lower = np.linalg.cholesky(tangent.swapaxes(-1, -2) @ tangent)
    return Consensus(anchor, member, slot, fit, rest, tangent, np.linalg.inv(lower).swapaxes(-1, -2))


def _weighted_fit(basis: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(n, m) matrix from values at m points to the n coefficients of least weighted squares, with a ridge."""
    weighted = basis * weight[:, None]
    normal = weighted.T @ basis
    normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
    return np.linalg.solve(normal, weighted.T)


def _held(patch: np.ndarray, weight: np.ndarray, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The rows and the slots of each patch's charts among ``patch`` (A, 4), without those of no ``weight``."""
    rows, slots = np.nonzero(weight > 0.0)
    return [(rows[part], slots[part]) for part in rows_of_patches(patch[rows, slots], count)]


def _anchors(patch: np.ndarray, uv: np.ndarray, weight: np.ndarray, count: int) -> np.ndarray:
    """Rows (A,) of the anchors: up to ``ANCHORS_PER_PATCH`` vertices of each patch, each farthest in (u, v) from those
    before it. A chart that would hold more anchors than it has places for loses those that it weighs least."""
    every, heaviest = np.arange(len(patch)), np.argmax(weight, axis=1)
    owner, place = patch[every, heaviest], uv[every, heaviest].astype(np.float64)
    groups = rows_of_patches(owner, count)
    anchor = np.sort(np.concatenate([own[_farthest_first(place[own])] for own in groups if len(own)]))
    while True:
        held = _held(patch[anchor], weight[anchor], count)
        rows, slots = max(held, key=lambda part: len(part[0]))
        if len(rows) < MEMBERS:
            return anchor
        least = np.argsort(weight[anchor][rows, slots], kind="stable")[: len(rows) - MEMBERS + 1]
        anchor = np.delete(anchor, rows[least])


def _farthest_first(points: np.ndarray) -> np.ndarray:
    """Rows of up to ``ANCHORS_PER_PATCH`` of ``points`` (n, 2), from the one nearest to the origin on."""
    anchors = [int(np.argmin(np.sum(points * points, axis=1)))]
    distance = np.sum((points - points[anchors[0]]) ** 2, axis=1)
    while len(anchors) < min(ANCHORS_PER_PATCH, len(points)):
        anchors.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.sum((points - points[anchors[-1]]) ** 2, axis=1))
    return np.array(anchors)


assert CHARTS_PER_VERTEX * ANCHORS_PER_PATCH < MEMBERS
