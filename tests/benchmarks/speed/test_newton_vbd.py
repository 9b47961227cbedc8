import numpy as np
import pytest

from benchmarks.speed.newton_vbd import bending_n
from drape.cloth.energies import ClothMesh, bending
from drape.cloth.material import Material


def test_a_hinge_of_newton_bends_like_ours():
    rest = np.array([(0.2, 0.9, 0.0), (0.1, -0.7, 0.0), (-0.3, 0.0, 0.0), (0.8, 0.1, 0.0)])
    faces = np.array([(2, 3, 0), (3, 2, 1)])
    cloth = Material(bending_j=2.5e-4)
    edges = np.array([(0, 1, 2, 3), (-1, 0, 3, 2)])
    stiffness = bending_n(rest, edges, cloth.bending_j)
    assert stiffness[1] == 0.0  # a border does not bend

    # Fold the second triangle about the shared edge by a small angle: k l theta^2 / 2 there, our energy here.
    theta = 0.03  # small, and large beside what guards the hinge
    axis = (rest[3] - rest[2]) / np.linalg.norm(rest[3] - rest[2])
    arm = rest[1] - rest[2]
    folded = rest.copy()
    along = axis * (arm @ axis)
    folded[1] = rest[2] + along + np.cos(theta) * (arm - along) + np.sin(theta) * np.cross(axis, arm)
    theirs = 0.5 * stiffness[0] * np.linalg.norm(rest[3] - rest[2]) * theta**2
    ours = float(bending(folded[None], ClothMesh.from_rest(rest, faces), cloth)[0])
    assert theirs == pytest.approx(ours, rel=3e-4)
