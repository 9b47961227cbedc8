"""Room between sheets: found as the readable way finds it, and cloth keeps within it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh
from drape.kernels.problem import problem
from drape.live.fold_constants import LEASH_N_M3, FoldConstants
from drape.live.fold_step import FoldEffort, Frame, fold
from drape.live.room import BOUND_M2, LEAST_M, ROOM_M, rooms, sheet_neighbours
from drape.live.sheet import LANES
from drape.live.skin_contact import TouchedSamples
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.live.folds_setup import frame, sleeve
from tests.reference import folds as reference
from tests.reference.solver import energy_and_gradient

OPEN, HELD = FoldEffort(steps=2, settle=2), FoldEffort(steps=2, settle=2, cloth_contact=True)


def without_body(one: Frame) -> Frame:
    """``one`` with the body far away."""
    far = one.skin.copy()
    far[:, :3] += 5.0
    far[:, 7] = (far[:, :3] * far[:, 4:7]).sum(axis=1)
    return replace(one, skin=far)


def flattened(one: Frame, share: float) -> Frame:
    """``one`` with the network's sleeve pressed flat, to ``share`` of its depth."""
    pressed = one.vertices.copy()
    pressed[:, 2] = share * (pressed[:, 2] - pressed[:, 2].mean())
    return replace(one, vertices=pressed)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_rooms_are_those_of_all_pairs(rng, dtype):
    for vertices, faces in (tube(24, 30, radius_m=0.031, height_m=0.14), grid(12, 9, cell_m=0.006)):
        cloth = ClothMesh.from_rest(vertices, faces)
        crumpled = vertices * [1.0, 0.6, 0.3] + 0.002 * rng.normal(size=vertices.shape)
        found = np.empty(len(vertices), dtype)
        rooms(crumpled.astype(dtype), sheet_neighbours(cloth), found)
        assert_allclose(found, reference.room(crumpled, cloth), rtol=0.0, atol=1e-7)
        assert 0.0 < found.min() < 0.5 * ROOM_M, "somewhere cloth is near to itself"


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("side_m", [0.06, 0.15, 0.4])
def test_rooms_in_a_cloud_are_those_of_all_pairs(rng, dtype, side_m):
    """Vertices anywhere in a box, of a cloth in two pieces: most have many others near, of the sheet and not."""
    vertices, faces = grid(22, 28, cell_m=0.008)
    parted = faces[(faces < 300).all(axis=1) | (faces >= 300).all(axis=1)]
    cloth = ClothMesh.from_rest(vertices, parted)
    near = sheet_neighbours(cloth)
    assert len(near.clusters) > 2 * LANES and len(vertices) % LANES, "several groups, and a cluster that is not full"
    for _ in range(3):
        cloud = (side_m * rng.uniform(size=vertices.shape)).astype(dtype)
        found = np.empty(len(vertices), dtype)
        rooms(cloud, near, found)
        assert_allclose(found, reference.room(cloud.astype(np.float64), cloth), rtol=0.0, atol=1e-7)


def test_rooms_do_not_know_where_their_arrays_lie(rng):
    vertices, faces = grid(12, 9, cell_m=0.006)
    near, cloud = sheet_neighbours(ClothMesh.from_rest(vertices, faces)), rng.uniform(0.0, 0.05, vertices.shape)
    found = []
    for offset in range(8):
        points = np.empty(cloud.size + offset, np.float32)[offset:].reshape(cloud.shape)
        points[:] = cloud
        found.append(np.empty(len(vertices) + offset, np.float32)[offset:])
        rooms(points, near, found[-1])
    assert (found[0] < ROOM_M).any()
    for other in found[1:]:
        assert_array_equal(other, found[0])


