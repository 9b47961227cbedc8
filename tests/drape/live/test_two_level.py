"""Folds on two levels: what is carried, what sweeps add and keep, the lift, and what begins anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from drape.body.assets import load_body
from drape.cloth.coarse_mesh import coarse_mesh
from drape.cloth.energies import ClothMesh
from drape.cloth.fabric_table import fabric
from drape.engine.library import LANES
from drape.live.clock import PAUSE_S, Frame
from drape.live.coarse_weights import NEAREST
from drape.live.fold_constants import worn_cloth
from drape.live.fold_step import FoldEffort, compute_frame
from drape.live.two_level import (
    FOLD_EDGES,
    LiftMemory,
    TwoLevel,
    TwoLevelMemory,
    hang_shares,
    one_level,
    stiffen,
    two_level_call,
)
from tests.drape.live.folds_setup import FAR_M
from tests.drape.live.tank_setup import strain
from tests.fixtures.garments import shipped
from tests.reference import carry
from tests.reference.folds import surface_frames
from tests.reference.pace import FADE_S

EFFORT = FoldEffort(steps=1, settle=2, cloth_contact=True)


def after(made: TwoLevel, first: Frame, count: int, effort: FoldEffort = EFFORT):
    memory, found = None, []
    for number in range(count):
        vertices, memory, report = made.fold(memory, replace(first, time_s=number / 30.0), effort)
        found.append((vertices, memory, report))
    return found


def test_without_steps_the_drape_is_the_networks(tank: TwoLevel, still: Frame):
    """Nothing is carried and nothing added: what is lower than the clearance is lifted, the rest stays."""
    call = two_level_call(tank.levels, None, still.time_s)
    vertices, memory, report = compute_frame(call, still, FoldEffort(0, clearance_m=0.0))
    assert_allclose(vertices, still.vertices, atol=1e-6)
    assert report.settled and np.array_equal(memory.fine[tank.levels.fine.sheet.place], vertices)
    lifted, _, told = compute_frame(call, still, FoldEffort(0, clearance_m=0.004))
    way = np.linalg.norm(lifted - still.vertices, axis=1)
    assert_allclose(told.lifted_max_m, way.max(), rtol=1e-3)
    assert 0.0 < told.lifted_share < 1.0


def test_steps_go_on_from_a_lift_and_fade_before_it_comes_back(tank: TwoLevel, still: Frame):
    """No frame is settled anew when a stream steps up, and none loses its folds at once when it steps down."""
    idle, later = FoldEffort(0, clearance_m=0.004), [replace(still, time_s=n / 30.0) for n in range(3)]
    lifted, memory, _ = tank.fold(None, still, idle)
    folded, after_step, report = tank.fold(memory, later[1], EFFORT)
    assert not report.settled and isinstance(after_step, TwoLevelMemory)
    assert 1e-4 < np.abs(folded - lifted).max() < 0.02
    faded, last, _ = tank.fold(after_step, later[2], idle)
    assert isinstance(last, TwoLevelMemory) and np.abs(faded - lifted).max() > 1e-4
    assert isinstance(memory, LiftMemory) and memory.at(7.0).time_s == 7.0


def test_steps_lower_the_strain_and_more_lower_it_further(tank: TwoLevel, still: Frame):
    one, many = after(tank, still, 2), after(tank, still, 12)
    strains = [strain(each) for each in (still.vertices, one[-1][0], many[-1][0])]
    assert strains[0] > 1.5 * strains[1] and strains[1] > strains[2]


def test_cloth_at_rest_forgets_nothing_of_what_sweeps_have_settled(tank: TwoLevel, still: Frame):
    """With what a moving cloth forgets, the strain would come down by 2 % in the last second and stay there."""
    found = after(tank, still, 121)
    assert strain(found[120][0]) < 0.95 * strain(found[60][0])


def test_the_same_frames_give_the_same_bits_and_memories_are_not_written(tank: TwoLevel, still: Frame):
    first = after(tank, still, 3)
    fine = first[1][1].fine.copy()
    again = after(tank, still, 3)
    assert_array_equal(first[-1][0], again[-1][0])
    assert_array_equal(first[1][1].fine, fine)


@pytest.mark.parametrize("name", ["satin", "denim"])
def test_edges_of_a_coarse_cloth_resolve_folds_of_its_weight_where_it_hangs(name: str):
    """Hinges of a skirt's hem bend over ``FOLD_EDGES`` edges; those of its top stay, and so does stiffer cloth."""
    garment, body = shipped("circle_skirt"), load_body()
    worn = worn_cloth(garment, body, fabric(name))
    cloth, material = worn.cloth, worn.material
    hangs = hang_shares(garment.vertices[: cloth.vertex_count].astype(float), body, worn.index)
    free = hangs[cloth.hinge_index.reshape(4, -1)].mean(axis=0)
    made, real = stiffen(worn, hangs), cloth.hinge_weight > 0.0
    rigidity = material.bending_j * made.cloth.hinge_weight[real] / cloth.hinge_weight[real]
    off, on = free[real] > 0.999, free[real] == 0.0
    assert off.mean() > 0.05 and on.mean() > 0.05 and made.material == material
    assert_allclose(rigidity[on], material.bending_j)
    length = (rigidity / (material.density_kg_m2 * material.gravity_m_s2)) ** (1.0 / 3.0)
    assert_allclose(length[off], FOLD_EDGES * cloth.mean_edge_m, rtol=1e-3)
    stiff = replace(worn, material=replace(material, bending_j=1.0))
    assert_array_equal(stiffen(stiff, hangs).cloth.hinge_weight, cloth.hinge_weight)


