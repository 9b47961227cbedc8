"""Fits shape and pose of the standard body to the surface of another one (a mannequin, an avatar, a scan).

Gauss-Newton on closest points over SMPL shape, joint rotations, translation and size, from a
T-pose and from two A-poses; the best start wins. What the ten shape components cannot say is
added as a smooth displacement to the surface. The residual decides whether the result is used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from drape.errors import BodyError
from drape.geometry import mesh_graphs, meshes
from drape.geometry.closest import closest_point, nearest_vertices
from drape.geometry.rotations import rotvec_to_matrix

RESIDUAL_LIMIT_MM = 15.0
HEIGHTS_M = (1.2, 2.3)
UNIT_SCALES = (1.0, 0.01, 0.1, 0.001, 0.0254)
POINT_COUNT = 750
FREE_JOINTS = [JOINT_NAMES.index(name) for name in JOINT_NAMES if not name.endswith(("hand", "foot"))]
ARM_LIFTS_RAD = (0.6, 0.0, 1.1)  # how far the arms hang below the horizontal at the start
GOOD_RESIDUAL_MM = 6.0  # a start that reaches this is not followed by another
STEPS = 24
NORMAL_AGREEMENT = 0.3
SHAPE_PRIOR, POSE_PRIOR = 5e-4, 2e-3  # [m] per unit of beta and per radian: keep near zero what the surface leaves open
MATCH_REACH_M = 0.08  # points of the target farther from the body than this do not pull; four times as far at first


def _below() -> np.ndarray:
    """1 where a joint is a free one or hangs on it, else 0 (free, 24)."""
    hangs = np.eye(JOINT_COUNT)
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            hangs[:, joint] += hangs[:, parent]
    return hangs[FREE_JOINTS]


BELOW = _below()


def body_units(vertices: np.ndarray, *, name: str = "avatar") -> tuple[float, np.ndarray]:
    """Returns the scale, one of ``UNIT_SCALES``, that makes ``vertices`` (V, 3), y up, a person of plausible height in
    metres, and the scaled vertices [m] (V, 3). Raises ``BodyError`` where none does."""
    height = float(np.ptp(vertices[:, 1])) if len(vertices) else 0.0
    fitting = [scale for scale in UNIT_SCALES if HEIGHTS_M[0] <= height * scale <= HEIGHTS_M[1]]
    if not fitting:
        raise BodyError(
            name,
            expected=f"a person {HEIGHTS_M[0]} to {HEIGHTS_M[1]} m tall in m, dm, cm, mm or inch, y up",
            got=f"a height of {height:.4g}",
            cure="Turn the avatar upright and scale it to metres.",
        )
    return fitting[0], vertices * fitting[0]


class BodyRegistration(NamedTuple):
    """The standard body fitted to a surface: shape ``betas`` (S,), ``pose`` (24, 3) [rad] and translation ``trans``
    (3,) [m]; ``residual_mm`` is the mean distance of the surface from it."""

    betas: np.ndarray
    pose: np.ndarray
    trans: np.ndarray
    residual_mm: float


def register_body(
    vertices: np.ndarray, faces: np.ndarray, body: BodyModel, *, name: str = "avatar"
) -> tuple[np.ndarray, float]:
    """Returns the vertices [m] (V, 3) of ``body`` fitted to a surface and then drawn onto it, and the mean distance
    [mm] of the surface from the fit. ``vertices`` [m] and ``faces`` are the surface's. Raises ``BodyError`` for a
    distance above ``RESIDUAL_LIMIT_MM``, and for a surface of fewer than 500 vertices."""
    fit = fit_body(vertices, faces, body, name=name)
    fitted = body.posed_vertices(fit.pose[None], fit.trans[None], fit.betas)[0]
    return _snap(fitted, body, _Target(vertices, faces)), fit.residual_mm


def fit_body(vertices: np.ndarray, faces: np.ndarray, body: BodyModel, *, name: str = "avatar") -> BodyRegistration:
    """Returns the shape, the pose and the translation with which ``body`` lies nearest to the surface ``vertices`` [m],
    ``faces``. Raises ``BodyError`` as ``register_body`` does."""
    used = np.unique(faces)
    if len(used) < 500:
        raise BodyError(
            name,
            expected="a body surface of at least 500 vertices",
            got=str(len(used)),
            cure="Subdivide the avatar's mesh.",
        )
    target = _Target(vertices, faces)
    best, residual = np.zeros(0), np.inf
    for lift in ARM_LIFTS_RAD:
        parameters, distance = _fit(body, target, lift)
        if distance < residual:
            best, residual = parameters, distance
        if residual < GOOD_RESIDUAL_MM:
            break
    if not residual <= RESIDUAL_LIMIT_MM:
        raise BodyError(
            name,
            expected=f"a body that the standard body fits to {RESIDUAL_LIMIT_MM:g} mm",
            got=f"{residual:.1f} mm",
            cure="Give the avatar as a whole body, upright, facing +z, in a T- or A-pose, or as a phenotype.",
        )
    return BodyRegistration(*unpack_parameters(body, best), residual)


class _Target:
    """The surface to fit: vertices, faces, normals, and a thinned set of its points."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.vertices, self.faces = vertices, faces
        self.normals = meshes.face_normals(vertices, faces)
        volume = np.einsum(
            "fc,fc->", meshes.area_vectors(vertices, faces), vertices[faces].mean(axis=1) - vertices.mean(axis=0)
        )
        self.normals = self.normals * (1.0 if volume >= 0 else -1.0)
        areas = meshes.face_areas(vertices, faces)
        drawn = np.random.default_rng(0).choice(len(faces), size=2 * POINT_COUNT, p=areas / areas.sum())
        self.points, self.point_normals = vertices[faces[drawn]].mean(axis=1), self.normals[drawn]