def test_clusters_have_every_vertex_and_bounds_are_no_less_than_the_lists(rng):
    vertices, faces = grid(22, 28, cell_m=0.008)
    near = sheet_neighbours(ClothMesh.from_rest(vertices, faces))
    assert_array_equal(np.unique(near.clusters), np.arange(len(vertices)))
    assert near.clusters.size - len(vertices) < LANES
    wide = np.ptp(vertices[near.clusters], axis=1).max(axis=1)
    assert np.median(wide) < 0.05, "32 mm in a square"
    square = np.full((len(vertices), len(vertices)), np.inf)
    square[np.repeat(np.arange(len(vertices)), np.diff(near.start)), near.vertex] = near.square
    cluster = np.empty(len(vertices), int)
    cluster[near.clusters] = np.arange(len(near.clusters))[:, None]
    listed = np.zeros((len(near.clusters), len(near.clusters)), bool)
    for a in range(len(near.clusters)):
        for entry in range(near.other_start[a], near.other_start[a + 1]):
            b, bound = near.other[entry], near.bound[entry] * BOUND_M2
            listed[a, b] = True
            exact = np.minimum(square[near.clusters[a][:, None], near.clusters[b]], ROOM_M**2)
            assert (bound >= exact).all() and (bound[exact == 0.0] == 0.0).all()
            assert (bound <= exact + 2.01 * BOUND_M2).all()
    v, u = np.nonzero(np.isfinite(square))
    assert (listed[cluster[v], cluster[u]] | (cluster[v] > cluster[u])).all()


def test_what_is_near_along_the_cloth_is_itself_its_neighbours_and_two_centimetres():
    vertices, faces = grid(9, 3, cell_m=0.008)
    near = sheet_neighbours(ClothMesh.from_rest(vertices, faces))
    entries = [slice(near.start[v], near.start[v + 1]) for v in range(len(vertices))]
    lists = [set(near.vertex[one][near.square[one] == 0.0]) for one in entries]
    first = int(np.argmin(vertices.sum(axis=1)))
    along = {v for v in range(len(vertices)) if np.allclose(vertices[v, 1:], vertices[first, 1:])}
    reached = {v for v in along if np.linalg.norm(vertices[v] - vertices[first]) < 0.02}
    assert lists[first] & along == reached and len(reached) == 3
    coarse, faces = grid(4, 3, cell_m=0.05)
    near = sheet_neighbours(ClothMesh.from_rest(coarse, faces))
    for v in range(len(coarse)):
        wanted = {v, *faces[(faces == v).any(axis=1)].reshape(-1)}
        assert set(near.vertex[near.start[v] : near.start[v + 1]]) == wanted, "the neighbours, however far"


def test_a_sheet_that_is_pressed_together_has_room_and_one_that_is_folded_has_none():
    vertices, faces = grid(21, 5, cell_m=0.006)
    vertices = vertices - vertices.mean(axis=0)
    near = sheet_neighbours(ClothMesh.from_rest(vertices, faces))
    long = int(np.argmax(np.ptp(vertices, axis=0)))
    across = int(np.argmin(np.ptp(vertices, axis=0)))
    pressed, folded = vertices.copy(), vertices.copy()
    pressed[:, long] *= 0.8
    folded[:, across] += np.where(folded[:, long] > 0.0, 0.004, 0.0)
    folded[:, long] = np.abs(folded[:, long])
    for shape, lowest, highest in ((pressed, ROOM_M, ROOM_M), (folded, 0.0, 0.0045)):
        found = np.empty(len(vertices))
        rooms(shape, near, found)
        away = np.abs(vertices[:, long]) > 0.024  # from the fold
        assert lowest <= found[away].min() and found[away].max() <= highest


def test_no_room_is_found_between_numbers_that_are_none():
    vertices, faces = grid(4, 3)
    found = np.zeros(len(vertices))
    rooms(np.full_like(vertices, np.nan), sheet_neighbours(ClothMesh.from_rest(vertices, faces)), found)
    assert_array_equal(found, ROOM_M)


