"""The derivative by which bodies are fitted is that of the posed vertices."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from drape.garment.registration import FREE_JOINTS, parameter_jacobian, posed_by
from drape.garment.wearer_fields import thin_body
from tests.fixtures.garments import default_body


def test_jacobian_is_the_derivative_of_the_posed_vertices():
    body = thin_body(default_body())
    draw, shape = np.random.default_rng(3), body.shape_count
    parameters = 0.4 * draw.standard_normal(shape + 3 * len(FREE_JOINTS) + 3)
    standing = np.where(np.arange(len(parameters)) < shape, parameters, 0.0)
    index, step = draw.choice(body.vertex_count, 40, replace=False), 1e-5
    for where, columns in ((parameters, slice(shape, None)), (standing, slice(None))):  # by shape it is that in T-pose
        ahead, behind = (
            np.stack([posed_by(body, where + way)[index] for way in sign * step * np.eye(len(where))], axis=-1)
            for sign in (1.0, -1.0)
        )
        expected = ((ahead - behind) / (2.0 * step))[..., columns]
        assert np.abs(expected).max() > 0.5
        # The derivative of a rotation is by a forward difference: off by about half a step of arms of a metre.
        assert_allclose(parameter_jacobian(body, where, index)[..., columns], expected, rtol=0, atol=step)
