"""The standard body laid on characters whose necks are not its own."""

from __future__ import annotations

import numpy as np

from drape.avatar.body_fit import fit_to
from drape.avatar.parts import PARTS, parts_of
from drape.avatar.t_pose import TPose
from drape.body.model import BodyModel
from drape.body.skeleton import JOINT_NAMES


def test_a_head_that_nothing_draws_stays_on_its_neck(body: BodyModel):
    """A doll's neck leans and is thin: the head went on as the neck was bent, and stood behind it."""
    part = parts_of(body.weights)
    neck, head = (part == list(PARTS).index(name) for name in ("neck", "head"))
    vertices, middle = body.v_template.copy(), body.joints_template[JOINT_NAMES.index("neck")]
    up = np.maximum(vertices[neck, 1] - middle[1], 0.0)
    vertices[neck, 0] = middle[0] + 0.5 * (vertices[neck, 0] - middle[0])
    vertices[neck, 2] = middle[2] + 0.5 * (vertices[neck, 2] - middle[2]) - 0.5 * up
    faces = body.faces[~head[body.faces].any(axis=1)]
    fit = fit_to(TPose(vertices, faces, body.weights, body.joints_template, 1.0, 1.7), body)
    above = head & (body.v_template[:, 1] > body.joints_template[JOINT_NAMES.index("head"), 1])
    moved = np.linalg.norm(fit.vertices - body.v_template, axis=1)[above]
    assert np.quantile(moved, 0.9) < 0.06, np.quantile(moved, [0.5, 0.9, 1.0])
