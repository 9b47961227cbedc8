"""Linear blend skinning that comes nearest to given frames: sparse weights and rigid motions, by turns.

A vertex v of the mesh p is at y_fv = sum_b w_vb T_fb p_v in frame f. Given x_fv, the sum of |x_fv - y_fv|^2 is lowered
by exact steps, over the weights of each vertex (at most a few, none negative, their sum one) and over each bone's rigid
motion, the others as they are: smooth skinning decomposition with rigid bones (Le and Deng 2012). So it never grows.
Bones that are given, as those of a skeleton, keep their motions and take part in the weights.

Motions T are (F, B, 3, 4). Frames should count from something that moves along: sums of squares lose digits far away.
"""

from __future__ import annotations

import numpy as np

from drape.avatar.affine_maps import rigid_fit

SINGULAR = 1e-12  # This share of the mean square is added to weights' squares, so that equal bones share a vertex.
FRAMES_AT_ONCE = 16
CLUSTER_ROUNDS = 8


def blend_vertices(weights: np.ndarray, rest: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Returns the vertices (F, V, 3) that linear blend skinning makes of ``rest`` (V, 3) with ``weights`` (V, B) on
    bones whose motions are ``moves`` (F, B, 3, 4)."""
    flat, points = moves.reshape(*moves.shape[:2], 12), homogeneous(rest)
    positions = np.empty((len(moves), len(rest), 3))
    for start in range(0, len(moves), FRAMES_AT_ONCE):
        part = slice(start, start + FRAMES_AT_ONCE)
        blends = (weights @ flat[part]).reshape(-1, len(rest), 3, 4)
        positions[part] = np.einsum("fvab,vb->fva", blends, points)
    return positions


def homogeneous(points: np.ndarray) -> np.ndarray:
    """Returns the homogeneous coordinates (N, 4) of ``points`` (N, 3), the one last."""
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def fit_weights(
    rest: np.ndarray,
    frames: np.ndarray,
    moves: np.ndarray,
    candidates: np.ndarray,
    *,
    most: int,
    past: np.ndarray | None = None,
    pull: np.ndarray | None = None,
    stiffness: float = 0.0,
) -> np.ndarray:
    """Returns the weights (V, B) of bones with the motions ``moves`` (F, B, 3, 4) that bring ``rest`` (V, 3) nearest to
    ``frames`` (F, V, 3). They are not negative and sum to one, and at most ``most`` of a vertex are above zero.

    A vertex may have the bones ``candidates`` (V, C). Where these bring it no nearer than the bones of ``past`` weights
    (V, B), it keeps the latter. ``stiffness``, in squared length a frame, is what the square of a weight's difference
    from ``pull`` (V, B) costs, beside the squared distances.
    """
    count, bones = len(rest), moves.shape[1]
    squares = np.einsum("fbai,fcaj->bcij", moves, moves, optimize=True) / len(frames)
    towards = moves.transpose(1, 3, 0, 2).reshape(bones * 4, -1) @ frames.transpose(0, 2, 1).reshape(-1, count)
    points, weights = homogeneous(rest), np.zeros((count, bones))
    towards = np.einsum("biv,vi->vb", towards.reshape(bones, 4, count), points) / len(frames)
    for start in range(0, count, 512):
        rows = slice(start, start + 512)
        own, p = candidates[rows], points[rows]
        gram = np.einsum("vcdij,vi,vj->vcd", squares[own[:, :, None], own[:, None, :]], p, p, optimize=True)
        right = np.take_along_axis(towards[rows], own, axis=1)
        if pull is not None:
            gram += stiffness * np.eye(own.shape[1])
            right = right + stiffness * np.take_along_axis(pull[rows], own, axis=1)
        stays = None if past is None else np.take_along_axis(past[rows], own, axis=1) > 0.0
        weights[np.arange(count)[rows, None], own] = better_fit(gram, right, most, stays)
    return weights


def better_fit(gram: np.ndarray, right: np.ndarray, most: int, stays: np.ndarray | None) -> np.ndarray:
    """Returns the weights (N, C) of the lower cost, row by row, of two results of ``simplex_fit``: that of all weights,
    and that in which only the weights ``stays`` (N, C) bool may be above zero. Without ``stays`` it is the first."""
    fitted = simplex_fit(gram, right, most)
    if stays is None:
        return fitted
    again = simplex_fit(gram, right, most, stays)
    costs = [np.einsum("vc,vcd,vd->v", one, 0.5 * gram, one) - (one * right).sum(axis=1) for one in (fitted, again)]
    return np.where((costs[0] < costs[1])[:, None], fitted, again)


def simplex_fit(gram: np.ndarray, right: np.ndarray, most: int, stays: np.ndarray | None = None) -> np.ndarray:
    """Returns the weights w (N, C) that minimise w.Gw / 2 - w.h in each row, for ``gram`` G (N, C, C) and ``right`` h
    (N, C). They are not negative and sum to one, and at most ``most`` of a row are above zero: of those ``stays``
    (N, C) bool, all by default.

    The minimum is approximate. Weights leave one after the other: the most negative one, else the one whose absence
    costs least, which is w^2 over its variance. None comes back.
    """
    count, size = right.shape
    gram = gram + SINGULAR * np.trace(gram, axis1=1, axis2=2)[:, None, None] / size * np.eye(size)
    stays = np.ones((count, size), dtype=bool) if stays is None else stays.copy()
    weights = np.zeros((count, size))
    open_rows = np.arange(count)
    while len(open_rows):
        own = stays[open_rows]
        inverse = _inverse(gram[open_rows], own)
        sides = np.concatenate([np.where(own, right[open_rows], 0.0), np.ones((len(own), 1))], axis=1)
        solved = np.einsum("vij,vj->vi", inverse, sides)[:, :size]
        solved[~own] = np.inf
        variance = np.where(own, inverse[:, range(size), range(size)], 1.0)
        cost = solved**2 / np.maximum(variance, SINGULAR)
        negative = (solved < 0.0).any(axis=1)
        leaves = np.where(negative, solved.argmin(axis=1), np.where(own, cost, np.inf).argmin(axis=1))
        goes = negative | (own.sum(axis=1) > most)
        weights[open_rows] = np.where(own, solved, 0.0)
        open_rows, leaves = open_rows[goes], leaves[goes]
        stays[open_rows, leaves] = False
    return weights


def _inverse(gram: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Inverses (N, C + 1, C + 1) of the equations of minima whose weights sum to one, of the bones that are ``own``."""
    size = gram.shape[1]
    whole = np.zeros((len(gram), size + 1, size + 1))
    whole[:, :size, :size] = np.where(own[:, :, None] & own[:, None, :], gram, 0.0)
    whole[:, range(size), range(size)] += ~own
    scale = np.einsum("vii->v", whole[:, :size, :size]) / size
    whole[:, :size, size] = whole[:, size, :size] = own * scale[:, None]
    inverse = np.linalg.inv(whole)
    inverse[:, :, size] *= scale[:, None]
    return inverse


def fit_moves(
    weights: np.ndarray,
    rest: np.ndarray,
    frames: np.ndarray,
    moves: np.ndarray,
    free: np.ndarray,
    *,
    rounds: int = 1,
    steadiness: float = 0.0,
) -> np.ndarray:
    """Returns the motions ``moves`` (F, B, 3, 4) of all bones with new ones of the ``free`` bones (n,): rigid ones that
    bring ``rest`` (V, 3) with ``weights`` (V, B) nearest to ``frames`` (F, V, 3), one bone after the other, ``rounds``
    times.

    ``steadiness``: a new motion is fitted to ``frames`` with weight 1, and with this weight to where ``moves`` carries
    the bone's vertices.
    """
    first, moves = moves, moves.copy()
    left = frames - blend_vertices(weights, rest, moves)
    points = homogeneous(rest)
    for _ in range(rounds):
        for bone in free:
            rows = np.flatnonzero(weights[:, bone])
            share, own = weights[rows, bone], points[rows]
            at = left[:, rows] + share[:, None] * (own @ moves[:, bone].swapaxes(-1, -2))
            targets = at / share[:, None]
            if steadiness > 0.0:  # Two targets of one point count as their weighted mean.
                targets = (targets + steadiness * (own @ first[:, bone].swapaxes(-1, -2))) / (1.0 + steadiness)
            if len(rows):
                moves[:, bone] = rigid_fit(rest[rows], targets, share**2)
                left[:, rows] = at - share[:, None] * (own @ moves[:, bone].swapaxes(-1, -2))
    return moves


def rigid_clusters(
    rest: np.ndarray, frames: np.ndarray, count: int, *, nearness: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the cluster (V,) of each vertex, and the rigid motions (F, ``count``, 3, 4) of the clusters that bring
    ``rest`` (V, 3) nearest to ``frames`` (F, V, 3).

    Seeds are points of ``rest`` far from each other; then clusters and motions are found by turns. ``nearness``: what
    the squared distance from a cluster's middle costs, where the squared distance from ``frames`` costs 1.
    """
    points, middles = homogeneous(rest), rest[farthest_points(rest, count)]
    own = ((rest[:, None] - middles) ** 2).sum(axis=-1).argmin(axis=1)
    for last in range(CLUSTER_ROUNDS, -1, -1):
        moves = np.stack([rigid_fit(rest[own == one], frames[:, own == one]) for one in range(count)], axis=1)
        if not last:
            break
        middles = np.stack([rest[own == one].mean(axis=0) for one in range(count)])
        cost = nearness * ((rest[:, None] - middles) ** 2).sum(axis=-1)
        for bone in range(count):
            cost[:, bone] += ((points @ moves[:, bone].swapaxes(-1, -2) - frames) ** 2).sum(axis=-1).mean(axis=0)
        nearest = cost.argmin(axis=1)
        kept = np.bincount(nearest, minlength=count) >= 3  # Fewer than three vertices do not determine a motion.
        own = np.where(kept[nearest] & kept[own], nearest, own)
    return own, moves


def farthest_points(points: np.ndarray, count: int) -> np.ndarray:
    """Returns the indices (``count``,) of ``points`` (N, 3) that lie far from each other: the farthest from the mean,
    then each the farthest from those before."""
    rows = [int(((points - points.mean(axis=0)) ** 2).sum(axis=1).argmax())]
    near = np.full(len(points), np.inf)
    while len(rows) < count:
        near = np.minimum(near, ((points - points[rows[-1]]) ** 2).sum(axis=1))
        rows.append(int(near.argmax()))
    return np.array(rows)
