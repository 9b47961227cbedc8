"""Room between sheets: found as the readable way finds it, and cloth that comes near to itself keeps apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from drape.cloth.energies import ClothMesh
from drape.engine.calls import call_with_scratch
from drape.engine.library import LANES
from drape.engine.packer import Record
from drape.geometry.triangle_pairs import crossing_pairs
from drape.live.clock import Frame
from drape.live.fold_constants import LEASH_N_M3, FoldConstants
from drape.live.fold_step import fold
from drape.live.room import BOUND_M2, ROOM_M, SheetNeighbours, sheet_neighbours
from drape.live.untangle import Tangles
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.live.folds_setup import EFFORT, HELD, constants, folded, frame, held_for, sleeve, without_body
from tests.fixtures.laws import each
from tests.reference import folds as reference


def flattened(one: Frame, share: float) -> Frame:
    """``one`` with the network's sleeve pressed flat, to ``share`` of its depth."""
    pressed = one.vertices.copy()
    pressed[:, 2] = share * (pressed[:, 2] - pressed[:, 2].mean())
    return replace(one, vertices=pressed)


def rooms(points: np.ndarray, neighbours: SheetNeighbours, room: np.ndarray, nearest: np.ndarray) -> None:
    """Writes the distance [m] from each of ``points`` (V, 3) to the nearest that is not of its sheet, and that one."""
    near = Record("SheetNeighbours", neighbours)
    call_with_scratch("law_rooms", points.dtype, points, near, ROOM_M, room, nearest)


def room_of(cloth: ClothMesh, points: np.ndarray) -> np.ndarray:
    found, nearest = np.empty(len(points), points.dtype), np.empty(len(points), np.int32)
    rooms(points, sheet_neighbours(cloth), found, nearest)
    some = nearest >= 0
    assert_allclose(np.linalg.norm(points - points[nearest], axis=1)[some], found[some], rtol=1e-4, atol=1e-7)
    assert (found[~some] == points.dtype.type(ROOM_M)).all()
    return found


@each(shape=(tube(24, 30, radius_m=0.031, height_m=0.14), grid(12, 9, cell_m=0.006)), dtype=(np.float32, np.float64))
def test_rooms_are_those_of_all_pairs(rng, shape, dtype):
    vertices, cloth = shape[0], ClothMesh.from_rest(*shape)
    crumpled = vertices * [1.0, 0.6, 0.3] + 0.002 * rng.normal(size=vertices.shape)
    found = room_of(cloth, crumpled.astype(dtype))
    assert_allclose(found, reference.room(crumpled, cloth)[0], rtol=0.0, atol=1e-7)
    assert 0.0 < found.min() < 0.5 * ROOM_M, "somewhere cloth is near to itself"


@each(dtype=(np.float32, np.float64), side_m=(0.06, 0.4))
def test_rooms_in_a_cloud_are_those_of_all_pairs(rng, dtype, side_m):
    """Vertices anywhere in a box, of a cloth in two pieces: most have many others near, of the sheet and not."""
    vertices, faces = grid(22, 28, cell_m=0.008)
    cloth = ClothMesh.from_rest(vertices, faces[(faces < 300).all(axis=1) | (faces >= 300).all(axis=1)])
    assert len(vertices) > 2 * LANES**2 and len(vertices) % LANES, "several groups, and a cluster that is not full"
    for _ in range(2):
        cloud = (side_m * rng.uniform(size=vertices.shape)).astype(dtype)
        wanted, _ = reference.room(cloud.astype(np.float64), cloth)
        assert_allclose(room_of(cloth, cloud), wanted, rtol=0.0, atol=1e-7)


def test_rooms_do_not_know_where_their_arrays_lie(rng):
    vertices, faces = grid(12, 9, cell_m=0.006)
    near, cloud = sheet_neighbours(ClothMesh.from_rest(vertices, faces)), rng.uniform(0.0, 0.05, vertices.shape)
    found = []
    for offset in range(8):
        points = np.empty(cloud.size + offset, np.float32)[offset:].reshape(cloud.shape)
        points[:] = cloud
        found.append(np.empty(len(vertices) + offset, np.float32)[offset:])
        rooms(points, near, found[-1], np.empty(len(vertices), np.int32))
    assert (found[0] < ROOM_M).any()
    assert_array_equal(found[1:], np.tile(found[0], (7, 1)))


def test_clusters_have_every_vertex_and_bounds_are_no_less_than_the_lists():
    vertices, faces = grid(22, 28, cell_m=0.008)
    near = sheet_neighbours(ClothMesh.from_rest(vertices, faces))
    count = len(near.clusters)
    assert_array_equal(np.unique(near.clusters), np.arange(len(vertices)))
    assert near.clusters.size - len(vertices) < LANES
    assert np.median(np.ptp(vertices[near.clusters], axis=1).max(axis=1)) < 0.05, "32 mm in a square"
    square = np.full((len(vertices), len(vertices)), np.inf)
    square[np.repeat(np.arange(len(vertices)), np.diff(near.start)), near.vertex] = near.square
    first, listed = np.repeat(np.arange(count), np.diff(near.other_start)), np.zeros((count, count), bool)
    listed[first, near.other] = True
    exact = np.minimum(square[near.clusters[first][:, :, None], near.clusters[near.other][:, None]], ROOM_M**2)
    bound = near.bound * BOUND_M2
    assert (bound >= exact).all() and (bound[exact == 0.0] == 0.0).all() and (bound <= exact + 2.01 * BOUND_M2).all()
    cluster = np.empty(len(vertices), int)
    cluster[near.clusters] = np.arange(count)[:, None]
    v, u = np.nonzero(np.isfinite(square))
    assert (listed[cluster[v], cluster[u]] | (cluster[v] > cluster[u])).all()


