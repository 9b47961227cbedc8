"""Bodies that are fitted inside cloth: which openings lead limbs."""

from __future__ import annotations

import numpy as np

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.contours import Contour
from drape.garment.inside import fit_from
from drape.garment.registration import start_parameters
from drape.garment.wearer_fields import thin_body
from drape.geometry import meshes

BODY = thin_body(load_body())
THIGH = BODY.joints_template[[JOINT_NAMES.index("left_hip"), JOINT_NAMES.index("left_knee")]].mean(axis=0)


def ring(beside_m: float, radius_m: float) -> Contour:
    """An opening round a point beside the left thigh."""
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    around = radius_m * np.stack([np.cos(angle), np.zeros(24), np.sin(angle)], axis=1)
    centre = THIGH + np.array([beside_m, 0.0, 0.0])
    return Contour(np.arange(24), centre + around, 2.0 * np.pi * radius_m, centre)


def fitted(*contours: Contour) -> np.ndarray:
    """The parameters of a body in cloth on its own skin."""
    normals = meshes.vertex_normals(BODY.v_template, BODY.faces)
    points = BODY.v_template + 0.004 * normals
    start = start_parameters(BODY, 0.0, np.zeros(3))
    return fit_from(BODY, points[::10], normals[::10], list(contours), start, 2)[0]


def test_a_pocket_beside_a_thigh_is_no_cuff():
    """The rims of pockets led the legs out of a pair of cargo trousers."""
    alone = fitted()
    np.testing.assert_array_equal(fitted(ring(0.1, 0.05)), alone)
    assert not np.array_equal(fitted(ring(0.03, 0.12)), alone)
