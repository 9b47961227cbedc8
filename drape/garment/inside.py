"""Fits shape and pose of the standard body inside a garment that came without one.

No skin lies outside the cloth, and it touches the cloth at the shoulders or the waist, from which the garment hangs.
Gauss-Newton on distances along the skin's normals: cloth inside the body costs in full, cloth outside less the farther
it is. Priors keep what the garment does not tell near the mean shape and the T-pose. Openings tell where limbs are: a
bone goes through the middle of a cuff.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES
from drape.errors import BodyError
from drape.garment.borders import borders, plainly_opening
from drape.garment.contours import LIMBS, TRUNK, Contour, bone_chains, open_contours
from drape.garment.files.mesh import GarmentMesh
from drape.garment.registration import (
    ARM_LIFTS_RAD,
    FREE_JOINTS,
    parameter_jacobian,
    posed_by,
    posed_normals,
    start_parameters,
    unpack,
)
from drape.geometry import closest, meshes

BAND_M = 0.15  # from the top of a garment: there it hangs on the body; all of ours lie 7 to 10 mm from the skin
BAND_PULL = 4.0  # of cloth outside in that band, against other cloth outside
BAND_LIMIT_MM = 25.0  # median distance in that band: beyond, the body is beside the garment
RISES_M = (-0.08, 0.0, 0.08)  # of the body, that are tried
FIRST_STEPS, FINALISTS = 6, 2  # of every start, and how many of them go on
LYING_GAP_M = 0.004  # between skin and cloth that lies on it
LYING_SHARE, LYING_MOST_M, LOCK_REACH_M = 0.4, 0.008, 0.006
PULL, PULL_REACH_M = 0.1, 0.03  # of cloth outside, against cloth inside; halved at that distance
CUFF = 0.2  # of a square metre between a cuff's middle and the limb's bone
SHAPE_PRIOR_M, POSE_PRIOR_M, LIMB_PRIOR_M = 1e-3, 1.5e-2, 3e-3  # root mean square that a beta, or a radian, is worth
LIMB_JOINTS = ("collar", "shoulder", "elbow", "hip", "knee")  # a sleeve without an elbow would go through its arm
ROOT_PRIOR_M = 0.03
PLACE_PRIOR_M = np.full(3, 1e-4)
FLOOR = 0.05  # of a square metre between the sole and the floor
POINT_COUNT = 1200
STEPS = 25
AGREEMENT = 0.2
INSIDE_LIMIT_PCT = 15.0  # of the cloth inside the best body: none of ours fits

Cuffs = list[tuple[np.ndarray, int, int]]  # middles [m] (3,) of cuffs, and the joints at the ends of their bones


class InsideFit(NamedTuple):
    """Shape ``betas`` (S,), ``pose`` (24, 3) [rad], ``trans`` [m] (3,); how the garment then lies on the skin.

    ``mean_mm``: mean distance of the cloth from the skin; ``inside_pct`` of it is inside, by ``depth_mm`` at the 95th
    percentile of that part. ``band_mm`` is the median distance where the garment hangs, in its uppermost 15 cm.
    ``cost_m2`` is what the fit made least.
    """

    betas: np.ndarray
    pose: np.ndarray
    trans: np.ndarray
    mean_mm: float
    inside_pct: float
    depth_mm: float
    band_mm: float
    cost_m2: float


def fit_inside(
    mesh: GarmentMesh,
    body: BodyModel,
    *,
    top_m: float,
    wanted: dict[str, int] | None = None,
    tick: Callable[[str], None] = lambda words: None,
) -> InsideFit:
    """The standard body inside the garment ``mesh`` [m], y up, worn facing +z.

    ``top_m`` is the height on the body in its own frame at which such a garment begins; ``wanted`` are the openings
    round each part of the body that its kind has. ``tick`` hears how far it is.
    """
    points, normals = _sample(mesh.vertices, mesh.faces)
    low, high = points.min(axis=0), points.max(axis=0)
    trunk = body.joints_template[0]
    start = np.array([0.5 * (low[0] + high[0]) - trunk[0], high[1] - top_m, 0.5 * (low[2] + high[2]) - trunk[2]])
    contours = tube_ends(mesh)
    fits = []
    for number, (lift, rise) in enumerate(product(ARM_LIFTS_RAD, RISES_M)):
        tick(f"start {number + 1} of {len(ARM_LIFTS_RAD) * len(RISES_M)}")
        first = start_parameters(body, lift, start + np.array([0.0, rise, 0.0]))
        fits.append(fit_from(body, points, normals, contours, first, FIRST_STEPS, wanted=wanted))
    best = sorted(fits, key=lambda one: one[1])[:FINALISTS]
    fits = [fit_from(body, points, normals, contours, one, STEPS, wanted=wanted, neutral=start) for one, _ in best]
    parameters, cost = min(fits, key=lambda one: one[1])
    distance = closest.signed_distance(points, posed_by(body, parameters), body.faces)
    inside = distance < 0.0
    depth = 1e3 * float(np.quantile(-distance[inside], 0.95)) if inside.any() else 0.0
    return InsideFit(
        *unpack(body, parameters),
        mean_mm=1e3 * float(np.abs(distance).mean()),
        inside_pct=100.0 * float(inside.mean()),
        depth_mm=depth,
        band_mm=1e3 * float(np.median(np.abs(distance[points[:, 1] > high[1] - BAND_M]))),
        cost_m2=cost,
    )


def check_inside(fit: InsideFit) -> None:
    """Refuses (``BodyError``) a fit whose cloth still cuts into the body, or hangs beside it."""
    if fit.inside_pct > INSIDE_LIMIT_PCT:
        raise BodyError(
            "body in the target",
            expected=f"cloth that a body fits in, at most {INSIDE_LIMIT_PCT:g} % of it inside",
            got=f"{fit.inside_pct:.0f} % of the cloth inside by {fit.depth_mm:.0f} mm",
            cure="Turn the target upright and facing +z, check its unit (--unit), or give the body (--body FILE).",
        )
    if fit.band_mm > BAND_LIMIT_MM:
        raise BodyError(
            "body in the target",
            expected=f"a garment on its body, the top {100 * BAND_M:.0f} cm within {BAND_LIMIT_MM:g} mm of the skin",
            got=f"{fit.band_mm:.0f} mm between them (median), {fit.mean_mm:.0f} mm over all the cloth",
            cure="Take a base of the target's kind, which tells where it hangs, or give the body (--body FILE).",
        )


def tube_ends(mesh: GarmentMesh) -> list[Contour]:
    """The open contours of ``mesh`` at which the cloth looks sideways, as at a cuff; the most so first."""
    flatness = {one.loop.tobytes(): one.flatness for one in borders(mesh) if plainly_opening(one)}
    ends = [one for one in open_contours(mesh.vertices, mesh.faces) if one.loop.tobytes() in flatness]
    return sorted(ends, key=lambda one: flatness[one.loop.tobytes()])


def _sample(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points [m] (N, 3) on the cloth, evenly by area, and its normals there, outward by the sign of the volume."""
    areas = meshes.face_areas(vertices, faces)
    drawn = np.random.default_rng(0).choice(len(faces), size=POINT_COUNT, p=areas / areas.sum())
    normals = meshes.face_normals(vertices, faces)
    middle = vertices[faces].mean(axis=1)
    volume = float(np.einsum("fc,fc->", meshes.area_vectors(vertices, faces), middle - middle.mean(axis=0)))
    return middle[drawn], normals[drawn] * (1.0 if volume >= 0.0 else -1.0)


