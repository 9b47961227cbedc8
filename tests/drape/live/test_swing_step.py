"""Frames of swing: against the closed form of a hanging string, energy, rest, and what begins anew."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import jn_zeros

from drape.live.clock import PAUSE_S
from drape.live.swing_mesh import SwingMesh
from drape.live.swing_step import SwingConstants, SwingMemory, swing
from tests.drape.live.folds_setup import CUT_M
from tests.drape.live.swing_setup import LENGTH_M, constants, frame, hanging
from tests.reference.swing import pull_matrix

STILL = np.zeros(3)
STILL_S = 1.8  # after which nothing swings


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, SwingConstants]:
    rest, mesh = hanging()
    return rest, constants(mesh)


def pushed(made: SwingConstants, rest: np.ndarray, *, way_m: float = 0.01, fps: float = 120.0) -> SwingMemory:
    """What is remembered of a strip that hung, after its upper edge was moved along z for a tenth of a second, and
    stood."""
    memory = None
    for i in range(-1, int(0.1 * fps) + 1):
        origin = np.array([0.0, 0.0, way_m * min(1.0, 10.0 * max(i, 0) / fps)])
        _, memory = swing(made, memory, frame(rest, i / fps), origin)
    assert memory is not None
    return memory


def lowest(rest: np.ndarray) -> np.ndarray:
    return rest[:, 1] < -LENGTH_M + 1e-6


@pytest.mark.parametrize("length_m", [0.6, 0.9])
def test_a_strip_swings_as_a_hanging_string(length_m: float):
    """The first period of a string that hangs by its own weight is 4 pi / j01 sqrt(L / g) (Daniel Bernoulli, 1733)."""
    rest, mesh = hanging(length_m=length_m)
    made, fps = constants(mesh), 240.0
    memory = pushed(made, rest, fps=fps)
    height, time_s = [], memory.time_s
    for i in range(1, int(3.0 * fps)):
        x, memory = swing(made, _awake(memory), frame(rest, time_s + i / fps), memory.origin)
        height.append(float((x - rest)[rest[:, 1] < -length_m + 1e-6, 2].mean()))
    crossing = np.flatnonzero(np.diff(np.sign(height)))
    period_s = 2.0 * np.diff(crossing).mean() / fps
    assert len(crossing) >= 3
    assert_allclose(period_s, 4.0 * np.pi / jn_zeros(0, 1)[0] * np.sqrt(length_m / 9.81), rtol=0.08)


def _awake(memory: SwingMemory) -> SwingMemory:
    """``memory`` of a body that has just moved: one that stands slows its cloth."""
    return replace(memory, still_since_s=np.array([memory.time_s]))


def test_energy_never_grows_on_a_still_body():
    rest, mesh = hanging()
    made = constants(mesh)
    memory, energies = pushed(made, rest), []
    for i in range(1, 200):
        _, memory = swing(made, _awake(memory), frame(rest, 0.1 + i / 120.0), memory.origin)
        energies.append(_energy(mesh, memory))
    assert energies[0] > 1e-6 and (np.diff(energies) <= 1e-9 * energies[0]).all()
    assert energies[-1] < energies[0]


def _energy(mesh: SwingMesh, memory: SwingMemory) -> float:
    """Kinetic and of the weight [J], while cloth keeps its length."""
    u, free = memory.swung - memory.network, mesh.order
    kinetic = 0.5 * float((mesh.mass_kg[free, None] * memory.speed[free] ** 2).sum())
    return kinetic + 0.5 * float(np.einsum("ia,ij,ja->", u, pull_matrix(mesh), u))


def test_every_bit_is_still_after_two_seconds(scene: tuple[np.ndarray, SwingConstants]):
    rest, made = scene
    made = replace(made, damping_per_s=1.8)  # jersey's
    memory = pushed(made, rest, way_m=0.05, fps=30.0)
    swung = []
    for _ in range(75):
        x, memory = swing(made, memory, frame(rest, memory.time_s + 1.0 / 30.0), memory.origin)
        swung.append(1e3 * float(np.linalg.norm(x - rest, axis=1).max()))
    assert max(swung[:10]) > 5.0, "it swung"
    assert_array_equal(swung[round(STILL_S * 30.0) :], 0.0)
    assert swung[round(STILL_S * 30.0) - 2] < 1.0, "and was at rest before that [mm]"


def test_a_body_that_glides_drags_its_cloth_and_a_share_is_a_share(scene: tuple[np.ndarray, SwingConstants]):
    rest, made = scene
    memory, behind, half = None, rest, rest
    for i in range(12):
        origin = np.array([0.0, 0.0, 1.5 * (i / 30.0) ** 2])
        before = memory
        behind, memory = swing(made, before, frame(rest, i / 30.0), origin)
        half, _ = swing(made, before, frame(rest, i / 30.0), origin, share=0.5)
    hem = (behind - rest)[lowest(rest)]
    assert (hem[:, 2] < -0.02).all(), "it lags"
    assert (hem[:, 1] > 0.0).all(), "and rises, as it keeps its length"
    assert_allclose(half - rest, 0.5 * (behind - rest), atol=1e-6)
    held = rest[:, 1] > -1e-9
    assert_allclose(behind[held], rest[held], atol=1e-3)


@pytest.mark.parametrize("fps", [15.0, 30.0, 60.0])
def test_cloth_goes_down_with_a_body_that_falls(fps: float):
    """In free fall weight takes cloth along: a strip along the fall, past which the air goes, stays where it hung."""
    rest, mesh = hanging()
    made, memory, far = constants(mesh), None, []
    for i in range(-2, int(0.45 * fps) + 1):
        x, memory = swing(made, memory, frame(rest, i / fps), np.array([0.0, -4.9 * max(i / fps, 0.0) ** 2, 0.0]))
        far.append(float(np.linalg.norm(x - rest, axis=1).max()))
    assert max(far) < 1e-3


def test_taut_cloth_goes_up_with_its_body(scene: tuple[np.ndarray, SwingConstants]):
    rest, made = scene
    memory, far = None, []
    for i in range(-2, 13):
        x, memory = swing(made, memory, frame(rest, i / 30.0), np.array([0.0, 10.0 * max(i / 30.0, 0.0) ** 2, 0.0]))
        far.append(float(np.linalg.norm(x - rest, axis=1).max()))
    assert max(far) < 1e-3


def test_a_body_that_sinks_faster_than_weight_leaves_its_cloth_behind(scene: tuple[np.ndarray, SwingConstants]):
    rest, made = scene
    memory, x = None, rest
    for i in range(-2, 7):
        x, memory = swing(made, memory, frame(rest, i / 30.0), np.array([0.0, -15.0 * max(i / 30.0, 0.0) ** 2, 0.0]))
    risen = (x - rest)[lowest(rest), 1]
    assert (risen > 0.2).all() and (risen < (15.0 - 4.9) * 0.04).all(), "what weight does not give"


def test_a_body_that_is_met_in_motion_has_cloth_that_goes_with_it(scene: tuple[np.ndarray, SwingConstants]):
    rest, made = scene
    memory, x = None, rest
    for i in range(4):
        x, memory = swing(made, memory, frame(rest, i / 30.0), np.array([0.0, 0.0, 1.5 * i / 30.0]))
    assert np.linalg.norm(x - rest, axis=1).max() < 0.05, "air and length bend it a little"


def test_the_same_input_gives_the_same_bits(scene: tuple[np.ndarray, SwingConstants]):
    rest, made = scene
    memory = pushed(made, rest, fps=30.0)
    kept = {field.name: np.copy(getattr(memory, field.name)) for field in fields(memory)}
    first, after = swing(made, memory, frame(rest, 0.2), STILL)
    again, _ = swing(made, memory, frame(rest, 0.2), STILL)
    assert_array_equal(first, again)
    assert all(np.array_equal(getattr(memory, name), value) for name, value in kept.items())
    assert after.time_s == 0.2


@pytest.mark.parametrize("case", ["pause", "back", "again", "cut", "nan"])
def test_what_leads_nowhere_hangs_still(scene: tuple[np.ndarray, SwingConstants], case: str):
    rest, made = scene
    memory = pushed(made, rest, fps=30.0)
    time_s = memory.time_s + {"pause": 1.01 * PAUSE_S, "back": -0.01, "again": 0.0}.get(case, 1.0 / 30.0)
    there = rest + np.float32(1.01 * CUT_M) if case == "cut" else rest
    if case == "nan":
        memory = replace(memory, speed=np.full_like(memory.speed, np.nan))
    x, after = swing(made, memory, frame(there, time_s), memory.origin)
    assert_array_equal(x, there)
    assert not after.speed.any() and after.time_s == time_s
    assert_array_equal(after.swung, after.network)


def test_floats_swing_as_doubles_do():
    found = []
    for dtype in (np.float64, np.float32):
        rest, mesh = hanging(dtype)
        made, memory = constants(mesh, damping_per_s=1.0), None
        for number in range(8):
            origin = np.array([0.0, 0.0, 0.01 * number])
            x, memory = swing(made, memory, frame(rest.astype(dtype), 0.03 * number), origin)
        found.append(x - rest)
    assert_allclose(found[1], found[0], rtol=0.0, atol=1e-5)
    assert np.abs(found[0]).max() > 0.01
