"""Spring bones by the law of VRM: at rest, in balance, against colliders."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.motion.spring_bones import Capsules, Springs, nearest_off, shortest_turns, tails

FRAMES = 240
NONE = Capsules(np.zeros((FRAMES, 0, 3)), np.zeros((FRAMES, 0, 3)), np.zeros(0), np.zeros((1, 0), dtype=bool))


def still(*tail: float) -> tuple[np.ndarray, np.ndarray]:
    """Heads and tails of a spring at the origin that nothing moves."""
    return np.zeros((FRAMES, 1, 3)), np.tile(np.array(tail), (FRAMES, 1, 1))


def springs(stiffness: float = 1.0, gravity: float = 0.0, drag: float = 0.4, radius: float = 0.0) -> Springs:
    return Springs(*(np.array([one]) for one in (stiffness, gravity, drag, radius)))


def test_it_comes_to_rest_between_stiffness_and_gravity():
    """There the sum of both is along the bone, whatever the drag."""
    heads, rest = still(0.3, 0.0, 0.0)
    for drag in (0.2, 1.0):
        found = tails(springs(0.9, 0.4, drag), heads, rest, 30.0, NONE)
        assert_allclose(found[-1, 0], 0.3 * np.array([0.9, -0.4, 0.0]) / np.hypot(0.9, 0.4), atol=1e-6)
        assert_allclose(np.linalg.norm(found, axis=-1), 0.3, atol=1e-12)


def test_without_gravity_it_stays_where_it_rests_and_follows_its_head():
    heads, rest = still(0.0, -0.3, 0.1)
    assert_allclose(tails(springs(), heads, rest, 30.0, NONE), rest, atol=1e-12)
    way = np.minimum(np.arange(FRAMES), 60)[:, None, None] * np.array([0.01, 0.0, 0.0])
    found = tails(springs(2.0), heads + way, rest + way, 30.0, NONE)
    assert found[30, 0, 0] < rest[30, 0, 0] + way[30, 0, 0] - 0.01  # it lags behind
    assert_allclose(found[-1], rest[-1] + way[-1], atol=1e-4)


def test_a_small_swing_has_the_period_of_the_law():
    """x'' t = stiffness x / l per step: the angle a of an undamped spring turns with sqrt(stiffness / (l t)) rad/s."""
    heads, rest = still(0.0, -0.5, 0.0)
    rest[0] = 0.5 * np.array([np.sin(0.01), -np.cos(0.01), 0.0])  # begins beside, and is let go
    found = tails(springs(0.05, drag=0.0), heads, rest, 60.0, NONE)[1:, 0, 0]
    crossings = np.flatnonzero(np.sign(found[1:]) != np.sign(found[:-1]))
    half_s = np.diff(crossings).mean() / 60.0
    assert half_s == pytest.approx(np.pi / np.sqrt(0.05 * 60.0 / 0.5), rel=0.02)


def test_it_stays_out_of_a_capsule_that_it_feels():
    heads, rest = still(0.0, -0.4, 0.0)
    line = np.tile(np.array([[[0.0, -0.4, -0.5]]]), (FRAMES, 1, 1))
    line[:, 0, 0] = np.linspace(-0.3, 0.1, FRAMES)  # a leg that comes from the side
    ends = line + np.array([0.0, 0.0, 1.0])
    for felt in (True, False):
        capsules = Capsules(line, ends, np.array([0.1]), np.array([[felt]]))
        found = tails(springs(radius=0.02), heads, rest, 30.0, capsules)
        off = np.array([nearest_off(found[f], line[f, 0], ends[f, 0])[1].min() for f in range(FRAMES)])
        assert (off.min() > 0.115) if felt else (off.min() < 0.01)
    at = np.array([[0.0, 1.0, 0.0]])
    assert_allclose(nearest_off(at, np.zeros(3), np.zeros(3))[1], 1.0)  # a sphere is a capsule without length


def test_many_numbers_at_once_are_as_one_after_the_other():
    heads, rest = still(0.3, 0.0, 0.0)
    values = np.array([[0.5], [1.5]])
    both = tails(Springs(values, values, np.array([[0.4]]), np.zeros((1, 1))), heads, rest, 30.0, NONE)
    for row, one in enumerate((0.5, 1.5)):
        assert_allclose(both[:, row], tails(springs(one, one), heads, rest, 30.0, NONE), atol=0)


def test_turns_point_where_the_tail_is():
    rng = np.random.default_rng(0)
    heads, rest, at = rng.normal(size=(3, 20, 3))
    turn = shortest_turns(heads, rest, at)
    assert_allclose(np.linalg.det(turn), 1.0, atol=1e-9)
    pointed = np.einsum("nab,nb->na", turn, rest - heads)
    assert_allclose(np.cross(pointed, at - heads), 0.0, atol=1e-9)
    assert ((pointed * (at - heads)).sum(axis=1) > 0.0).all()
