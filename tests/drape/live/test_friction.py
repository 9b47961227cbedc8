"""Friction with the skin: Coulomb's on a slope, and what lies on skin that moves goes with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh
from drape.cloth.problem import problem
from drape.contact.samples import Samples, sample_table
from drape.engine.calls import call
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.live.clock import Frame
from drape.live.fold_constants import FoldConstants, WornCloth
from drape.live.fold_step import FoldEffort, fold
from drape.live.skin_walks import SkinGraph, TouchedSamples, nearest_at_rest, skin_graph
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.cloth.solver_setup import MATERIALS
from tests.drape.live.folds_setup import folded, frame, held_for, shifted, sleeve, turn_about_y
from tests.fixtures.laws import each
from tests.reference import folds as reference
from tests.reference.folds import SLIP_M

FRAMES, SPACING_M = 20, 0.02


def slope(angle_rad: float, friction: float) -> tuple[np.ndarray, WornCloth, np.ndarray]:
    """A sheet that nothing holds on a slope [rad] about the z axis: its vertices, itself, and the posed samples."""
    flat, faces = grid(5, 5, cell_m=0.02)
    flat = flat @ np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # laid down: the normal is up
    flat -= flat.mean(axis=0)
    rows = SPACING_M * np.arange(-8, 9)
    point = np.stack(np.meshgrid(rows, [0.0], rows), axis=-1).reshape(-1, 3)
    normal = np.tile([0.0, 1.0, 0.0], (len(point), 1))
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    tilt = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    none = scipy.sparse.csr_matrix((3 * len(point), 1))
    skin = Samples(none, point, normal, np.full(len(point), SPACING_M))
    rest = flat + np.array([0.0, 0.004, 0.0])
    dressed = WornCloth(
        cloth=ClothMesh.from_rest(rest, faces),
        material=MATERIALS["rib"],
        band_n_per_m=np.zeros(len(rest)),
        graph=skin_graph(skin),
        index=nearest_at_rest(rest, skin),
        friction=friction,
    )
    return rest @ tilt.T, dressed, np.asarray(sample_table(point @ tilt.T, normal @ tilt.T))


def slid_m(angle_rad: float, friction: float) -> np.ndarray:
    """How far down the slope the sheet's middle goes in each frame."""
    start, worn, skin = slope(angle_rad, friction)
    made, frames = FoldConstants.of(worn, dtype=np.float64), held_for(Frame(start, skin, 0.0), FRAMES)
    found = folded(made, frames, FoldEffort(16))
    assert not any(report.reset for _, _, report in found)
    down = -np.array([np.cos(angle_rad), np.sin(angle_rad), 0.0])
    return np.diff([x.mean(axis=0) for x, _, _ in found], axis=0) @ down


def test_cloth_keeps_to_a_slope_that_is_less_steep_than_its_friction_and_slides_down_a_steeper_one():
    assert np.abs(slid_m(np.arctan(0.3), 0.5).sum()) < 2.0 * SLIP_M, "friction is a spring as far as that"
    assert slid_m(np.arctan(0.8), 0.5).sum() > 8.0 * SLIP_M


def test_without_friction_it_slides_and_a_frame_without_a_past_has_none():
    angle = np.arctan(0.3)
    assert slid_m(angle, 0.0).sum() > 15.0 * SLIP_M
    start, worn, skin = slope(angle, 0.5)
    made, one = FoldConstants.of(worn, dtype=np.float64), Frame(start, skin, 0.0)
    rough, slippery = (fold(item, None, one, FoldEffort(2))[0] for item in (made, replace(made, friction=0.0)))
    assert_array_equal(rough, slippery)


