"""One frame of folds: compiled against readable, its laws, and what makes it begin anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.catalog import find_garments, open_garment
from drape.cloth.waistband import SLACK_M
from drape.contact.skin import body_skin
from drape.kernels.problem import problem
from drape.live.clock import CUT_M, PAUSE_S
from drape.live.fold_constants import LEASH_N_M3, LEAST, FoldConstants, fold_constants, leash_n_per_m, worn_cloth
from drape.live.fold_step import (
    FADE_S,
    FAR_M,
    FAST_M,
    FAST_SWEEPS,
    LONG_ROUNDS,
    MEND_M,
    MOMENTUM,
    SLOW_M,
    STIFF_MOMENTUM,
    STIFF_SHARE,
    FoldEffort,
    FoldMemory,
    FoldReport,
    Frame,
    calmness,
    fold,
    paced,
)
from drape.live.sheet import LANES
from drape.live.skin_contact import TouchedSamples
from drape.live.surface_frames import mend
from tests.drape.live.folds_setup import frame, sleeve, turn_about_y
from tests.reference import folds as reference

EFFORT = FoldEffort(steps=2, settle=2)


def folded(
    constants: FoldConstants, frames: list[Frame], effort: FoldEffort = EFFORT
) -> list[tuple[np.ndarray, FoldMemory, FoldReport]]:
    """What ``fold`` gives of ``frames``, one after the other."""
    found, memory = [], None
    for one in frames:
        found.append(fold(constants, memory, one, effort))
        memory = found[-1][1]
    return found


@pytest.mark.parametrize("material", ["rib", "poplin"])
@pytest.mark.parametrize("creased", [False, True])
def test_the_compiled_step_equals_the_readable_one(material, creased):
    rest, dressed = sleeve(material, creased=creased)
    constants, effort = FoldConstants.of(dressed, dtype=np.float64), EFFORT
    if creased:
        effort = replace(effort, settle=LONG_ROUNDS)
    memory, wanted_memory = None, None
    for one in (frame(rest, number) for number in range(6)):
        x, memory, _ = fold(constants, memory, one, effort)
        wanted, wanted_memory = reference.fold(dressed, wanted_memory, one, effort)
        assert_allclose(x, wanted, rtol=0.0, atol=1e-10)
        place = constants.sheet.place
        for found, other in zip(memory.touched, wanted_memory.touched, strict=True):
            assert_array_equal(found[place], other)
        assert_allclose(memory.residual[place], wanted_memory.residual, rtol=0.0, atol=1e-10)
        assert_allclose(memory.velocity[place], wanted_memory.velocity, rtol=0.0, atol=1e-8)
        assert_allclose(memory.grip[place], wanted_memory.grip, rtol=0.0, atol=1e-10)
    assert memory is not None and np.abs(memory.residual).max() > 1e-3, "the frames are not at rest"
    assert (memory.touched.other >= 0).any(), "and the sleeve is at the wall"


def test_float32_follows_float64():
    rest, dressed = sleeve()
    frames = [frame(rest, number) for number in range(3)]
    single, double = (folded(FoldConstants.of(dressed, dtype=dtype), frames) for dtype in (np.float32, np.float64))
    for (x, memory, _), (wanted, _, _) in zip(single, double, strict=True):
        assert x.dtype == memory.residual.dtype == memory.velocity.dtype == memory.grip.dtype == np.float32
        assert memory.touched.own.dtype == memory.touched.other.dtype == np.int32
        assert_allclose(x, wanted, rtol=0.0, atol=1e-4)  # metres; the sleeve is 120 mm long


def test_the_same_input_gives_the_same_bits_and_a_memory_is_not_touched():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed)
    _, memory, _ = fold(constants, None, frame(rest, 0), EFFORT)
    arrays = (memory.network, memory.residual, memory.velocity, memory.grip, *memory.touched)
    kept = [array.copy() for array in arrays]
    first, second = (fold(constants, memory, frame(rest, 1), EFFORT) for _ in range(2))
    assert_array_equal(first[0], second[0])
    assert_array_equal(first[1].residual, second[1].residual)
    for before, array in zip(kept, arrays, strict=True):
        assert_array_equal(before, array)


def test_folds_turn_with_the_body():
    rest, dressed = sleeve()
    constants, rotation = FoldConstants.of(dressed, dtype=np.float64), turn_about_y(1.1)
    plain = folded(constants, [frame(rest, number) for number in range(3)])
    turned = folded(constants, [frame(rest, number, rotation=rotation) for number in range(3)])
    for (x, memory, _), (y, other, _) in zip(plain, turned, strict=True):
        assert_allclose(y, x @ rotation.T, rtol=0.0, atol=1e-9)
        assert_allclose(other.residual, memory.residual, rtol=0.0, atol=1e-9)


def test_folds_lower_the_energy_and_more_of_them_lower_it_further():
    rest, dressed = sleeve(creased=False)
    constants, made = (
        FoldConstants.of(dressed, dtype=np.float64),
        problem(dressed.cloth, dressed.material, dtype=np.float64),
    )
    one = frame(rest, 0)
    nowhere = TouchedSamples(dressed.index, np.full_like(dressed.index, -1))
    touched = reference.touch(one.vertices, one.skin, dressed.graph, nowhere, -1)

    def energy(x: np.ndarray) -> float:
        around = reference.touching(made, dressed, x, one.skin, touched)
        held = around.own._replace(band=one.vertices, band_n_per_m=dressed.band_n_per_m)
        return reference.energy(x, made, around._replace(own=held))

    before = energy(one.vertices)
    after = [energy(fold(constants, None, one, FoldEffort(steps=sweeps, settle=1))[0]) for sweeps in (1, 4, 16)]
    assert before > 4.0 * after[0] and after[0] > after[1] > after[2]
    standing, memory = [], None
    for number in range(12):
        x, memory, _ = fold(constants, memory, replace(one, time_s=number / 30.0), EFFORT)
        standing.append(energy(x))
    assert standing[-1] < standing[1] < standing[0], "folds go on from the frame before"


def test_the_way_of_the_folds_goes_with_the_clock():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed, dtype=np.float64)
    _, memory, _ = fold(constants, None, frame(rest, 0), EFFORT)
    next_frame = frame(rest, 1)
    half = replace(memory, velocity=0.5 * memory.velocity)
    slow, fast = replace(next_frame, time_s=2.0 / 30.0), replace(next_frame, time_s=1.0 / 30.0)
    assert_allclose(
        fold(constants, half, slow, EFFORT)[0], fold(constants, memory, fast, EFFORT)[0], rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize("later_s", [-0.01, PAUSE_S + 0.01])
def test_a_jump_of_the_clock_forgets(later_s):
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed)
    _, memory, first = fold(constants, None, frame(rest, 0), EFFORT)
    jumped = replace(frame(rest, 1), time_s=later_s)
    x, _, report = fold(constants, memory, jumped, EFFORT)
    assert first.settled and report.settled and not report.reset
    assert_array_equal(x, fold(constants, None, jumped, EFFORT)[0])


def test_a_cut_forgets():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed)
    _, memory, _ = fold(constants, None, frame(rest, 0), EFFORT)
    for way_m, settled in ((0.9 * CUT_M, False), (1.1 * CUT_M, True)):
        moved = frame(rest, 0, noise_m=0.0)
        shift = np.array([0.0, way_m, 0.0])
        skin = moved.skin.copy()
        skin[:, :3] += shift
        skin[:, 7] = (skin[:, :3] * skin[:, 4:7]).sum(axis=1)
        before = replace(memory, network=moved.vertices[constants.sheet.vertex].astype(np.float32))
        report = fold(constants, before, Frame(moved.vertices + shift, skin, 1.0 / 30.0), EFFORT)[2]
        assert report.settled == settled and not report.reset


@pytest.mark.parametrize("broken", [np.nan, np.inf, 2.0 * FAR_M])
def test_what_is_no_fold_begins_anew(broken):
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed)
    _, memory, _ = fold(constants, None, frame(rest, 0), EFFORT)
    residual = memory.residual.copy()
    residual[:] = broken
    x, after, report = fold(constants, replace(memory, residual=residual), frame(rest, 1), EFFORT)
    wanted, wanted_after, _ = fold(constants, None, frame(rest, 1), EFFORT)
    assert report.settled and report.reset
    assert_array_equal(x, wanted)
    assert_array_equal(after.residual, wanted_after.residual)


def test_where_no_start_leads_to_folds_the_network_is_left_as_it_is():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed)
    heavy = constants.sheet.own.copy()
    heavy[:] = np.nan
    broken = constants._replace(sheet=constants.sheet._replace(own=heavy))
    one = frame(rest, 0)
    x, memory, report = fold(broken, None, one, EFFORT)
    assert report == FoldReport(settled=True, reset=True)
    assert_array_equal(x, one.vertices)
    assert not memory.residual.any() and not memory.velocity.any()


@pytest.mark.parametrize("material", ["rib", "poplin"])
@pytest.mark.parametrize(("way_m", "calm"), [(0.5 * SLOW_M, 1.0), (0.5 * (SLOW_M + FAST_M), 0.5), (2.0 * FAST_M, 0.0)])
def test_fast_motion_has_its_own_pace(way_m, calm, material):
    rest, dressed = sleeve(material)
    assert_allclose(calmness(rest, rest + np.array([0.0, way_m, 0.0])), calm, rtol=0.0, atol=1e-9)
    constants = FoldConstants.of(dressed, dtype=np.float64)
    _, memory, _ = fold(constants, None, frame(rest, 0), EFFORT)
    _, wanted_memory = reference.fold(dressed, None, frame(rest, 0), EFFORT)
    still = frame(rest, 1)
    shift = np.array([0.0, way_m, 0.0])
    before = replace(memory, network=(still.vertices - shift)[constants.sheet.vertex])
    wanted_before = replace(wanted_memory, network=still.vertices - shift)
    x, _, _ = fold(constants, before, still, EFFORT)
    assert_allclose(x, reference.fold(dressed, wanted_before, still, EFFORT)[0], rtol=0.0, atol=1e-10)


def test_what_an_effort_stands_for():
    for stiff in (False, True):
        slow = [paced(effort, 1.0, stiff=stiff) for effort in (1, 2, 5, 16)]
        assert [(pace.steps, pace.sweeps) for pace in slow] == [(1, 1), (2, 1), (5, 3), (16, 8)]
        assert {(pace.share, pace.momentum) for pace in slow} == {(1.0, MOMENTUM)}
    assert paced(2, 0.5, stiff=False)[:3] == (2, 1 + FAST_SWEEPS, 0.5)
    assert paced(2, 0.0, stiff=False)[:3] == (0, 2 + FAST_SWEEPS, 0.0), "steps of the whole are left out"
    assert paced(2, 0.0, stiff=True) == (2, 2 + FAST_SWEEPS, STIFF_SHARE, STIFF_MOMENTUM), "they stay"


def test_folds_that_are_carried_along_fade_with_the_clock_and_come_back():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed, dtype=np.float64)
    carried, place = FoldEffort(steps=0), constants.sheet.place
    _, memory, _ = folded(constants, [frame(rest, number) for number in range(3)])[-1]
    wanted_memory, begun_m = None, np.abs(memory.residual[place]).max()
    for one in (frame(rest, number) for number in range(3)):
        _, wanted_memory = reference.fold(dressed, wanted_memory, one, EFFORT)
    held = frame(rest, 2)
    for number in range(1, 31):
        later = replace(held, time_s=held.time_s + number / 30.0)
        x, after, report = fold(constants, memory, later, carried)
        wanted, wanted_memory = reference.fold(dressed, wanted_memory, later, carried)
        assert_allclose(x, wanted, rtol=0.0, atol=1e-10)
        assert not report.settled and not report.reset and not after.velocity.any()
        memory = after
    left = np.abs(memory.residual[place]).max() / begun_m
    assert_allclose(left, np.exp(-1.0 / FADE_S), rtol=0.0, atol=1e-3)
    x, _, _ = fold(constants, memory, replace(held, time_s=held.time_s + 31.0 / 30.0), EFFORT)
    assert np.abs(x - held.vertices).max() > left * begun_m, "computed again they grow"
    first, _, report = fold(constants, None, held, replace(carried, clearance_m=0.0))
    assert report.settled
    assert_array_equal(first, held.vertices)
    first, _, _ = fold(constants, None, held, carried)
    assert_allclose(first, reference.fold(dressed, None, held, carried)[0], rtol=0.0, atol=1e-10)
    assert not np.array_equal(first, held.vertices), "no energy is looked at, but what is in the skin is lifted"


def test_a_residual_far_from_its_neighbours_follows_them(rng):
    rest, dressed = sleeve()
    sheet = FoldConstants.of(dressed, dtype=np.float64).sheet
    off = 0.01 * rng.normal(size=rest.shape)
    off[7] += 0.05
    found = off[sheet.vertex]
    mend(found, sheet, MEND_M)
    wanted = reference.mended(off, dressed.cloth.faces)
    assert_allclose(found[sheet.place], wanted, rtol=0.0, atol=1e-15)
    kept = (wanted == off).all(axis=1)
    assert not kept[7] and kept.any() and np.linalg.norm(wanted[7]) < 0.02


def test_cloth_is_held_where_the_network_has_it_and_a_waistband_more():
    body = load_body()
    for name, banded in (("tshirt", False), ("trousers", True)):
        garment = open_garment(find_garments([name])[0], body)
        made = fold_constants(garment, body)
        found = worn_cloth(garment, body)
        leash = LEASH_N_M3 * found.cloth.vertex_area
        assert (found.band_n_per_m >= 0.999 * LEAST * leash).all()
        assert ((found.band_n_per_m > 2.0 * leash).mean() > 0.004) == banded
        own = made.sheet.own.reshape(-1, 4, LANES)[:, 3].reshape(-1)
        assert_allclose(own[made.sheet.place], found.band_n_per_m, rtol=1e-6)


def test_what_lies_on_the_skin_is_held_and_what_hangs_hardly():
    body = load_body()
    skin = body_skin(body)
    index = np.array([3, 500, 900])
    height_m = np.array([0.004, 0.0175, 0.2])
    held = leash_n_per_m(skin.point[index] + height_m[:, None] * skin.normal[index], np.full(3, 1e-4), skin, index)
    assert_allclose(held, LEASH_N_M3 * 1e-4 * np.array([1.0, 0.5, LEAST]), rtol=1e-9)


def test_a_sleeve_that_slips_is_held_by_its_leash():
    """Without a body weight and leash balance where it has sunk by weight / leash past the centimetre that is free."""
    rest, loose = sleeve(creased=False)
    area = loose.cloth.vertex_area
    leash, weight = 400.0, float(loose.material.density_kg_m2 * loose.material.gravity_m_s2)
    held = replace(loose, band_n_per_m=leash * area)
    made = FoldConstants.of(held, dtype=np.float64)
    one = frame(rest, 0, noise_m=0.0)
    far = np.asarray(one.skin).copy()
    far[:, :3] += 5.0  # no body is near
    far[:, 7] = (far[:, :3] * far[:, 4:7]).sum(axis=1)
    memory = None
    for number in range(400):
        x, memory, _ = fold(made, memory, Frame(one.vertices, far, number / 30.0), EFFORT)
    sunk = (one.vertices - x)[:, 1]
    assert_allclose(np.average(sunk, weights=area), SLACK_M + weight / leash, rtol=0.02)