def _fit(body: BodyModel, target: _Target, lift_rad: float) -> tuple[np.ndarray, float]:
    """Parameters of the body from one start, and the mean distance [mm] of the target's points to it."""
    parameters = _start(body, target, lift_rad)
    prior = np.concatenate(
        [np.full(body.shape_count, SHAPE_PRIOR), np.full(3 * len(FREE_JOINTS), POSE_PRIOR), np.zeros(3)]
    )
    prior[body.shape_count : body.shape_count + 3] = 0.0  # the root may turn freely
    centre = parameters.copy()
    for step in range(STEPS):
        posed = posed_by(body, parameters)
        normals = posed_normals(body, posed)
        # Every point of the target looks for the body: parts that the target lacks do not pull.
        distance, near = nearest_vertices(target.points, posed, 4)
        agree = np.einsum("nc,nkc->nk", target.point_normals, normals[near]) > NORMAL_AGREEMENT
        first = np.argmax(agree, axis=1)
        rows = np.arange(len(near))
        reach = MATCH_REACH_M if step > 8 else 4.0 * MATCH_REACH_M
        keep = agree[rows, first] & (distance[rows, first] < reach)
        index, goal, normal = near[rows, first][keep], target.points[keep], target.point_normals[keep]
        if len(index) < 100:
            return parameters, np.inf
        gap = posed[index] - goal
        robust = 1.0 / (1.0 + np.einsum("nc,nc->n", gap, gap) / (0.5 * reach) ** 2)
        jacobian = parameter_jacobian(body, parameters, index)
        # Gaps count in full along the normal and a little along the surface, so that points may slide.
        project = 0.9 * normal[:, :, None] * normal[:, None, :] + 0.1 * np.eye(3)
        a = project @ jacobian * robust[:, None, None]
        b = np.einsum("nab,nb->na", project, gap) * robust[:, None]
        a, b = a.reshape(-1, len(parameters)), b.reshape(-1)
        damping = len(index) * (prior**2)
        system = a.T @ a + np.diag(damping + 1e-6 * len(index) * 1e-2)
        change = np.linalg.solve(system, -(a.T @ b) - damping * (parameters - centre))
        parameters = parameters + np.clip(change, -0.5, 0.5)
        if np.abs(change).max() < 1e-4:
            break
    posed = posed_by(body, parameters)
    return parameters, 1e3 * float(closest_point(target.points, posed, body.faces).distance.mean())


def _start(body: BodyModel, target: _Target, lift_rad: float) -> np.ndarray:
    """Mean shape, arms ``lift_rad`` below the horizontal, feet and middle where the target's are."""
    middle = 0.5 * (target.vertices.min(axis=0) + target.vertices.max(axis=0))
    ours = 0.5 * (body.v_template.min(axis=0) + body.v_template.max(axis=0))
    return start_parameters(body, lift_rad, middle - ours)


def start_parameters(body: BodyModel, lift_rad: float, trans: np.ndarray) -> np.ndarray:
    """Returns the parameters (P,), betas, joint rotations and translation as in ``unpack_parameters``, of the mean
    shape at the translation ``trans`` [m] (3,), in T-pose but with the arms ``lift_rad`` below the horizontal."""
    pose = np.zeros((JOINT_COUNT, 3))
    for side, sign in (("left", -1.0), ("right", 1.0)):
        pose[JOINT_NAMES.index(f"{side}_collar"), 2] = 0.2 * sign * lift_rad
        pose[JOINT_NAMES.index(f"{side}_shoulder"), 2] = 0.8 * sign * lift_rad
    return np.concatenate([np.zeros(body.shape_count), pose[FREE_JOINTS].reshape(-1), trans])