def test_nothing_round_trunk_and_arms_hangs(tank: TwoLevel):
    garment, body = shipped("sweat"), load_body()
    vertices = garment.vertices[: garment.vertex_count].astype(float)
    hangs = hang_shares(vertices, body, worn_cloth(garment, body).index)
    assert hangs[vertices[:, 1] > np.quantile(vertices[:, 1], 0.3)].max() < 0.05


def rows(flat: np.ndarray) -> np.ndarray:
    """The ``NEAREST`` numbers of each place (P, 8)."""
    return flat.reshape(-1, NEAREST, LANES).transpose(0, 2, 1).reshape(-1, NEAREST)


def tank_below() -> tuple[np.ndarray, ClothMesh]:
    """The vertices (C,) that the coarse cloth of the tank has, and its mesh."""
    garment = shipped("tank")
    rest = garment.vertices[: garment.vertex_count].astype(np.float64)
    mesh = coarse_mesh(garment.delivered_rest(), rest, garment.faces.astype(np.int64))
    return mesh.vertex, ClothMesh.of(mesh.rest, mesh.faces, len(mesh.vertex))


def coarse_places(made: TwoLevel, memory: TwoLevelMemory) -> np.ndarray:
    """Where the coarse cloth of ``memory`` lies [m] (C, 3)."""
    place = made.levels.coarse.sheet.place
    network, residual = (of[place].astype(np.float64) for of in (memory.coarse.network, memory.coarse.residual))
    return network + np.einsum("vji,vj->vi", surface_frames(network, tank_below()[1]), residual)


def carried(
    made: TwoLevel, memory: TwoLevelMemory, network: np.ndarray, coarse: np.ndarray, share: float
) -> np.ndarray:
    """Where sweeps of the fine cloth begin [m] (V, 3), in float64: a ``share`` of it is carried on from ``memory`` by
    the ``coarse`` cloth (C, 3), the rest lies about the ``network``."""
    sheet, fine, (kept, cloth) = made.levels.coarse.sheet, made.levels.fine, tank_below()
    came = coarse_places(made, memory)
    then, now = (surface_frames(each, cloth) for each in (came, coarse))
    turns = carry.surface_turns(then, now, cloth.faces, carry.FINE_PASSES)
    near, weight = sheet.vertex[rows(fine.near)][fine.sheet.place], rows(fine.weight)[fine.sheet.place]
    own, begun, moved = memory.fine[fine.sheet.place].astype(np.float64), network.copy(), np.zeros_like(network)
    for node, by in zip(near.T, weight.T, strict=True):
        moved += by[:, None] * (coarse[node] + carry.turned(turns[node], own - came[node]))
        begun += by[:, None] * (coarse - network[kept])[node]
    return begun + share * (moved - begun)


