"""Residuals are mended and forgotten as the readable equations say, and only where cloth turns."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.engine.calls import call_with_scratch
from tests.drape.live.folds_setup import constants, sleeve, spared
from tests.reference import folds as reference
from tests.reference.folds import LACK, MEND_M


def shares(before: np.ndarray, network: np.ndarray) -> np.ndarray:
    """What each vertex forgets (V,), by the engine."""
    made, (before, network) = constants(dtype=np.float64), (placed(each) for each in (before, network))
    law("forget", before, network, made, found := np.empty(len(network)))
    return found[made.sheet.place]


def placed(points: np.ndarray) -> np.ndarray:
    """``points`` (V, 3) at their places (P, 3)."""
    return spared(points[constants(dtype=np.float64).sheet.vertex])


def law(name: str, *given: object) -> None:
    call_with_scratch(f"law_{name}", np.float64, *given)


def mended(off: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """``off`` (V, 3) after each forgot its share ``lost`` (V,)."""
    made = constants(dtype=np.float64)
    law("mend", found := placed(off), made, MEND_M, lost[made.sheet.vertex])
    return found[made.sheet.place]


def turned(points: np.ndarray, angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return points @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def test_a_residual_far_from_its_neighbours_follows_them(rng):
    rest, worn = sleeve()
    off, lost = 0.01 * rng.normal(size=rest.shape), rng.uniform(0.0, 1.0, len(rest))
    off[7] += 0.05
    assert_allclose(mended(off, lost), reference.mended(off, worn.cloth.faces, lost), rtol=0.0, atol=1e-15)
    kept = mended(off, np.zeros(len(rest)))
    same = (kept == off).all(axis=1)
    assert not same[7] and same.any() and np.linalg.norm(kept[7]) < 0.02


def test_the_engine_forgets_as_much_as_the_readable_equation(rng):
    rest, worn = sleeve()
    network = rest + 0.002 * rng.normal(size=rest.shape)
    before = network + 0.001 * rng.normal(size=rest.shape)
    assert_allclose(shares(before, network), reference.forgotten(before, network, worn.cloth), rtol=1e-12)


def test_cloth_that_moves_without_turning_forgets_nothing(rng):
    rest, _ = sleeve()
    assert (shares(rest + 0.3, rest) < 1e-12).all()
    off = 0.001 * rng.normal(size=rest.shape)
    assert_array_equal(mended(off, shares(rest, rest)), off)


@pytest.mark.parametrize("frames", [1, 4])
def test_a_way_is_forgotten_alike_in_one_frame_or_in_several(frames: int):
    rest, _ = sleeve()
    wide = 1.01 * rest  # nothing lacks
    ways = [shares(turned(wide, 0.002 * i / frames), turned(wide, 0.002 * (i + 1) / frames)) for i in range(frames)]
    kept = np.prod([1.0 - way for way in ways], axis=0)
    assert_allclose(kept, 1.0 - shares(wide, turned(wide, 0.002)), rtol=1e-3)
    assert kept.min() < 0.98


def test_where_the_network_leaves_area_out_folds_stay():
    rest, _ = sleeve()
    wide, narrow = 1.01 * rest, (1.0 - 4.0 * LACK) * rest
    assert shares(narrow, turned(narrow, 0.1)).max() < 0.2 * shares(wide, turned(wide, 0.1)).min()


def test_hems_are_evened_along_the_border_and_nothing_else_is(rng):
    (rest, worn), made = sleeve(), constants(dtype=np.float64)
    place = made.sheet.place
    off, before = 0.001 * rng.normal(size=rest.shape), rest + 0.001 * rng.normal(size=rest.shape)
    law("even_hem", found := placed(off), placed(before), placed(rest), made)
    wanted = reference.evened(off, before, rest, worn.cloth.faces)
    assert_allclose(found[place], wanted, rtol=0.0, atol=1e-15)
    border = np.isin(place, made.hem[:, 1])
    assert border.sum() == len(made.hem) > 10
    assert_array_equal(found[place][~border], off[~border])
    assert np.linalg.norm(wanted[border]) < 0.9 * np.linalg.norm(off[border])


def test_what_crosses_goes_back_with_its_neighbours_and_nothing_else_moves(rng):
    rest, worn = sleeve()
    made = constants(dtype=np.float64)
    network, off = np.zeros((2, len(made.sheet.vertex), 3))
    network[made.sheet.place], off[made.sheet.place] = rest, 0.01 * rng.normal(size=rest.shape)
    x, crossed = network + off, np.zeros(len(network))
    law("ease", x, network, crossed, 0.5, made)
    assert_array_equal(x, network + off)
    crossed[made.sheet.place[:3]] = 2.0
    share = np.where(np.arange(len(rest)) < 3, 0.5, 0.0)
    law("ease", x, network, crossed, 0.5, made)
    wanted = reference.mended(off[made.sheet.place], worn.cloth.faces, share, far_m=np.inf)
    assert_allclose((x - network)[made.sheet.place], wanted, rtol=0.0, atol=1e-12)
    assert_array_equal(x[crossed == 0.0], (network + off)[crossed == 0.0])
