"""Fits shape and pose of the standard body inside a garment that came without one.

No skin lies outside the cloth, and it touches the cloth at the shoulders or the waist, from which the garment hangs.
Gauss-Newton on distances along the skin's normals: cloth inside the body costs in full, cloth outside less the farther
it is. Priors keep what the garment does not tell near the mean shape and the T-pose. Openings tell where limbs are: a
bone goes through the middle of a cuff.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.garment.contours import LIMBS, TRUNK, Contour, bone_chains, borders, open_contours, plainly_opening
from drape.garment.files.mesh import GarmentMesh
from drape.garment.registration import FREE_JOINTS, parameter_jacobian, posed_by, posed_normals, unpack_parameters

BAND_M = 0.15  # a garment hangs on the body in this band at its top; shipped ones lie 7 to 10 mm from the skin there
BAND_PULL = 4.0  # pull of cloth outside the skin in that band, over that of other cloth outside
LYING_GAP_M = 0.004  # distance from the skin of cloth that lies on it
LYING_SHARE, LYING_MOST_M, LOCK_REACH_M = 0.4, 0.008, 0.006
PULL, PULL_REACH_M = 0.1, 0.03  # pull of cloth outside, over that of cloth inside; it is half at that distance
CUFF = 0.2  # cost of the squared distance between a cuff's middle and the limb's bone
SHAPE_PRIOR_M, POSE_PRIOR_M, LIMB_PRIOR_M = 1e-3, 1.5e-2, 3e-3  # root of the cost of one beta, and of one radian
LIMB_JOINTS = ("collar", "shoulder", "elbow", "hip", "knee")  # a sleeve without an elbow would go through its arm
ROOT_PRIOR_M = 0.03
PLACE_PRIOR_M = np.full(3, 1e-4)
FLOOR = 0.05  # cost of the squared distance between the sole and the floor
STEPS = 25
AGREEMENT = 0.2

Cuffs = list[tuple[np.ndarray, int, int]]  # middles [m] (3,) of cuffs, and the joints at the ends of their bones


def tube_ends(mesh: GarmentMesh) -> list[Contour]:
    """Returns the closed borders of ``mesh`` at which the cloth looks sideways, as at a cuff; the most sideways first.
    The mesh is in metres."""
    flatness = {one.loop.tobytes(): one.flatness for one in borders(mesh) if plainly_opening(one)}
    ends = [one for one in open_contours(mesh.vertices, mesh.faces) if one.loop.tobytes() in flatness]
    return sorted(ends, key=lambda one: flatness[one.loop.tobytes()])


def fit_from(
    body: BodyModel,
    points: np.ndarray,
    normals: np.ndarray,
    contours: list[Contour],
    parameters: np.ndarray,
    steps: int,
    *,
    likely: np.ndarray | None = None,
    shape_prior_m: float | np.ndarray = SHAPE_PRIOR_M,
    slack: float = 1.0,
    place_prior_m: np.ndarray = PLACE_PRIOR_M,
    sole: int | None = None,
    lock: float = 0.0,
) -> tuple[np.ndarray, float]:
    """Returns the parameters (P,) of ``body``, as in ``unpack_parameters``, after at most ``steps`` steps of
    Gauss-Newton from ``parameters``; and the cost [m^2] before the last step. The cost is the mean over the cloth of
    weight times gap squared, plus priors and the cost of cuffs. A gap [m] is a point's distance from the skin minus
    ``LYING_GAP_M``. Negative gaps weigh 1. The weight of positive ones is their pull: ``PULL`` or less, the less the
    larger the gap is.

    The cloth: ``points`` [m] (N, 3), y up, their ``normals`` (N, 3), and ``contours`` that limbs pass through.
    ``likely`` (P,): the parameters that priors draw towards; by default the mean shape in T-pose at the start's
    translation. ``shape_prior_m`` and ``place_prior_m`` (3,) [m]: root of the cost of one beta, and of one metre of
    translation. The vertex ``sole`` is drawn to the floor y = 0.

    The band is the cloth at most ``BAND_M`` below the top, on which the garment hangs: its pull is ``BAND_PULL`` times
    as large, that of other cloth ``slack`` times. A ``lock`` above 0 keeps the skin under cloth that lies on it. Then
    ``LYING_GAP_M`` grows to the ``LYING_SHARE`` quantile of distances in the band, by at most ``LYING_MOST_M``, and no
    weight is below ``lock`` / (1 + (gap / ``LOCK_REACH_M``)^2)^2.
    """
    cuffs = _cuffs(body, contours, parameters)
    if likely is None:
        likely = np.concatenate([np.zeros(len(parameters) - 3), parameters[-3:]])
    prior = _prior(body, shape_prior_m, place_prior_m)
    fit = _Fit(body, points, normals, cuffs, prior, likely, slack, sole, lock)
    cost = np.inf
    for _ in range(steps):
        before = cost
        cost, change = fit.step(parameters)
        parameters = parameters + np.clip(change, -0.3, 0.3)
        if np.abs(change).max() < 1e-4 or abs(before - cost) < 1e-10:
            break
    return parameters, cost


def _prior(body: BodyModel, shape_prior_m: float | np.ndarray, place_prior_m: np.ndarray) -> np.ndarray:
    """What the square of each parameter's way from the likely one costs (P,) [m^2]."""
    shape, pose = body.shape_count, 3 * len(FREE_JOINTS)
    prior = np.concatenate([np.full(shape, shape_prior_m), np.full(pose, POSE_PRIOR_M), place_prior_m]) ** 2
    for number, joint in enumerate(FREE_JOINTS):
        if JOINT_NAMES[joint].partition("_")[2] in LIMB_JOINTS:
            prior[shape + 3 * number : shape + 3 * number + 3] = LIMB_PRIOR_M**2
    prior[shape : shape + 3] = ROOT_PRIOR_M**2
    return prior


