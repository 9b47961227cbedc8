"""The formulas of the local solver once more, in NumPy float64, to be read and compared with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drape.cloth.problem import Problem
from drape.exact.surroundings import Around


class Terms(NamedTuple):
    """Of n elements with c corners: ``energy`` [J] (n,), ``gradient`` [N] (n, c, 3), and for every corner the positive
    Hessian block [N/m] ``block`` (n, c, 3, 3) that a sweep solves with."""

    energy: np.ndarray
    gradient: np.ndarray
    block: np.ndarray


def triangles(problem: Problem, x: np.ndarray, which: np.ndarray) -> Terms:
    """Membrane of the triangles ``which`` (n,): Green's strain E = (F^T F - I) / 2, St.Venant-Kirchhoff.

    Block: derivative of the strains times the material, and the stress along the corner's slope where it pulls.
    """
    k, t = problem.constants, problem.triangles
    corner, area = t.corner[which], t.area[which]
    a, b, c, d = t.inverse[which].T
    slope = np.stack([np.stack([-a - b, -c - d], 1), np.stack([a, c], 1), np.stack([b, d], 1)], 1)  # (n, corner, axis)
    f = np.einsum("nci,nca->nia", x[corner], slope)  # columns: along the warp, along the weft
    excess = np.einsum("nia,nib->nab", f, f) - np.eye(2)
    e = np.stack([excess[:, 0, 0], excess[:, 1, 1], excess[:, 0, 1]], axis=1)  # twice the strain, but for its shear
    material = np.array([[k.warp, k.cross, 0.0], [k.cross, k.weft, 0.0], [0.0, 0.0, k.shear]])
    s = area[:, None] * (e @ material)
    energy = 0.25 * (s[:, 0] * e[:, 0] + s[:, 1] * e[:, 1]) + 0.5 * s[:, 2] * e[:, 2]
    stress = np.stack([np.stack([s[:, 0], s[:, 2]], 1), np.stack([s[:, 2], s[:, 1]], 1)], 1)
    gradient = np.einsum("nca,nab,nib->nci", slope, stress, f)
    p, q = slope[..., 0, None], slope[..., 1, None]
    along, across = f[:, None, :, 0], f[:, None, :, 1]
    strains = np.stack([2.0 * p * along, 2.0 * q * across, p * across + q * along], axis=-1)  # (n, c, 3, 3 strains)
    weights = area[:, None, None] * np.diag([0.5, 0.5, 1.0]) @ material
    pull = np.maximum(np.einsum("nca,nab,ncb->nc", slope, stress, slope), 0.0)
    block = np.einsum("ncis,nst,ncjt->ncij", strains, weights, strains) + pull[..., None, None] * np.eye(3)
    return Terms(energy, gradient, block)


def hinges(problem: Problem, x: np.ndarray, which: np.ndarray) -> Terms:
    """Bending k (1 - cos(theta - theta0)) of the hinges ``which`` (n,), lengths in mean edges for the guard.

    Block: k g g^T, g the derivative of the angle by the corner.
    """
    k, h = problem.constants, problem.hinges
    xi, xj, xk, xl = np.moveaxis(x[h.corner[which]], 1, 0) * k.per_edge
    cosine, sine, stiffness = h.cosine[which], h.sine[which], h.stiffness[which]
    e, a, b = xj - xi, xk - xi, xl - xi
    n1, n2 = np.cross(e, a), np.cross(b, e)
    q1, q2 = _dot(n1, n1), _dot(n2, n2)
    size, length = np.sqrt(q1 * q2 + k.degenerate), np.sqrt(_dot(e, e) + k.degenerate)
    rise = _dot(n1, b)
    value = cosine * _dot(n1, n2) - sine * length * rise
    energy = stiffness * (1.0 - value / size)
    # d(1 - value / size), value and size through n1, n2 and directly through e and b.
    by_n1 = _times(-cosine / size, n2) + _times(sine * length / size, b) + _times(value * q2 / size**3, n1)
    by_n2 = _times(-cosine / size, n1) + _times(value * q1 / size**3, n2)
    by_e = np.cross(a, by_n1) + np.cross(by_n2, b) + _times(sine * rise / (size * length), e)
    by_a, by_b = np.cross(by_n1, e), np.cross(e, by_n2) + _times(sine * length / size, n1)
    fold = k.per_edge * np.stack([-by_e - by_a - by_b, by_e, by_a, by_b], axis=1)
    over1, over2 = k.per_edge / (q1 + k.degenerate), k.per_edge / (q2 + k.degenerate)
    along1, along2 = _dot(a, e) / length, _dot(b, e) / length
    turn = np.stack(
        [
            _times((length - along1) * over1, n1) + _times((length - along2) * over2, n2),
            _times(along1 * over1, n1) + _times(along2 * over2, n2),
            _times(-length * over1, n1),
            _times(-length * over2, n2),
        ],
        axis=1,
    )
    block = stiffness[:, None, None, None] * turn[..., :, None] * turn[..., None, :]
    return Terms(energy, stiffness[:, None, None] * fold, block)


def outside(problem: Problem, around: Around, x: np.ndarray, which: np.ndarray) -> Terms:
    """Weight, contact with the body's planes and springs of the vertices ``which`` (n,); one corner each."""
    k, p = problem.constants, x[which]
    weight = problem.weight_n[which]
    energy, gradient = weight * p[:, 1], weight[:, None] * np.array([0.0, 1.0, 0.0])
    block = np.zeros((len(which), 3, 3))
    n, s = around.normal[which], problem.contact_n_per_m[which]
    depth = np.maximum(k.gap - _dot(p - around.point[which], n), 0.0)
    energy = energy + 0.5 * s * depth**2
    gradient = gradient - _times(s * depth, n)
    block += (s * (depth > 0.0))[:, None, None] * n[:, :, None] * n[:, None, :]
    springs = ((around.target, around.target_n_per_m, 0.0), (around.band, around.band_n_per_m, k.slack))
    for anchor, stiffness, slack in springs:
        way, s = p - anchor[which], stiffness[which]
        length = np.maximum(np.sqrt(_dot(way, way)), 1e-300)
        past = np.maximum(length - slack, 0.0)
        energy = energy + 0.5 * s * past**2
        gradient = gradient + _times(s * past / length, way)
        unit = _times(1.0 / length, way)
        lost = s * (past > 0.0) * slack / length
        block += (s * past / length)[:, None, None] * np.eye(3)
        block += lost[:, None, None] * unit[:, :, None] * unit[:, None, :]
    return Terms(energy, gradient[:, None], block[:, None])


