"""The relaxation that sews: nearest isometries, rest states, threads and contact."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.cloth.relaxation import LONGEST_MOVE_M, Relaxation, nearest_isometry, principal_stretches
from drape.errors import MeshError
from recovery.drape.seam_threads import in_numpy
from recovery.sim.skin_contact import PlaneDistance
from tests.recovery.sim_setup import strip

FLOOR = in_numpy(PlaneDistance(normal=(0.0, 0.0, 1.0)))
NOWHERE = in_numpy(PlaneDistance((0.0, 0.0, -10.0), (0.0, 0.0, 1.0)))


def sheet(distance=NOWHERE, *, gap_m: float = 0.01) -> tuple[Relaxation, np.ndarray]:
    """A relaxation of a rectangle, and its rest shape in space."""
    panel, faces = strip(6, 4, length_m=0.3, width_m=0.2)
    return Relaxation(faces, panel[faces], distance, gap_m=gap_m), np.pad(panel, ((0, 0), (0, 1)))


def test_the_nearest_isometry_is_the_polar_factor(rng):
    """Against U V^T of the singular value decomposition, for deformations far from rest."""
    f = rng.normal(size=(200, 3, 2)) * rng.uniform(0.1, 10.0, size=(200, 1, 1))
    u, _, vt = np.linalg.svd(f, full_matrices=False)
    assert_allclose(nearest_isometry(f), u @ vt, atol=1e-9)


def test_the_nearest_isometry_of_a_collapsed_triangle_is_finite(rng):
    line = rng.normal(size=(5, 3, 1)) @ np.array([[1.0, 2.0]])
    found = nearest_isometry(np.concatenate([line, np.zeros((1, 3, 2))]))
    assert np.isfinite(found).all() and np.abs(found).max() <= 1.0 + 1e-6


def test_moved_rigidly_cloth_stays_where_it_is(rng):
    """Neither membrane nor bending nor inertia moves an unstretched flat sheet, wherever it lies."""
    relaxation, rest = sheet()
    turn = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    x = rest @ turn.T + [0.3, -0.2, 0.5]
    assert_allclose(relaxation.step(x), x, atol=1e-12)


def test_a_step_does_not_depend_on_the_observer(rng):
    """step(R x + t) = R step(x) + t."""
    relaxation, rest = sheet()
    x = rest + 0.004 * rng.normal(size=rest.shape)
    turn, shift = Rotation.from_rotvec(rng.normal(size=3)).as_matrix(), rng.normal(size=3)
    assert_allclose(relaxation.step(x @ turn.T + shift), relaxation.step(x) @ turn.T + shift, atol=1e-12)


def test_stretched_cloth_returns_to_its_lengths():
    relaxation, rest = sheet()
    x = rest * [1.3, 1.0, 1.0]
    faces, flat = relaxation.faces, rest[relaxation.faces][..., :2]
    assert_allclose(principal_stretches(faces, flat, x), np.tile([1.3, 1.0], (len(faces), 1)), atol=1e-12)
    for _ in range(200):
        x = relaxation.step(x)
    assert np.abs(principal_stretches(faces, flat, x) - 1.0).max() < 0.01


def test_threads_take_the_length_that_is_asked_for():
    """Two sheets, one drawn to the other: first to half the distance, then until their edges meet."""
    panel, faces = strip(4, 4, length_m=0.2, width_m=0.2)
    count = len(panel)
    both = np.concatenate([faces, faces + count])
    right, left = np.flatnonzero(panel[:, 0] > 0.2 - 1e-9), np.flatnonzero(panel[:, 0] < 1e-9)
    pairs = np.stack([right, left + count], axis=1)
    rest = np.concatenate([panel, panel])[both]
    relaxation = Relaxation(both, rest, NOWHERE, gap_m=0.01, threads=pairs)
    x = np.pad(np.concatenate([panel, panel + np.array([0.4, 0.0])]), ((0, 0), (0, 1)))
    start = relaxation.thread_lengths(x)
    assert_allclose(start, 0.2, atol=1e-12)
    for wanted in (0.1, 0.0):
        for _ in range(60):
            x = relaxation.step(x, start * wanted / 0.2)
        assert_allclose(relaxation.thread_lengths(x), wanted, atol=1e-3)
    assert np.abs(principal_stretches(both, rest, x) - 1.0).max() < 1e-2


def test_cloth_in_the_body_comes_out_to_the_gap_and_not_faster_than_allowed():
    relaxation, rest = sheet(FLOOR, gap_m=0.01)
    x = rest - [0.0, 0.0, 0.05]
    after = relaxation.step(x)
    assert_allclose(np.linalg.norm(after - x, axis=1).max(), LONGEST_MOVE_M, rtol=1e-6)
    for _ in range(40):
        after = relaxation.step(after)
    assert_allclose(after[:, 2], 0.01, atol=1e-6)


def test_a_collapsed_rest_triangle_is_refused():
    panel, faces = strip(2, 2, length_m=0.1, width_m=0.1)
    rest = panel[faces]
    rest[3, 2] = rest[3, 1]
    with pytest.raises(MeshError, match="number 3"):
        Relaxation(faces, rest, NOWHERE, gap_m=0.01)
