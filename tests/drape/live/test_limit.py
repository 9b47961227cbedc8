"""The limit of strain: which edges it moves, how far, and that no frame ends with cloth that the lift tore."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.engine.calls import call_with_scratch
from drape.live.fold_step import FoldEffort, fold
from tests.drape.live.folds_setup import constants, frame, sleeve, spared
from tests.reference import folds as reference
from tests.reference.folds import LONGEST, SHORTEST


def limited(x: np.ndarray) -> np.ndarray:
    made = constants(dtype=np.float64)
    call_with_scratch("law_limit", np.float64, found := spared(x[made.sheet.vertex]), made)
    return found[made.sheet.place]


def strains(x: np.ndarray) -> np.ndarray:
    """The lengths (F, 3) of the sleeve's edges at ``x`` [m] (V, 3), over those at rest."""
    cloth = sleeve()[1].cloth
    edges = x[np.roll(cloth.faces, -1, axis=1)] - x[cloth.faces]
    return np.linalg.norm(edges, axis=2) / reference.rest_lengths(cloth)


def test_the_engine_moves_cloth_as_the_readable_equation_does(rng):
    rest, worn = sleeve()
    torn = rest + 0.01 * rng.normal(size=rest.shape)
    assert_allclose(limited(torn), reference.limited(torn, worn.cloth), rtol=0.0, atol=1e-15)
    assert np.ptp(strains(torn)) > 2.0 * np.ptp(strains(limited(torn)))


def test_cloth_within_the_limits_keeps_its_bits():
    rest, _ = sleeve()
    for share in (SHORTEST + 0.01, 1.0, LONGEST - 0.01):
        assert_array_equal(limited(share * rest), share * rest)
    assert not np.array_equal(limited((LONGEST + 0.01) * rest), (LONGEST + 0.01) * rest)


def test_what_one_vertex_is_pulled_out_by_its_neighbours_follow():
    rest, _ = sleeve()
    torn = rest.copy()
    torn[30] *= [1.5, 1.0, 1.5]
    found = limited(torn)
    assert strains(torn).max() > 1.5 and strains(found).max() < 1.1 * LONGEST
    far = np.linalg.norm(found - rest, axis=1)
    assert far[30] < np.linalg.norm(torn[30] - rest[30]) and (far > 1e-3).sum() > 5


def test_no_number_stays_none():
    assert np.isnan(limited(np.full_like(sleeve()[0], np.nan))).all(), "the guard of the frame sees it"


def test_a_frame_ends_with_it_after_the_lift():
    made, torn = constants(creased=False, dtype=np.float64), frame(sleeve(creased=False)[0], 0, noise_m=0.008)
    found, _, report = fold(made, None, torn, FoldEffort(steps=0))
    assert report.lifted_max_m > 0.005 and strains(torn.vertices).max() > 2.0
    assert strains(found).max() < 1.5
