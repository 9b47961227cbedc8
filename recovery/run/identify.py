"""Identifiability: how well a target determines the shape of the panels, by the derivatives of the drape.

Let y be the shape of the panels: orthonormal moves of the control points without rigid moves of whole panels. The drape
moves by dX/dy y, and the singular values of dX/dy are how far the cloth moves. A target shows less, because cloth that
slides along its own surface looks the same. It shows the curvature C of the loss: a change y raises the squared
distance of the surfaces, mean of both directions, by y^T C y / 4. The fit sees the root of that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from drape.geometry import meshes
from recovery.fit.objective import gauss_newton_matrix
from recovery.fit.outcome import Recovered
from recovery.pattern.sewing_pattern import EdgeRef, Pattern

RIGID = 1e-6  # singular values below: the change is a rigid motion of panels
CAP_M = 0.05  # slack beyond this is "more than": the derivatives do not reach further
BLIND = 1e-9  # of the largest curvature: smaller ones are raised to it
WEAKEST = 3  # shapes that get a sentence


@dataclass(frozen=True, eq=False)
class Identifiability:
    """How well a target determines the shape of a pattern, which has M dimensions that the symmetries leave free.

    ``cloth`` (M,): singular values of the derivative of the drape by the shape, that is how far the cloth moves [m per
    m], root mean square, falling. ``modes`` (M, K, 2): M orthogonal changes of shape, each as the moves of the K
    control points, of unit length in all. ``seen`` (M,): how far [m per m] each of these takes the drape off the
    target, as the loss measures it, root mean square, rising. ``slack_m`` [m] (K,): the farthest that each control
    point can go while the loss sees the drape change by no more than ``tolerance_m`` [m], at most ``CAP_M``.
    """

    cloth: np.ndarray
    seen: np.ndarray
    modes: np.ndarray
    slack_m: np.ndarray
    tolerance_m: float


def identifiability(recovered: Recovered, tolerance_m: float) -> Identifiability:
    """Returns how well its target determines the best pattern of ``recovered``, where surfaces that differ by
    ``tolerance_m`` [m] count as the same."""
    search = recovered.search
    mesh, objective = search.mesh, search.objective
    rest = mesh.rest_at(recovered.fitted.positions)
    rest_moves = (mesh.weights @ search.free.basis).reshape(len(rest), 2, -1)
    moves = search.forward.sensitivity(torch.from_numpy(rest), recovered.fitted.nodes, rest_moves)
    curvature = gauss_newton_matrix(objective, recovered.fitted.nodes, moves)
    across, back = shape_basis(search.free.basis, search.free.controls.panel, recovered.fitted.positions)
    share = meshes.vertex_areas(recovered.fitted.nodes, mesh.faces)
    weighted = (np.sqrt(share / share.sum())[:, None, None] * moves).reshape(-1, moves.shape[2]) @ back
    return from_curvature(np.linalg.svd(weighted, compute_uv=False), back.T @ curvature @ back, across, tolerance_m)


def shape_basis(basis: np.ndarray, panel: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns an orthonormal basis (2 K, M) of the moves of K control points that change the shape of a panel, and the
    free values (Z, M) that make each of them.

    ``basis`` (2 K, Z) has the move that each free value makes, ``panel`` (K,) the panel of each control point, and
    ``positions`` [m] (K, 2) its place. Moves that only shift or turn a panel in its plane are taken out.
    """
    rigid = []
    for number in np.unique(panel):
        mine = panel == number
        arm = np.where(mine[:, None], positions - positions[mine].mean(axis=0), 0.0)
        turn = np.stack([-arm[:, 1], arm[:, 0]], axis=1)
        rigid += [np.where(mine[:, None], way, 0.0).reshape(-1) for way in ((1.0, 0.0), (0.0, 1.0))]
        rigid.append(turn.reshape(-1))
    frame = np.linalg.qr(np.array(rigid).T)[0]
    across, size, values = np.linalg.svd(basis - frame @ (frame.T @ basis), full_matrices=False)
    kept = size > RIGID
    return across[:, kept], values[kept].T / size[kept]


def from_curvature(cloth: np.ndarray, curvature: np.ndarray, across: np.ndarray, tolerance_m: float) -> Identifiability:
    """Returns the identifiability that follows from the loss's ``curvature`` (M, M) [m^2 per m^2], the second
    derivatives along M orthonormal moves ``across`` (2 K, M) of the control points.

    ``cloth`` (M,) and ``tolerance_m`` [m] are taken over as they are (``Identifiability``).
    """
    value, vector = np.linalg.eigh(0.5 * (curvature + curvature.T))
    value = np.maximum(value, BLIND * max(float(value.max()), 1e-300))
    modes = (across @ vector).T.reshape(len(value), -1, 2)
    # y^T C y / 4 <= tolerance^2 is an ellipsoid; a point's farthest move in it is a largest singular value.
    reach = 2.0 * tolerance_m * modes / np.sqrt(value)[:, None, None]
    slack = np.linalg.svd(reach.transpose(1, 2, 0), compute_uv=False)[:, 0]
    return Identifiability(cloth, 0.5 * np.sqrt(value), modes, np.minimum(slack, CAP_M), tolerance_m)


def corner_names(pattern: Pattern) -> list[str]:
    """Returns a name for every corner of ``pattern``, panel by panel in the order of edges: panel, place in it, and the
    edges that meet there."""
    partner = {}
    for stitch in pattern.stitches:
        partner[stitch.first], partner[stitch.second] = stitch.second, stitch.first

    def edge_name(ref: EdgeRef) -> str:
        label = pattern.panel(ref.panel).edges[ref.edge].label
        if label:
            return label
        return f"seam to {partner[ref].panel}" if ref in partner else "open edge"

    names = []
    for panel in pattern.panels:
        count = len(panel.edges)
        low, size = panel.vertices.min(axis=0), np.ptp(panel.vertices, axis=0)
        for number, edge in enumerate(panel.edges):
            across, up = (panel.vertices[edge.start] - low) / size
            where = f"{('bottom', 'middle', 'top')[_third(up)]} {('left', 'middle', 'right')[_third(across)]}"
            before, after = (edge_name(EdgeRef(panel.name, n % count)) for n in (number - 1, number))
            edges = before if before == after else f"{before}, {after}"
            names.append(f"{panel.name}, {where} ({edges})")
    return names


def _third(share: float) -> int:
    return min(2, int(3.0 * share))


def weak_words(limits: Identifiability, pattern: Pattern) -> list[str]:
    """Returns a sentence on each of the ``WEAKEST`` shapes that the target shows least."""
    names = corner_names(pattern)
    sentences = []
    for gain, mode in list(zip(limits.seen, limits.modes, strict=True))[:WEAKEST]:
        size = np.linalg.norm(mode, axis=1)
        others = int((size > 0.5 * size.max()).sum()) - 1
        company = f", {others} other corners going along by more than half as much" if others else ""
        # A step that moves the farthest corner by a centimetre.
        sentences.append(
            f"10 mm at {names[int(size.argmax())]}{company}: what the target shows changes by "
            f"{10.0 * gain / size.max():.2f} mm."
        )
    return sentences