def test_what_is_near_along_the_cloth_is_itself_its_neighbours_and_two_centimetres():
    vertices, faces = grid(9, 3, cell_m=0.008)
    near = sheet_neighbours(ClothMesh.from_rest(vertices, faces))
    first = int(np.argmin(vertices.sum(axis=1)))
    own = slice(near.start[first], near.start[first + 1])
    along = {v for v in range(len(vertices)) if np.allclose(vertices[v, 1:], vertices[first, 1:])}
    reached = {v for v in along if np.linalg.norm(vertices[v] - vertices[first]) < 0.02}
    assert set(near.vertex[own][near.square[own] == 0.0]) & along == reached and len(reached) == 3
    coarse, faces = grid(4, 3, cell_m=0.05)
    near = sheet_neighbours(ClothMesh.from_rest(coarse, faces))
    for v in range(len(coarse)):
        wanted = {v, *faces[(faces == v).any(axis=1)].reshape(-1)}
        assert set(near.vertex[near.start[v] : near.start[v + 1]]) == wanted, "the neighbours, however far"


def test_a_sheet_that_is_pressed_together_has_room_and_one_that_is_folded_has_none():
    vertices, faces = grid(21, 5, cell_m=0.006)  # in the xy plane, longest along x
    vertices = vertices - vertices.mean(axis=0)
    away = np.abs(vertices[:, 0]) > 0.024  # from the fold
    bent = np.stack([np.abs(vertices[:, 0]), vertices[:, 1], np.where(vertices[:, 0] > 0.0, 0.004, 0.0)], axis=1)
    cloth = ClothMesh.from_rest(vertices, faces)
    assert_array_equal(room_of(cloth, vertices * [0.8, 1.0, 1.0])[away], ROOM_M)
    assert room_of(cloth, bent)[away].max() <= 0.0045


def test_no_room_is_found_between_numbers_that_are_none():
    vertices, faces = grid(4, 3)
    assert_array_equal(room_of(ClothMesh.from_rest(vertices, faces), np.full_like(vertices, np.nan)), ROOM_M)


def test_the_engines_planes_equal_the_readable_ones():
    (rest, worn), wanted_memory = sleeve(), None
    frames = [without_body(flattened(frame(rest, number), 0.08)) for number in range(3)]
    nothing = np.zeros(0, np.int32)  # that crosses is moved apart: the readable way has planes only
    made = replace(constants(dtype=np.float64), tangles=Tangles(nothing, nothing, np.zeros(1, np.int32), nothing))
    for one, (x, _, _) in zip(frames, folded(made, frames, HELD), strict=True):
        wanted, wanted_memory = reference.fold(worn, wanted_memory, one, HELD)
        assert_allclose(x, wanted, rtol=0.0, atol=1e-10)
    room, _ = reference.room(frames[-1].vertices, worn.cloth)
    assert (room < 0.5 * ROOM_M).any() and (room == ROOM_M).any(), "some are kept apart, some are free"


def test_where_there_is_room_nothing_changes():
    one = frame(sleeve()[0], 0)
    assert (reference.room(one.vertices, sleeve()[1].cloth)[0] == ROOM_M).all()
    free, held = (fold(constants(), None, one, effort)[0] for effort in (EFFORT, HELD))
    assert_array_equal(free, held)


def test_cloth_that_is_pressed_together_keeps_apart_and_whole():
    """A sleeve pressed flat and short has too much cloth, and no body near: it buckles through itself unless it keeps
    apart. It is not held to the network for that, and is stretched no more."""
    rest, worn = sleeve("poplin", creased=False)
    one = without_body(flattened(frame(rest, 0, noise_m=0.001), 0.05))
    one = replace(one, vertices=one.vertices * [1.0, 0.8, 1.0])
    ends = [folded(constants("poplin", creased=False), held_for(one, 10), e)[-1][0] for e in (EFFORT, HELD)]
    free, kept = (reference.room(x, worn.cloth)[0] for x in ends)
    crosses = [len(crossing_pairs(x.astype(np.float64), worn.cloth.faces)) for x in ends]
    assert kept.min() > 2.0 * free.min()
    assert crosses[1] == 0 < crosses[0]


@each(material=("rib", "poplin"), steps=(1, 3))
def test_cloth_without_room_comes_to_rest(material, steps):
    """Kept apart more stiffly than steps of the whole know it would go to and fro: frames tell where their number is
    odd."""
    rest, worn = sleeve(material, creased=False)
    leash = LEASH_N_M3 * worn.cloth.vertex_area
    made = FoldConstants.of(replace(worn, band_n_per_m=worn.band_n_per_m + leash))
    one = without_body(flattened(frame(rest, 0, noise_m=0.001), 0.05))
    found = [x for x, _, _ in folded(made, held_for(one, 80), HELD._replace(steps=steps))]
    assert np.linalg.norm(np.diff(found[-4:], axis=0), axis=-1).max() < 1e-3