def fit_from(
    body: BodyModel,
    points: np.ndarray,
    normals: np.ndarray,
    contours: list[Contour],
    parameters: np.ndarray,
    steps: int,
    *,
    wanted: dict[str, int] | None,
    neutral: np.ndarray | None = None,
    likely: np.ndarray | None = None,
    shape_prior_m: float | np.ndarray = SHAPE_PRIOR_M,
    slack: float = 1.0,
    place_prior_m: np.ndarray = PLACE_PRIOR_M,
    sole: int | None = None,
    lock: float = 0.0,
) -> tuple[np.ndarray, float]:
    """Parameters from one start, and the mean cost [m^2] with the priors.

    ``neutral`` [m] (3,) is the likely place of the mean shape in T-pose; ``likely`` (P,) are other likely parameters.
    ``slack`` is the pull of cloth outside that carries nothing, over the usual one. ``place_prior_m`` (3,) is what a
    metre from the likely place is worth. The vertex ``sole``, if given, stands on the floor. With a ``lock`` cloth lies
    as far from the skin as most of the band that carries it does, and what lies so pulls by that much either way.
    """
    cuffs = _cuffs(body, contours, parameters, wanted)
    if likely is None:
        place = parameters[-3:] if neutral is None else neutral
        likely = np.concatenate([np.zeros(len(parameters) - 3), place])
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


def _cuffs(body: BodyModel, contours: list[Contour], parameters: np.ndarray, wanted: dict[str, int] | None) -> Cuffs:
    """Middles [m] (3,) of the openings that lie nearer to a limb than to the trunk at the start, with the bone.

    Arms and feet may be elsewhere than at the start; thighs are not, so what lies beside one is a pocket.
    Each limb has one at most, the first of ``contours``, and none if the garment's kind has none there.
    """
    betas, pose, trans = unpack(body, parameters)
    joints = body.posed_joints(pose[None], betas)[0] + trans
    number = {name: joint for joint, name in enumerate(JOINT_NAMES)}
    trunk = bone_chains(joints)[TRUNK][0]
    cuffs, taken = [], set()
    for contour in contours:
        limbs = [
            (float(np.linalg.norm(_perpendicular(contour.centre, joints[a], joints[b]))), a, b, part)
            for part, names in LIMBS.items()
            if part not in taken and (wanted is None or wanted.get(part))
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
            taken.add(part)
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