@each(slip_m=(0.3 * SLIP_M, 4.0 * SLIP_M))
def test_its_force_is_coulombs(slip_m: float):
    start, dressed, skin = slope(0.0, 0.5)
    made = problem(dressed.cloth, dressed.material, dtype=np.float64)
    x = start - [0.0, 0.001, 0.0]  # a millimetre inside the gap of contact
    nowhere = TouchedSamples(dressed.index, np.full_like(dressed.index, -1))
    around = reference.touching(made, dressed, x, skin, nowhere)
    way = np.array([0.6, 0.3, 0.8]) / np.hypot(0.6, 0.8)  # lifted as well: that is no slip
    around = around._replace(stuck=x - slip_m * way, friction=0.5)
    force, hessian = reference.rubbed(x, made, around, slice(None))
    press_n = 0.001 * made.contact_n_per_m
    along = way * [1.0, 0.0, 1.0]
    assert_allclose(force, 0.5 * min(slip_m / SLIP_M, 1.0) * press_n[:, None] * along, rtol=1e-6)
    assert np.linalg.eigvalsh(hessian).min() > -1e-9
    lifted = around._replace(own=replace(around.own, point=around.own.point - [0.0, 0.002, 0.0]))
    assert not reference.rubbed(x, made, lifted, slice(None))[0].any()


def in_blocks(rows: np.ndarray) -> np.ndarray:
    """``rows``, and again from the first one on up to a whole number of blocks."""
    return np.resize(rows, (len(rows) + -len(rows) % LANES, *rows.shape[1:]))


def stuck_places(grip: np.ndarray, own: np.ndarray, skin: np.ndarray, graph: SkinGraph) -> np.ndarray:
    """Where the posed ``skin`` has taken what lies ``grip`` [m] (P, 3) in the frames of its samples ``own`` (P,)."""
    found, record = np.empty_like(grip), Record("SkinGraph", graph)
    call("law_stuck_places", np.float64, grip, len(grip), own, skin, len(skin), record, found)
    return found


def test_what_sticks_to_the_skin_goes_with_it_as_a_solid_where_it_moves_as_one():
    rest, worn = sleeve()
    one, turn, way = frame(rest, 0), turn_about_y(0.4), np.array([0.1, 0.2, -0.3])
    skin, graph = one.skin.astype(np.float64), worn.graph
    moved = np.asarray(sample_table(skin[:, :3] @ turn.T + way, skin[:, 4:7] @ turn.T), dtype=np.float64)
    own, x = in_blocks(worn.index), in_blocks(one.vertices.astype(np.float64))
    grip, count = np.empty_like(x), (len(skin), Record("SkinGraph", graph))
    call("write_grip", np.float64, x, len(x), x, own, skin, *count, grip)
    found = stuck_places(grip, own, moved, graph)
    assert_allclose(found, x @ turn.T + way, rtol=0.0, atol=1e-9)
    assert_allclose(grip, reference.write_grip(x, x, skin, graph, own), rtol=0.0, atol=1e-12)
    assert_allclose(found, reference.stuck_places(grip, moved, graph, own), rtol=0.0, atol=1e-12)


def test_a_sample_without_neighbours_takes_cloth_along_its_normal():
    graph = SkinGraph(np.zeros((1, 8), np.int32), np.ones(1), np.zeros((1, 3)))
    skin = np.asarray(sample_table(np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]])), dtype=np.float64)
    found = stuck_places(in_blocks(np.array([[0.01, 0.02, 0.03]])), np.zeros(LANES, np.int32), skin, graph)
    assert_allclose(found, np.tile([0.0, 0.01, 0.0], (LANES, 1)), atol=1e-15)


@each(case=((0.0, 0.0, 1e-4), (0.5, 0.022, 3.0 * SLIP_M)))
def test_skin_that_moves_on_takes_along_what_lies_on_it_by_friction_alone(case):
    friction, moved_m, within_m = case
    start, worn, skin = slope(0.0, friction)
    frames = [shifted(Frame(start, skin, i / 30.0), np.array([0.002 * i, 0.0, 0.0]), cloth=False) for i in range(12)]
    x = folded(FoldConstants.of(worn, dtype=np.float64), frames, FoldEffort(16))[-1][0]
    assert float((x - start)[:, 0].mean()) == pytest.approx(moved_m, abs=within_m)