def test_fine_folds_are_carried_on_by_the_coarse_cloth_and_fade(tank: TwoLevel, still: Frame):
    """Without steps the fine cloth lies where its sweeps would begin."""
    *_, (_, memory, _) = after(tank, still, 4)
    about = Rotation.from_rotvec([0.1, 0.3, -0.1]).as_matrix()
    bent = still.vertices * [1.0, 1.0, 1.05] @ about.T
    later = replace(still, vertices=bent.astype(np.float32), time_s=memory.coarse.time_s + 1.0 / 30.0)
    kept, faded, report = tank.fold(memory, later, EFFORT._replace(steps=0, clearance_m=0.0))
    assert not report.settled and isinstance(faded, TwoLevelMemory)
    lies = coarse_places(tank, faded)
    wanted = carried(tank, memory, bent, lies, np.exp(-1.0 / 30.0 / FADE_S))
    assert_allclose(kept, wanted, rtol=0.0, atol=2e-5)
    assert np.abs(wanted - bent).max() > 1e-3


@pytest.mark.parametrize(("way_m", "kept"), [(-0.03, False), (-0.01, True), (0.03, True)])
def test_cloth_that_came_through_the_skin_is_laid_back(tank: TwoLevel, still: Frame, way_m: float, kept: bool):
    """Cloth that lies behind its sample, where the network has it before the skin, begins at the network's place."""
    _, memory, _ = tank.fold(None, still, EFFORT)
    assert isinstance(memory, TwoLevelMemory)
    place, coarse = tank.levels.coarse.sheet.place, memory.coarse
    network, own = coarse.network[place].astype(np.float64), coarse.touched.own[place]
    normal = still.skin.reshape(-1, 8)[own, 4:7].astype(np.float64)
    residual = coarse.residual.copy()
    residual[place] = np.einsum("vij,vj->vi", surface_frames(network, tank_below()[1]), way_m * normal)
    moved = replace(memory, coarse=replace(coarse, residual=residual))
    later = replace(still, time_s=1.0 / 30.0)
    _, after_it, _ = tank.fold(moved, later, EFFORT._replace(steps=0, clearance_m=0.0))
    assert isinstance(after_it, TwoLevelMemory)
    left = np.linalg.norm(after_it.coarse.residual[place], axis=1)
    near = np.linalg.norm(network - still.skin.reshape(-1, 8)[own, :3], axis=1) < 0.03
    assert near.sum() > 100
    assert np.median(left[near]) > 0.8 * abs(way_m) if kept else np.median(left[near]) < 1e-6


def test_a_frame_after_a_pause_begins_anew(tank: TwoLevel, still: Frame):
    *_, (_, memory, _) = after(tank, still, 3)
    late = replace(still, time_s=memory.coarse.time_s + 2.0 * PAUSE_S)
    anew, _, report = tank.fold(memory, late, EFFORT)
    assert report.settled
    assert_array_equal(anew, after(tank, late, 1)[0][0])


def test_what_is_no_fold_is_the_networks_drape(tank: TwoLevel, still: Frame):
    *_, (_, memory, _) = after(tank, still, 2)
    later, place = replace(still, time_s=2.0 / 30.0), tank.levels.fine.sheet.place
    far = replace(memory, fine=memory.fine + np.float32(2.0 * FAR_M))
    vertices, begun, report = tank.fold(far, later, EFFORT._replace(steps=0))
    assert isinstance(begun, TwoLevelMemory)
    assert report.reset and not report.settled and np.array_equal(begun.fine[place], still.vertices)
    assert_array_equal(vertices, still.vertices)
    torn = replace(memory, coarse=replace(memory.coarse, residual=np.full_like(memory.coarse.residual, np.nan)))
    vertices, _, report = tank.fold(torn, later, EFFORT)
    assert report.reset and report.settled
    assert_array_equal(vertices, after(tank, still, 1)[0][0])


def test_memories_of_the_other_kind_are_none(tank: TwoLevel, still: Frame):
    fine = one_level(shipped("tank"), load_body(), fabric("jersey"))
    _, coarse_memory, _ = tank.fold(None, still, EFFORT)
    _, fine_memory, _ = fine.fold(None, still, EFFORT)
    later = replace(still, time_s=1.0 / 30.0)
    for made, other in ((tank, fine_memory), (fine, coarse_memory)):
        _, _, report = made.fold(other, later, EFFORT)
        assert report.settled
    for made, own in ((tank, coarse_memory), (fine, fine_memory)):
        _, _, report = made.fold(own, later, EFFORT)
        assert not report.settled
        assert made.own(own).shape == made.laid.index.shape  # type: ignore[arg-type]
        assert made.nbytes > 1e5
    assert isinstance(coarse_memory, TwoLevelMemory) and coarse_memory.at(7.0).coarse.time_s == 7.0