def unpack_parameters(body: BodyModel, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the shape (S,), the pose (24, 3) [rad] and the translation [m] (3,) that ``parameters`` (P,) hold one
    after the other: S betas, the rotation vectors of the ``FREE_JOINTS``, the translation. Other joints are at rest."""
    pose = np.zeros((JOINT_COUNT, 3))
    pose[FREE_JOINTS] = parameters[body.shape_count : -3].reshape(-1, 3)
    return parameters[: body.shape_count], pose, parameters[-3:]


def posed_by(body: BodyModel, parameters: np.ndarray) -> np.ndarray:
    """Returns the vertices [m] (V, 3) of ``body`` with ``parameters`` (``unpack_parameters``), in the world."""
    betas, pose, trans = unpack_parameters(body, parameters)
    return body.posed_vertices(pose[None], trans[None], betas)[0]


def posed_normals(body: BodyModel, posed: np.ndarray) -> np.ndarray:
    """Returns the unit normals (V, 3) of the vertices of ``body`` when these are at ``posed`` [m] (V, 3)."""
    return meshes.vertex_normals(posed, body.faces, table=body.face_table)


def parameter_jacobian(body: BodyModel, parameters: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Returns the derivatives (N, 3, P) of the posed vertices ``index`` (N,) by ``parameters`` (P,)
    (``unpack_parameters``), in metres per unit, without pose blend shapes.

    A joint that turns by dR R^T moves what hangs on it: sum_j w_j (R_j x + t_j - p) over the bones j from there on, p
    the joint. By shape it is exact in T-pose. In other poses it takes joints to move as if no bone had turned: the
    weights of fits were chosen with that, and with the exact one they end in worse bodies.
    """
    betas, pose, trans = unpack_parameters(body, parameters)
    rest, weights = body.rest_vertices(betas)[index], body.weights[index]
    (rotations,), (translations,) = body.bones(pose[None], trans[None], betas)
    carried = weights.T[..., None] * (rest @ rotations.transpose(0, 2, 1) + translations[:, None])
    joints = (rotations @ body.rest_joints(betas)[..., None])[..., 0] + translations
    share = weights @ BELOW.T
    arms = np.tensordot(BELOW, carried, axes=1) - share.T[..., None] * joints[FREE_JOINTS, None]
    parents = np.concatenate([rotations, np.eye(3)[None]])[[PARENTS[joint] for joint in FREE_JOINTS]][:, None]
    own, step = pose[FREE_JOINTS], 1e-5
    moved = rotvec_to_matrix(own[:, None] + step * np.eye(3)) - rotvec_to_matrix(own)[:, None]
    turns = parents @ moved / step @ np.swapaxes(parents @ rotvec_to_matrix(own)[:, None], -1, -2)
    by_pose = (arms @ turns.reshape(len(own), 9, 3).transpose(0, 2, 1)).reshape(len(own), len(index), 3, 3)
    by_pose = by_pose.transpose(1, 3, 0, 2).reshape(len(index), 3, -1)
    blended = (weights @ rotations.reshape(-1, 9)).reshape(-1, 3, 3)
    joint_part = np.einsum("jab,jbs->jas", np.eye(3) - rotations, body.joint_shapedirs)
    by_shape = blended @ body.shapedirs[index] + (weights @ joint_part.reshape(len(joint_part), -1)).reshape(
        len(index), 3, -1
    )
    return np.concatenate([by_shape, by_pose, np.broadcast_to(np.eye(3), (len(index), 3, 3))], axis=2)


def _snap(fitted: np.ndarray, body: BodyModel, target: _Target) -> np.ndarray:
    """``fitted`` drawn on to the target by a smooth displacement, where the surfaces face the same way."""
    nearest = closest_point(fitted, target.vertices, target.faces)
    normals = posed_normals(body, fitted)
    agree = np.einsum("vc,vc->v", normals, target.normals[nearest.face]) > 0.6
    trust = (agree & (nearest.distance < 0.04)).astype(np.float64)
    umbrella = mesh_graphs.umbrella_laplacian(body.faces, len(fitted))
    system = scipy.sparse.diags(trust + 1e-4) + 4.0 * (umbrella.T @ umbrella)
    pull = trust[:, None] * (nearest.point - fitted)
    return fitted + scipy.sparse.linalg.splu(system.tocsc()).solve(pull)