def test_the_compiled_hold_equals_the_readable_one():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed, dtype=np.float64)
    memory, wanted_memory = None, None
    for number in range(3):
        one = flattened(frame(rest, number), 0.08)
        x, memory, _ = fold(constants, memory, one, HELD)
        wanted, wanted_memory = reference.fold(dressed, wanted_memory, one, HELD)
        assert_allclose(x, wanted, rtol=0.0, atol=1e-10)
    room = reference.room(one.vertices, dressed.cloth)
    assert (room < 0.5 * ROOM_M).any() and (room == ROOM_M).any(), "some are held, some are free"


def test_where_there_is_room_nothing_changes():
    rest, dressed = sleeve()
    constants = FoldConstants.of(dressed)
    assert (reference.room(frame(rest, 0).vertices, dressed.cloth) == ROOM_M).all()
    free, held = (fold(constants, None, frame(rest, 0), effort)[0] for effort in (OPEN, HELD))
    assert_array_equal(free, held)


def test_cloth_without_room_stays_with_the_network():
    """A sleeve pressed flat and short has too much cloth, and no body near: it buckles unless it is held."""
    rest, dressed = sleeve("poplin", creased=False)
    constants = FoldConstants.of(dressed)
    one = without_body(flattened(frame(rest, 0, noise_m=0.001), 0.05))
    one = replace(one, vertices=one.vertices * [1.0, 0.8, 1.0])
    held = reference.room(one.vertices, dressed.cloth) < 0.010
    way_m = {}
    for effort in (OPEN, HELD):
        memory = None
        for number in range(10):
            x, memory, _ = fold(constants, memory, replace(one, time_s=number / 30.0), effort)
        way_m[effort] = np.linalg.norm(x - one.vertices, axis=1)[held]
    assert held.sum() > 10
    assert way_m[HELD].mean() < 0.006 < 1.8 * way_m[HELD].mean() < way_m[OPEN].mean()


@pytest.mark.parametrize("material", ["rib", "poplin"])
@pytest.mark.parametrize("steps", [1, 3])
def test_cloth_without_room_comes_to_rest(material, steps):
    """Held more stiffly than steps of the whole know it would go to and fro: frames tell where their number is odd."""
    rest, dressed = sleeve(material, creased=False)
    leash = LEASH_N_M3 * dressed.cloth.vertex_area
    constants = FoldConstants.of(replace(dressed, band_n_per_m=dressed.band_n_per_m + leash))
    one, found, memory = without_body(flattened(frame(rest, 0, noise_m=0.001), 0.05)), [], None
    for number in range(40):
        x, memory, _ = fold(constants, memory, replace(one, time_s=number / 30.0), replace(HELD, steps=steps))
        found.append(x)
    assert np.linalg.norm(np.diff(found[-4:], axis=0), axis=-1).max() < 1e-3


def test_the_force_of_what_holds_is_the_slope_of_its_energy(rng):
    rest, dressed = sleeve(creased=False)
    made = problem(dressed.cloth, dressed.material, dtype=np.float64)
    one = flattened(frame(rest, 0), 0.08)
    nowhere = TouchedSamples(dressed.index, np.full_like(dressed.index, -1))
    around = reference.touching(made, dressed, one.vertices, one.skin, nowhere).own
    held, slack = reference.held_within(reference.room(one.vertices, dressed.cloth), dressed.band_n_per_m, made)
    assert slack.min() < 1.01 * LEAST_M and held.max() > 2.0 * made.contact_n_per_m.max()
    around = around._replace(band=one.vertices, band_n_per_m=held)
    loose = made._replace(constants=made.constants._replace(slack=slack))
    x, way, step = one.vertices + 0.003 * rng.normal(size=rest.shape), rng.normal(size=rest.shape), 1e-7
    ahead, behind = (energy_and_gradient(x + sign * step * way, loose, around)[0] for sign in (1.0, -1.0))
    slope = (energy_and_gradient(x, loose, around)[1] * way).sum()
    assert_allclose((ahead - behind) / (2.0 * step), slope, rtol=1e-5)
