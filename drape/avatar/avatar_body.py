"""The body that stands for a character in a drape: the standard body's skin on it, with the character's own joints and
its own weights, so that skin and character move alike."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import scipy.sparse

from drape.avatar.body_fit import FEW_FACES, BodyFit
from drape.avatar.covering import covering
from drape.avatar.parts import PARTS, faces_beside, parts_of
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_COUNT
from drape.garment.skin import smoothing_matrix
from drape.geometry.closest import closest_point

SUPPORT = 200  # So many vertices of the skin place a joint.
TRUSTED_M = 0.04  # A vertex farther from the character keeps the standard body's weights.
SMOOTHING_PASSES = 3


def avatar_body(fit: BodyFit, pose: TPose, body: BodyModel, *, name: str, covered: TPose | None = None) -> BodyModel:
    """Returns the body that stands for the character in ``pose``: the skin of ``fit``, skinned as the character is, and
    brought out to the faces of ``covered`` (those of ``pose`` by default). Its root joint lies where that of ``body``
    does.

    ``body`` is the body that was fitted. The new one has no shapes of its own: its ``shapedirs`` are zero.
    """
    joints = np.where(np.isfinite(pose.joints), pose.joints, fit.joints)
    place = body.joints_template[0] - joints[0]
    weights, covered = _weights(fit, pose, body), pose if covered is None else covered
    covered = replace(covered, vertices=covered.vertices + place)
    return _brought_out(fit.vertices + place, weights, joints + place, covered, body, name)


def enclosing_body(bare: BodyModel, covered: TPose, standard: BodyModel) -> BodyModel:
    """Returns the body ``bare`` of a character with its skin brought out to the faces of ``covered``, which stands in
    the frame of ``bare``. ``standard`` is the body that ``bare`` was made of."""
    return _brought_out(bare.v_template, bare.weights, bare.joints_template, covered, standard, bare.name)


def _brought_out(
    vertices: np.ndarray, weights: np.ndarray, joints: np.ndarray, covered: TPose, body: BodyModel, name: str
) -> BodyModel:
    """The body whose skin has ``vertices`` [m] (Vb, 3) and ``weights`` (Vb, 24) on ``joints`` [m] (24, 3), brought out
    to what is ``covered``."""
    vertices = covering(vertices, weights, joints, covered, body)
    regressor = _regressor(vertices, joints, body)
    digest = hashlib.sha256()
    for array in (vertices, weights, joints):
        digest.update(np.ascontiguousarray(array, dtype=np.float32).tobytes())
    return BodyModel(
        name, digest.hexdigest(), vertices, np.zeros_like(body.shapedirs), regressor, weights, body.faces,
        standard_digest=body.digest,
    )  # fmt: skip


def _weights(fit: BodyFit, pose: TPose, body: BodyModel) -> np.ndarray:
    """The character's weights (Vb, 24) where the skin lies on it, those of ``body`` elsewhere, smooth between."""
    own, theirs = parts_of(body.weights), parts_of(pose.weights)[pose.faces]
    weights, trust = body.weights.copy(), np.zeros((body.vertex_count, 1))
    for number, part in enumerate(PARTS):
        rows, faces = np.flatnonzero(own == number), faces_beside(part, theirs)
        if not len(rows) or len(faces) < FEW_FACES:
            continue
        found = closest_point(fit.vertices[rows], pose.vertices, pose.faces[faces])
        corners = pose.faces[faces][found.face]
        weights[rows] = np.einsum("vk,vkj->vj", found.barycentric, pose.weights[corners])
        trust[rows, 0] = np.clip(2.0 - found.distance / TRUSTED_M, 0.0, 1.0)
    blended = trust * weights + (1.0 - trust) * body.weights
    smooth = smoothing_matrix(body.faces, body.vertex_count)
    for _ in range(SMOOTHING_PASSES):
        blended = smooth @ blended
    blended = np.where(blended > 1e-3, blended, 0.0)
    return blended / blended.sum(axis=1, keepdims=True)


def _regressor(vertices: np.ndarray, joints: np.ndarray, body: BodyModel) -> scipy.sparse.csr_matrix:
    """A regressor (24, Vb) whose rows sum to one and give ``joints``: that of ``body``, changed by the least numbers on
    the vertices near each joint."""
    rows = body.regressor.toarray()
    for joint in range(JOINT_COUNT):
        near = np.argsort(np.linalg.norm(vertices - joints[joint], axis=1), kind="stable")[:SUPPORT]
        system = np.concatenate([vertices[near].T, np.ones((1, len(near)))])
        missing = np.append(joints[joint] - rows[joint] @ vertices, 1.0 - rows[joint].sum())
        rows[joint, near] += np.linalg.lstsq(system, missing, rcond=None)[0]
    return scipy.sparse.csr_matrix(rows)
