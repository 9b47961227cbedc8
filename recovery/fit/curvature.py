"""The Gauss-Newton matrix of the loss: its second derivative by the unknowns, with residuals linear in the drape.

A nearest point follows along a surface, so only motion along the normal counts; at a border only motion across it.
"""

from __future__ import annotations

import numpy as np
import torch

from drape.geometry import closest, meshes
from recovery.fit.objective import CORNERS, Objective, on_line


def gauss_newton_matrix(objective: Objective, x: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Returns the matrix (Z, Z) [m^2 per m^2] of second derivatives of the loss by the Z unknowns, at nodes ``x`` [m]
    (N, 3). ``moves`` (N, 3, Z) are the derivatives of the nodes."""
    faces, target = objective.mesh.faces, objective.target
    points = (CORNERS @ x[faces]).reshape(-1, 3)
    there = closest.closest_point(points, target.vertices, target.faces)
    kappa = target.weights_at(there)
    normal = meshes.face_normals(target.vertices, target.faces)[there.face]
    along = np.einsum("qc,fcdz->fqdz", CORNERS, moves[faces]).reshape(len(points), 3, -1)
    total = _normal_part(along, _across(normal, points - there.point, there, target.faces), objective.shares * kappa)
    here = closest.closest_point(target.points, x, faces)
    normal = meshes.face_normals(x, faces)[here.face]
    along = np.einsum("nc,ncdz->ndz", here.barycentric, moves[faces[here.face]])
    total = total + _normal_part(along, _across(normal, target.points - here.point, here, faces), target.shares)
    for loop, line in objective.pairs:
        total = total + _contour_part(x[loop], line, moves[loop]) / len(objective.pairs)
    return total


def _across(normal: np.ndarray, offset: np.ndarray, found: closest.ClosestPoints, faces: np.ndarray) -> np.ndarray:
    """The direction (n, 3) of each distance: the normal, beyond a border that of the offset."""
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    beyond = closest.on_border(found, faces)[:, None] & (length > 1e-9)
    return np.where(beyond, offset / np.maximum(length, 1e-30), normal)


def _normal_part(along: np.ndarray, direction: np.ndarray, shares: np.ndarray) -> np.ndarray:
    rows = np.einsum("nd,ndz->nz", direction, along)
    return 2.0 * (rows * shares[:, None]).T @ rows


def _contour_part(points: np.ndarray, line: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Second derivative of ``polyline_chamfer`` by moves (n, 3, Z) of the first line."""
    following, later = np.roll(points, -1, axis=0), np.roll(moves, -1, axis=0)
    total = np.zeros((moves.shape[2],) * 2)
    own, other = torch.from_numpy(np.ascontiguousarray(points)), torch.from_numpy(np.ascontiguousarray(line))
    length = np.linalg.norm(following - points, axis=1)
    samples, shares, best, _ = on_line(own, other)
    share = np.linalg.norm(samples.numpy() - np.concatenate([points, points]), axis=1) / np.concatenate(
        [length, length]
    )
    share = share[:, None, None]
    along = (1.0 - share) * np.concatenate([moves, moves]) + share * np.concatenate([later, later])
    total += _cross_part(along, np.roll(line, -1, axis=0)[best.numpy()] - line[best.numpy()], shares.numpy())
    _, shares, best, t = on_line(other, own)
    at, t = best.numpy(), t.numpy()[:, None, None]
    along = (1.0 - t) * moves[at] + t * later[at]
    return total + _cross_part(along, following[at] - points[at], shares.numpy())


def _cross_part(along: np.ndarray, way: np.ndarray, shares: np.ndarray) -> np.ndarray:
    unit = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-30)
    rows = along - unit[:, :, None] * np.einsum("nd,ndz->nz", unit, along)[:, None]
    return 2.0 * np.einsum("n,ndz,ndy->zy", shares, rows, rows)
