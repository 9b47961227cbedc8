"""Folds come into the next frame turned and unstretched: turns of a surface, and what of a start is stretched."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from drape.engine.calls import call, call_with_scratch
from tests.drape.live.folds_setup import constants, sleeve, spared, turn_about_y
from tests.fixtures.laws import each
from tests.reference import carry
from tests.reference.folds import surface_frames


def placed(points: np.ndarray) -> np.ndarray:
    """``points`` (V, 3) at their places (P, 3)."""
    return spared(points[constants(dtype=np.float64).sheet.vertex])


def turns_of(before: np.ndarray, network: np.ndarray, passes: int) -> np.ndarray:
    """The turns (V, 4) from one surface (V, 3) to another, by the engine."""
    made = constants(dtype=np.float64)
    found = np.empty((len(made.sheet.vertex), 4))
    call_with_scratch("law_turns", np.float64, placed(before), placed(network), made, passes, found)
    return found[made.sheet.place]


def carry_gradient(x: np.ndarray, before: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """The gradient [N] (V, 3) by the engine."""
    made = constants(dtype=np.float64)
    given = np.ascontiguousarray(turns[made.sheet.vertex])
    call("law_carry_gradient", np.float64, placed(x), placed(before), given, made, found := placed(x))
    return found[made.sheet.place]


def crumpled(rng: np.random.Generator) -> np.ndarray:
    rest, _ = sleeve()
    return rest + 0.003 * rng.normal(size=rest.shape)


@each(about=([0.4, 0.0, 0.0], [3.1, 0.0, 0.0], [0.0, -3.0, 0.5], [0.1, 0.3, 3.1], [0.0, 0.0, 0.0]))
def test_a_surface_that_turns_has_one_turn_everywhere(rng, about):
    surface, turn = crumpled(rng), Rotation.from_rotvec(about)
    wanted = turn.as_quat(scalar_first=True)
    for passes in (0, 2):
        found = turns_of(surface, turn.apply(surface) + 0.2, passes)
        assert_allclose(
            found * np.sign((found * wanted).sum(axis=1, keepdims=True)), wanted[None] + 0.0 * found, atol=1e-12
        )


def test_turns_are_the_readable_ones(rng):
    before, network, worn = crumpled(rng), crumpled(rng) @ turn_about_y(2.0).T, sleeve()[1]
    then, now = (surface_frames(each_, worn.cloth) for each_ in (before, network))
    for passes in (0, 1, 3):
        wanted = carry.surface_turns(then, now, worn.cloth.faces, passes)
        found = turns_of(before, network, passes)
        assert_allclose(found * np.sign((found * wanted).sum(axis=1, keepdims=True)), wanted, atol=1e-12)


def test_a_surface_without_an_area_does_not_turn():
    rest, _ = sleeve()
    assert_allclose(turns_of(0.0 * rest, rest, 1), [[1.0, 0.0, 0.0, 0.0]] * len(rest), atol=0.0)


def test_the_gradient_is_that_of_the_energy(rng):
    _, worn = sleeve()
    x, before, turns = crumpled(rng), crumpled(rng), rng.normal(size=(len(worn.index), 4))
    turns = np.array([1.0, 0.0, 0.0, 0.0]) + 0.3 * turns
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)

    def energy(at: np.ndarray) -> tuple[float, np.ndarray]:
        return carry.carry_energy(at, before, turns, worn.cloth, worn.material)

    found, way, step = carry_gradient(x, before, turns), rng.normal(size=x.shape), 1e-6
    assert_allclose(found, energy(x)[1], rtol=0.0, atol=1e-12 * np.abs(found).max())
    slope = (energy(x + step * way)[0] - energy(x - step * way)[0]) / (2.0 * step)
    assert_allclose((found * way).sum(), slope, rtol=1e-7)


def test_folds_that_turn_alone_are_left_as_they_are(rng):
    before, turn = crumpled(rng), Rotation.from_rotvec([0.3, -0.8, 0.2])
    turns = np.tile(turn.as_quat(scalar_first=True), (len(before), 1))
    stiff = np.abs(carry_gradient(1.01 * before, before, turns)).max()
    assert np.abs(carry_gradient(turn.apply(before) + 0.2, before, turns)).max() < 1e-12 * stiff


def stretched(x: np.ndarray, like: np.ndarray) -> float:
    """RMS of how much longer the edges of ``x`` (V, 3) are than those ``like`` it."""
    faces = sleeve()[1].cloth.faces
    now, then = (np.linalg.norm(p[faces] - p[np.roll(faces, 1, axis=1)], axis=-1) for p in (x, like))
    return float(np.sqrt(np.square(now / then - 1.0).mean()))


def test_folds_stay_unstretched_on_a_surface_that_turns_and_stretches():
    """Swing takes a pleated sleeve along with a surface that it turns, and makes wider by 4 mm of 50: a frame would
    begin with its folds as wide."""
    rest, worn = sleeve()
    made = constants(dtype=np.float64)
    angle = np.arctan2(rest[:, 0], rest[:, 2])
    out = np.stack([np.sin(angle), 0.0 * angle, np.cos(angle)], axis=1)
    before, pleats = rest, rest + 0.003 * np.cos(4.0 * angle)[:, None] * out
    turn = turn_about_y(0.4)
    network = (before + 0.004 * out) @ turn.T
    then, now = (surface_frames(one, worn.cloth) for one in (before, network))
    start = network + np.einsum("vji,vjk,vk->vi", now, then, pleats - before)
    gradient = carry_gradient(start, pleats, turns_of(before, network, carry.CARRY_PASSES))
    call_with_scratch("law_whole_step", np.float64, found := placed(start), made, placed(gradient))
    moved = found[made.sheet.place]
    assert stretched(moved, pleats) < 0.6 * stretched(start, pleats)
    assert np.abs(moved - start).max() < 0.006, "and lies where the surface has taken it"
