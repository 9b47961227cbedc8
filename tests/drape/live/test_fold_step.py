"""One frame of folds: the engine against what is readable, its laws, and what makes it begin anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.problem import problem
from drape.cloth.waistband import SLACK_M
from drape.contact.skin import body_skin
from drape.engine.calls import call
from drape.engine.library import LANES
from drape.live.clock import PAUSE_S, Frame
from drape.live.fold_constants import LEASH_N_M3, LEAST, FoldConstants, fold_constants, leash_n_per_m, worn_cloth
from drape.live.fold_step import FoldEffort, FoldMemory, FoldReport, fold
from drape.live.skin_walks import TouchedSamples
from tests.drape.live.folds_setup import (
    CUT_M,
    EFFORT,
    FAR_M,
    constants,
    folded,
    frame,
    held_for,
    shifted,
    sleeve,
    turn_about_y,
    without_body,
)
from tests.fixtures.garments import shipped
from tests.fixtures.laws import each
from tests.reference import folds as reference
from tests.reference import pace as pacing
from tests.reference.skin import touch

UP = np.array([0.0, 1.0, 0.0])


def frames(count: int, rotation: np.ndarray | None = None) -> list[Frame]:
    return [frame(sleeve()[0], number, rotation=rotation) for number in range(count)]


def after_one() -> FoldMemory:
    """What is remembered of the first frame."""
    return fold(constants(), None, frames(1)[0], EFFORT)[1]


@pytest.mark.parametrize(("material", "creased"), [("rib", False), ("poplin", True)])
def test_the_compiled_step_equals_the_readable_one(material, creased):
    rest, worn = sleeve(material, creased=creased)
    made = constants(material, creased=creased, dtype=np.float64)
    effort = EFFORT._replace(settle=pacing.LONG_ROUNDS) if creased else EFFORT
    memory, wanted_memory, place = None, None, made.sheet.place
    for one in (frame(rest, number) for number in range(6)):
        x, memory, _ = fold(made, memory, one, effort)
        wanted, wanted_memory = reference.fold(worn, wanted_memory, one, effort)
        assert_allclose(x, wanted, rtol=0.0, atol=1e-10)
        for found, other in zip(memory.touched, wanted_memory.touched, strict=True):
            assert_array_equal(found[place], other)
        for name, most in (("residual", 1e-10), ("velocity", 1e-8), ("grip", 1e-10)):
            assert_allclose(getattr(memory, name)[place], getattr(wanted_memory, name), rtol=0.0, atol=most)
    assert memory is not None and np.abs(memory.residual).max() > 1e-3, "the frames are not at rest"
    assert (memory.touched.other >= 0).any(), "and the sleeve is at the wall"


def test_float32_follows_float64():
    single, double = (folded(constants(dtype=dtype), frames(3)) for dtype in (np.float32, np.float64))
    for (x, memory, _), (wanted, _, _) in zip(single, double, strict=True):
        assert x.dtype == memory.residual.dtype == memory.velocity.dtype == memory.grip.dtype == np.float32
        assert memory.touched.own.dtype == memory.touched.other.dtype == np.int32
        assert_allclose(x, wanted, rtol=0.0, atol=1e-4)  # metres; the sleeve is 120 mm long


def test_the_same_input_gives_the_same_bits_and_a_memory_is_not_touched():
    memory = after_one()
    arrays = (memory.network, memory.residual, memory.velocity, memory.grip, *memory.touched)
    kept = [array.copy() for array in arrays]
    first, second = (fold(constants(), memory, frames(2)[1], EFFORT) for _ in range(2))
    assert_array_equal(first[0], second[0])
    assert_array_equal(first[1].residual, second[1].residual)
    for before, array in zip(kept, arrays, strict=True):
        assert_array_equal(before, array)


def test_folds_turn_with_the_body():
    made, rotation = constants(dtype=np.float64), turn_about_y(1.1)
    plain, turned = folded(made, frames(3)), folded(made, frames(3, rotation))
    for (x, memory, _), (y, other, _) in zip(plain, turned, strict=True):
        assert_allclose(y, x @ rotation.T, rtol=0.0, atol=1e-9)
        assert_allclose(other.residual, memory.residual, rtol=0.0, atol=1e-9)


def test_folds_lower_the_energy_and_more_of_them_lower_it_further():
    rest, worn = sleeve(creased=False)
    made, flat = constants(creased=False, dtype=np.float64), problem(worn.cloth, worn.material, dtype=np.float64)
    one = frame(rest, 0)
    nowhere = TouchedSamples(worn.index, np.full_like(worn.index, -1))
    touched, _ = touch(one.vertices, one.vertices, one.skin, worn.graph, nowhere, -1)

    def energy(x: np.ndarray) -> float:
        around = reference.touching(flat, worn, x, one.skin, touched)
        held = replace(around.own, band=one.vertices, band_n_per_m=worn.band_n_per_m)
        return reference.energy(x, flat, around._replace(own=held))

    before = energy(one.vertices)
    after = [energy(fold(made, None, one, FoldEffort(steps=steps, settle=1))[0]) for steps in (1, 4, 16)]
    assert before > 4.0 * after[0] and after[0] > after[1] > after[2]
    standing = [energy(x) for x, _, _ in folded(made, held_for(one, 12))]
    assert standing[-1] < standing[1] < standing[0], "folds go on from the frame before"


def test_the_way_of_the_folds_goes_with_the_clock():
    made, (first, second) = constants(dtype=np.float64), frames(2)
    _, memory, _ = fold(made, None, first, EFFORT)
    half, slow = replace(memory, velocity=0.5 * memory.velocity), replace(second, time_s=2.0 / 30.0)
    assert_allclose(fold(made, half, slow, EFFORT)[0], fold(made, memory, second, EFFORT)[0], rtol=0.0, atol=1e-12)


@each(later_s=(-0.01, PAUSE_S + 0.01))
def test_a_jump_of_the_clock_forgets(later_s):
    jumped = replace(frames(2)[1], time_s=later_s)
    x, _, report = fold(constants(), after_one(), jumped, EFFORT)
    assert report.settled and not report.reset
    assert_array_equal(x, fold(constants(), None, jumped, EFFORT)[0])


@each(way=((0.9 * CUT_M, False), (1.1 * CUT_M, True)))
def test_a_cut_forgets(way):
    one = frame(sleeve()[0], 0, noise_m=0.0)
    before = replace(after_one(), network=one.vertices[constants().sheet.vertex].astype(np.float32))
    report = fold(constants(), before, replace(shifted(one, way[0] * UP), time_s=1.0 / 30.0), EFFORT)[2]
    assert report.settled == report.reset == way[1], "and it is told"


@each(broken=(np.nan, np.inf, 2.0 * FAR_M))
def test_what_is_no_fold_begins_anew(broken):
    memory, one = after_one(), frames(2)[1]
    lost = replace(memory, residual=np.full_like(memory.residual, broken))
    x, after, report = fold(constants(), lost, one, EFFORT)
    wanted, wanted_after, _ = fold(constants(), None, one, EFFORT)
    assert report.settled and report.reset
    assert_array_equal(x, wanted)
    assert_array_equal(after.residual, wanted_after.residual)


def test_where_no_start_leads_to_folds_the_network_is_left_as_it_is():
    sheet, one = constants().sheet, frames(1)[0]
    broken = replace(constants(), sheet=sheet._replace(own=np.full_like(sheet.own, np.nan)))
    x, memory, report = fold(broken, None, one, EFFORT)
    assert report == FoldReport(settled=True, reset=True)
    assert_array_equal(x, one.vertices)
    assert not memory.residual.any() and not memory.velocity.any()


@each(material=("rib", "poplin"), way_m=(0.005, 0.015, 0.04))
def test_fast_motion_has_its_own_pace(way_m, material):
    rest, worn = sleeve(material)
    made, still = constants(material, dtype=np.float64), frame(rest, 1)
    _, memory, _ = fold(made, None, frame(rest, 0), EFFORT)
    _, wanted_memory = reference.fold(worn, None, frame(rest, 0), EFFORT)
    before = replace(memory, network=(still.vertices - way_m * UP)[made.sheet.vertex])
    wanted_before = replace(wanted_memory, network=still.vertices - way_m * UP)
    x, _, _ = fold(made, before, still, EFFORT)
    assert_allclose(x, reference.fold(worn, wanted_before, still, EFFORT)[0], rtol=0.0, atol=1e-10)


@each(step_s=(1.0 / 60.0, 1.0 / 15.0), stiff=(False, True), way_m=(0.0, 0.001, 0.01, 0.013, 0.02, 0.1))
def test_the_pace_is_the_readable_one(step_s, stiff, way_m):
    call("law_pace", np.float64, way_m, step_s, stiff, found := np.empty(4))
    calm, untangled_m = pacing.calmness(way_m), min(max(way_m, 0.0003), 0.002)
    wanted = (calm, pacing.grip_left(way_m, step_s), untangled_m, pacing.momentum_of(calm, stiff=stiff))
    assert_allclose(found, wanted, rtol=1e-12)


def test_folds_without_steps_fade_with_the_clock_and_come_back():
    worn, made, none = sleeve()[1], constants(dtype=np.float64), FoldEffort(steps=0)
    place, held = made.sheet.place, frames(3)[-1]
    memory, wanted_memory = folded(made, frames(3))[-1][1], None
    for one in frames(3):
        _, wanted_memory = reference.fold(worn, wanted_memory, one, EFFORT)
    begun_m = np.abs(memory.residual[place]).max()
    for later in held_for(held, 30, start=3):
        x, memory, report = fold(made, memory, later, none)
        wanted, wanted_memory = reference.fold(worn, wanted_memory, later, none)
        assert_allclose(x, wanted, rtol=0.0, atol=1e-10)
        assert not report.settled and not report.reset and not memory.velocity.any()
    left = np.abs(memory.residual[place]).max() / begun_m
    assert_allclose(left, np.exp(-1.0 / pacing.FADE_S), rtol=0.0, atol=1e-3)
    x, _, _ = fold(made, memory, replace(held, time_s=33.0 / 30.0), EFFORT)
    assert np.abs(x - held.vertices).max() > left * begun_m, "computed again they grow"
    first, _, report = fold(made, None, held, none._replace(clearance_m=0.0))
    assert report.settled
    assert_array_equal(first, held.vertices)
    first, _, _ = fold(made, None, held, none)
    assert_allclose(first, reference.fold(worn, None, held, none)[0], rtol=0.0, atol=1e-10)
    assert not np.array_equal(first, held.vertices), "no energy is looked at, but what is in the skin is lifted"


@each(garment=(("tshirt", False), ("trousers", True)))
def test_cloth_is_held_where_the_network_has_it_and_a_waistband_more(garment, body):
    made, worn = fold_constants(shipped(garment[0]), body), worn_cloth(shipped(garment[0]), body)
    leash = LEASH_N_M3 * worn.cloth.vertex_area
    assert (worn.band_n_per_m >= 0.999 * LEAST * leash).all()
    assert ((worn.band_n_per_m > 2.0 * leash).mean() > 0.004) == garment[1]
    own = made.sheet.own.reshape(-1, 4, LANES)[:, 3].reshape(-1)
    assert_allclose(own[made.sheet.place], worn.band_n_per_m, rtol=1e-6)


def test_what_lies_on_the_skin_is_held_and_what_hangs_hardly(body):
    skin, index, height_m = body_skin(body), np.array([3, 500, 900]), np.array([0.004, 0.0175, 0.2])
    held = leash_n_per_m(skin.point[index] + height_m[:, None] * skin.normal[index], np.full(3, 1e-4), skin, index)
    assert_allclose(held, LEASH_N_M3 * 1e-4 * np.array([1.0, 0.5, LEAST]), rtol=1e-9)


def test_a_sleeve_that_slips_is_held_by_its_leash():
    """Without a body weight and leash balance where it has sunk by weight / leash past the centimetre that is free."""
    rest, loose = sleeve(creased=False)
    area, leash = loose.cloth.vertex_area, 400.0
    weight = float(loose.material.density_kg_m2 * loose.material.gravity_m_s2)
    made = FoldConstants.of(replace(loose, band_n_per_m=leash * area), dtype=np.float64)
    one = without_body(frame(rest, 0, noise_m=0.0))
    sunk = (one.vertices - folded(made, held_for(one, 400))[-1][0])[:, 1]
    assert_allclose(np.average(sunk, weights=area), SLACK_M + weight / leash, rtol=0.02)


@each(dtype=(np.float32, np.float64))
def test_the_farthest_place_is_told(rng, dtype):
    x, y = rng.normal(size=(2, 3 * LANES, 3)).astype(dtype)
    wanted = np.linalg.norm(x - y, axis=1).max()
    call("law_farthest", dtype, x, y, len(x), found := np.empty(1, dtype))
    assert_allclose(found, wanted, rtol=4.0 * np.finfo(dtype).eps)
    x[5, 1] = np.nan
    call("law_farthest", dtype, x, y, len(x), found)
    assert np.isnan(found)