def energy_and_gradient(x: np.ndarray, problem: Problem, around: Around) -> tuple[float, np.ndarray]:
    """Energy [J] at ``x`` [m] (V, 3) and its gradient [N] (V, 3)."""
    everything = [
        (problem.triangles.corner, triangles(problem, x, np.arange(len(problem.triangles.corner)))),
        (problem.hinges.corner, hinges(problem, x, np.arange(len(problem.hinges.corner)))),
        (np.arange(len(x))[:, None], outside(problem, around, x, np.arange(len(x)))),
    ]
    gradient = np.zeros_like(x)
    for corner, terms in everything:
        np.add.at(gradient, corner, terms.gradient)
    return float(sum(terms.energy.sum() for _, terms in everything)), gradient


def vertex_block(v: int, x: np.ndarray, problem: Problem, around: Around) -> tuple[np.ndarray, np.ndarray]:
    """Gradient [N] (3,) and positive Hessian block [N/m] (3, 3) of vertex ``v``."""
    gradient, block = np.zeros(3), np.zeros((3, 3))
    for corner, terms in ((problem.triangles.corner, triangles), (problem.hinges.corner, hinges)):
        element, place = np.nonzero(corner == v)
        found = terms(problem, x, element)
        each = np.arange(len(element))
        gradient += found.gradient[each, place].sum(axis=0)
        block += found.block[each, place].sum(axis=0)
    own = outside(problem, around, x, np.array([v]))
    return gradient + own.gradient[0, 0], block + own.block[0, 0] + problem.constants.least * np.eye(3)


def sweep(x: np.ndarray, problem: Problem, around: Around) -> np.ndarray:
    """One unguarded sweep of vertex block descent from ``x`` [m] (V, 3), vertices in the order of their colours."""
    moved = x.copy()
    for v in problem.order:
        gradient, block = vertex_block(v, moved, problem, around)
        step = -np.linalg.solve(block, gradient)
        length = np.linalg.norm(step)
        moved[v] += step * min(1.0, problem.constants.reach / max(length, 1e-300))
    return moved


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=-1)


def _times(scalar: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return scalar[:, None] * vector