class _Fit(NamedTuple):
    """What ``fit_from`` makes least, with its arguments; ``cuffs`` as ``_cuffs`` finds them."""

    body: BodyModel
    points: np.ndarray
    normals: np.ndarray
    cuffs: Cuffs
    prior: np.ndarray
    likely: np.ndarray
    slack: float
    sole: int | None
    lock: float

    def step(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """The cost [m^2] of ``parameters`` and the change (P,) that a step of Gauss-Newton makes."""
        posed = posed_by(self.body, parameters)
        index, normal = self._skin(posed)
        gap, weight = self._gaps(normal, posed[index])
        off, turn = _cuff_rows(self.body, self.cuffs, parameters)
        away = parameters - self.likely
        cost = float((weight * gap**2).mean() + self.prior @ away**2 + CUFF * (off**2).sum())
        rows = np.einsum("nc,ncp->np", normal, parameter_jacobian(self.body, parameters, index))
        weighted = (rows * weight[:, None]).T / len(rows)
        system = weighted @ rows + np.diag(self.prior + 1e-8) + CUFF * turn.T @ turn
        slope = weighted @ gap - self.prior * away - CUFF * turn.T @ off
        if self.sole is not None:
            row = parameter_jacobian(self.body, parameters, np.array([self.sole]))[0, 1]
            system, slope = system + FLOOR * np.outer(row, row), slope - FLOOR * posed[self.sole, 1] * row
        return cost, np.linalg.solve(system, slope)

    def _skin(self, posed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The vertex of the skin under each point (N,): of the nearest the first that looks its way; its normal."""
        skin_normals = posed_normals(self.body, posed)
        near = np.asarray(KDTree(posed).query(self.points, k=6)[1])
        agree = np.einsum("nc,nkc->nk", self.normals, skin_normals[near]) > AGREEMENT
        index = near[np.arange(len(near)), np.argmax(agree, axis=1)]
        return index, skin_normals[index]

    def _gaps(self, normal: np.ndarray, under: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far [m] (N,) the cloth is from lying on the skin ``under`` it, and how much that counts (N,)."""
        band = self.points[:, 1] > self.points[:, 1].max() - BAND_M
        gap = np.einsum("nc,nc->n", normal, self.points - under) - LYING_GAP_M
        if self.lock:
            gap -= np.clip(np.quantile(gap[band], LYING_SHARE), 0.0, LYING_MOST_M)
        pull = PULL * np.where(band, BAND_PULL, self.slack)
        weight = np.where(gap < 0.0, 1.0, pull / (1.0 + (gap / PULL_REACH_M) ** 2))
        return gap, np.maximum(weight, self.lock / (1.0 + (gap / LOCK_REACH_M) ** 2) ** 2)


def _cuffs(body: BodyModel, contours: list[Contour], parameters: np.ndarray) -> Cuffs:
    """Middles [m] (3,) of the openings that lie nearer to a limb than to the trunk at the start, with the bone.

    Arms and feet may be elsewhere than at the start; thighs are not, so what lies beside one is a pocket.
    Each limb has one at most, the first of ``contours``.
    """
    betas, pose, trans = unpack_parameters(body, parameters)
    joints = body.posed_joints(pose[None], betas)[0] + trans
    number = {name: joint for joint, name in enumerate(JOINT_NAMES)}
    trunk = bone_chains(joints)[TRUNK][0]
    cuffs, parts = [], set()
    for contour in contours:
        limbs = [
            (float(np.linalg.norm(_perpendicular(contour.centre, joints[a], joints[b]))), a, b, part)
            for part, names in LIMBS.items()
            if part not in parts
            for a, b in pairwise([number[n] for n in names])
            if JOINT_NAMES[a].partition("_")[2] != "collar"
        ]
        if not limbs:
            break
        near, a, b, part = min(limbs)
        inner = min(float(np.linalg.norm(_perpendicular(contour.centre, *bone))) for bone in pairwise(trunk))
        beside = JOINT_NAMES[a].endswith("hip") and near > contour.length_m / (2.0 * np.pi)
        if near < inner and not beside:
            cuffs.append((contour.centre, a, b))
            parts.add(part)
    return cuffs


def _perpendicular(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The way (..., 3) from ``point`` (3,) to the nearest point of a bone from ``start`` (..., 3) to ``end``."""
    way = end - start
    share = np.clip(((point - start) * way).sum(axis=-1) / (way * way).sum(axis=-1), 0.0, 1.0)
    return start + share[..., None] * way - point


def _cuff_rows(body: BodyModel, cuffs: Cuffs, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ways [m] (3 C,) from the cuffs' middles to their bones, and the derivative (3 C, P) by forward differences."""
    if not cuffs:
        return np.zeros(0), np.zeros((0, len(parameters)))
    step = 1e-5
    moved = np.concatenate([parameters[None], parameters + step * np.eye(len(parameters))])
    poses = np.zeros((len(moved), JOINT_COUNT, 3))
    poses[:, FREE_JOINTS] = moved[:, body.shape_count : -3].reshape(len(moved), -1, 3)
    joints = body.posed_joints(poses, moved[:, : body.shape_count]) + moved[:, None, -3:]
    ways = np.concatenate([_perpendicular(centre, joints[:, a], joints[:, b]) for centre, a, b in cuffs], axis=1)
    return ways[0], (ways[1:] - ways[0]).T / step
