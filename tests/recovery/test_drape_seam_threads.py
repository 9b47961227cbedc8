"""Placing panels round a body, sewing them, and letting the garment come to rest."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.cloth.material import FABRICS, MEASURED
from drape.cloth.relaxation import Distance
from drape.errors import InputError
from drape.garment.contours import lost_parts
from recovery.drape.pattern_drape import hanging
from recovery.drape.placement import (
    CLEARANCE_M,
    Axes,
    best_lift,
    check_placed,
    move_clear,
    openings_of_limbs,
    place_panels,
    scale_pattern,
    sleeve_panels,
)
from recovery.drape.seam_threads import SEWING_GAP_M, Sewn, in_numpy, sew, uncross_stitches
from recovery.drape.settle import STEP_LIMIT, TOLERANCE_N, settle_at_rest, to_rest, topmost_opening
from recovery.pattern import geometry
from recovery.pattern.bases import BASES
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.style import Style, add_style_lines
from recovery.sim.cloth_model import ClothModel, ClothState, Parameters
from recovery.sim.newton_steps import equilibrium
from recovery.sim.skin_contact import GridDistance, PlaneDistance, SignedDistance, SkinContact, Sphere
from tests.recovery.pattern_setup import default_measurements, lowered, rectangle, tube
from tests.recovery.sim_setup import WOVEN

FAR = PlaneDistance((0.0, -10.0, 0.0))
BALL = in_numpy(Sphere((0.0, 0.0, 0.0), 0.1))


@lru_cache(maxsize=1)
def tube_mesh() -> PatternMesh:
    """A tube of 0.8 m girth and 0.6 m height."""
    return mesh_pattern(tube(), 0.08)


@lru_cache(maxsize=1)
def sewn_tube() -> Sewn:
    """The tube round a ball."""
    return sew(tube_mesh(), tube_mesh().placed(), BALL)


@lru_cache(maxsize=1)
def body_distance() -> Distance:
    """The shipped body on a coarse grid."""
    body = load_body()
    return in_numpy(GridDistance.from_mesh(body.v_template, body.faces, spacing_m=0.04))


def test_scaling_a_pattern_scales_its_lengths_and_the_places_of_its_panels():
    before, after = tube(), scale_pattern(tube(), 1.25)
    for old, new in zip(before.panels, after.panels, strict=True):
        assert_allclose(geometry.edge_length(new, 1), 1.25 * geometry.edge_length(old, 1))
        assert_allclose(new.placement.apply(new.vertices), 1.25 * old.placement.apply(old.vertices), atol=1e-12)


def test_threads_are_lifted_out_of_the_body_and_no_further():
    """Threads at 0.30 m over a body that ends at 0.335 m: lifted by 4 cm, the first of the levels that is free."""
    positions = np.array([[x, 0.30, z] for x in (-0.1, 0.1) for z in (-0.2, 0.2)])
    pairs = np.array([[0, 1], [2, 3]])
    assert_allclose(best_lift(positions, pairs, in_numpy(PlaneDistance((0.0, 0.335, 0.0)))), 0.04)
    assert best_lift(positions, pairs, in_numpy(PlaneDistance((0.0, 0.2, 0.0)))) == 0.0
    assert best_lift(positions, np.zeros((0, 2), dtype=np.int64), BALL) == 0.0


def test_a_panel_in_the_body_moves_along_its_normal_until_it_is_clear():
    mesh = tube_mesh()
    flat = mesh.placed()
    inside = flat - np.where(mesh.panel == 0, 0.15, 0.0)[:, None] * [0.0, 0.0, 1.0]
    moved, way = move_clear(mesh, inside, BALL)
    assert BALL(moved)[0].min() >= CLEARANCE_M
    assert_allclose(moved[mesh.panel == 1], flat[mesh.panel == 1])
    assert_allclose(moved[mesh.panel == 0] - inside[mesh.panel == 0], [[0.0, 0.0, way]] * (mesh.panel == 0).sum())
    # No more than a step beyond what is needed: the nearest vertex of the panel to the ball's axis decides.
    radius = np.linalg.norm(inside[mesh.panel == 0][:, :2], axis=1).min()
    needed = np.sqrt((0.1 + CLEARANCE_M) ** 2 - radius**2) - 0.05
    assert needed <= way <= needed + 0.006


@pytest.mark.parametrize("name", sorted(BASES))
def test_base_patterns_stand_where_they_were_drafted(body, name):
    placed = place_panels(mesh_pattern(BASES[name](default_measurements()), 0.08), body, body_distance())
    assert placed.axes is Axes.BODY
    holds = {"skirt": "waist", "trousers": "waist", "tube": "chest", "strapless_dress": "chest"}
    assert placed.hangs_from == holds.get(name, "shoulders")
    assert abs(placed.lift_m) <= 0.02 and placed.outward_m <= 0.02


def openings(pattern: Pattern, height: float = 0.0) -> dict[str, np.ndarray]:
    """The mesh's openings of limbs with the panels ``height`` [m] above the place of the file."""
    mesh = mesh_pattern(pattern, 0.08)
    return openings_of_limbs(mesh, mesh.placed() + np.array([0.0, height, 0.0]), top=True, crotch_m=-0.1)


@pytest.mark.parametrize(
    ("degrees", "moved_m"), [(30.0, (0.0, 0.0)), (60.0, (0.1, -0.22)), (90.0, (0.2, 0.1)), (-50.0, (0.0, 0.05))]
)
def test_sleeves_for_lowered_arms_are_stood_round_the_arms_of_the_t_pose(body, degrees, moved_m):
    """They lie as the base's do, but in their plane the arm is in the middle of the cuff; nothing else moves."""
    base = BASES["tshirt"](default_measurements())
    mesh, own = mesh_pattern(lowered(base, degrees, moved_m), 0.08), mesh_pattern(base, 0.08)
    placed, plain = place_panels(mesh, body, body_distance()), place_panels(own, body, body_distance())
    assert plain.turned_rad == 0.0 and sorted(placed.limbs) == sorted(plain.limbs) == ["left_arm", "right_arm"]
    assert_allclose(np.degrees(placed.turned_rad), abs(degrees), atol=0.01)  # its arms are level within that
    for number, panel in enumerate(base.panels):
        mine = mesh.panel == number
        way = placed.positions[mine] - plain.positions[mine]
        assert_allclose(way, np.broadcast_to(way[0], way.shape), atol=1e-4)
        assert panel.name.startswith("sleeve") or np.abs(way[0, :2]).max() < 0.011  # one level
    cuff = np.concatenate(list(openings(base).values()))
    arm = body.joints_template[JOINT_NAMES.index("left_elbow"), 1]
    assert_allclose(mesh.nodes_from(placed.positions)[cuff, 1].mean(), arm, atol=1e-9)


def test_threads_close_such_sleeves_round_the_arms(body):
    """The pattern lies a hand's breadth beside the arms; unturned, its sleeves close below them."""
    mesh = mesh_pattern(lowered(BASES["tshirt"](default_measurements()), 60.0, (0.1, -0.22)), 0.06)
    placed = place_panels(mesh, body, body_distance())
    nodes = sew(mesh, placed.positions, body_distance()).nodes
    assert lost_parts(nodes, mesh.faces, body.joints_template, placed.limbs) == ()


def test_a_sleeve_is_told_from_a_bodice_whose_openings_are_banded_and_from_one_without_sleeves():
    bands = add_style_lines(
        BASES["tshirt"](default_measurements()), Style({"cuffs": 0.03, "neckband": 0.02, "hemband": 0.03})
    )
    for pattern, wanted in ((bands, "sleeve_left"), (BASES["tank"](default_measurements()), "none")):
        mesh = mesh_pattern(pattern, 0.06)
        found = sleeve_panels(mesh, openings_of_limbs(mesh, mesh.placed(), top=True, crotch_m=-0.1)["left_arm"])
        names = [panel.name for panel in pattern.panels]
        assert {names[number] for number in found} == {name for name in names if name.startswith(wanted)}


def test_legs_are_told_from_arms():
    trousers = BASES["trousers"](default_measurements())
    assert set(openings(trousers)) == {"left_leg", "right_leg"}  # as a top that ends in legs
    assert set(openings(trousers, height=2.0)) == {"left_arm", "right_arm"}  # as a jacket, open in front
    assert openings(BASES["skirt"](default_measurements())) == {}


@pytest.mark.data
def test_files_of_the_data_folder_stand_round_the_trunk(body, pattern_files):
    size = default_measurements()
    for path in pattern_files:
        mesh = mesh_pattern(uncross_stitches(read_pattern(path))[0], 0.08)
        placed = place_panels(mesh, body, body_distance())
        top = placed.positions[:, 1].max()
        nearest = size.neck_y if placed.hangs_from == "shoulders" else size.waist_y
        assert abs(top - nearest) < 0.12, path.name
        assert body_distance()(placed.positions)[0].min() >= CLEARANCE_M, path.name


def crossed(pattern: Pattern) -> Pattern:
    """``pattern`` with the partners of its two stitches exchanged."""
    one, other = pattern.stitches
    return replace(pattern, stitches=(replace(one, second=other.second), replace(other, second=one.second)))


def test_crossed_seams_are_exchanged_and_named():
    found, notes = uncross_stitches(crossed(tube()))
    assert found.stitches == tube().stitches
    assert len(notes) == 1 and "front[1] to back[1]" in notes[0]
    turned = crossed(tube())  # the same with the second stitch written the other way round
    one, other = turned.stitches
    swapped = replace(turned, stitches=(one, replace(other, first=other.second, second=other.first)))
    assert uncross_stitches(swapped)[0].stitches == tube().stitches


@pytest.mark.parametrize("name", sorted(BASES))
def test_seams_that_are_right_are_left_alone(name):
    pattern = BASES[name](default_measurements())
    found, notes = uncross_stitches(pattern)
    assert notes == () and found.stitches == pattern.stitches


def test_a_tube_is_sewn_round_a_ball_without_stretching():
    mesh = tube_mesh()
    sewn = sewn_tube()
    assert sewn.gap_m < 1e-3
    assert sewn.nodes.shape == (mesh.node_count, 3)
    assert np.abs(sewn.stretch - 1.0).max() < 0.05
    assert BALL(sewn.nodes)[0].min() > SEWING_GAP_M - 1e-3
    # Round the ball and not beside it: the middle ring winds once about the axis.
    waist = np.abs(sewn.nodes[:, 1]) < 0.1
    angle = np.arctan2(sewn.nodes[waist, 2], sewn.nodes[waist, 0])
    assert np.diff(np.sort(angle), append=np.sort(angle)[0] + 2 * np.pi).max() < 1.2


def test_sewing_is_repeatable_to_the_last_bit():
    mesh = tube_mesh()
    assert (sew(mesh, mesh.placed(), BALL).nodes == sewn_tube().nodes).all()


def cylinder(radius: float) -> SignedDistance:
    """The distance of an upright cylinder without ends."""

    def distance(points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        length = torch.sqrt(points[:, 0] ** 2 + points[:, 2] ** 2)
        return length - radius, points * torch.tensor([1.0, 0.0, 1.0]) / length[:, None]

    return distance


def test_the_topmost_opening_is_the_upper_rim_of_a_tube():
    mesh = tube_mesh()
    nodes = mesh.nodes_from(mesh.placed())
    assert set(topmost_opening(mesh.faces, nodes)) == set(np.flatnonzero(nodes[:, 1] > 0.3 - 1e-9))
    closed = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    assert len(topmost_opening(closed, np.eye(4)[:, :3])) == 0


def upright(mesh: PatternMesh) -> np.ndarray:
    """Nodes of the tube as a round, unstretched cylinder."""
    radius = 0.8 / (2.0 * np.pi)
    angle = mesh.rest[:, 0] / radius + np.pi * mesh.panel
    return mesh.nodes_from(radius * np.stack([np.sin(angle), mesh.rest[:, 1] / radius, np.cos(angle)], axis=1))


def test_a_tube_hangs_from_its_rim_by_its_own_weight():
    """Each height carries what hangs below it: the tube grows by rho g L^2 / (2 E), E = H11 - H01^2 / H00.

    Twice the density against once: a triangulated cylinder is lower than a smooth one (Schwarz), loaded or not.
    """
    mesh = tube_mesh()
    nodes = upright(mesh)
    held, rim = topmost_opening(mesh.faces, nodes), nodes[:, 1] < -0.3 + 1e-9
    hems = []
    for factor in (1.0, 2.0):
        cloth = replace(WOVEN, density_kg_m2=factor * WOVEN.density_kg_m2)
        drape = settle_at_rest(mesh, nodes, FAR, cloth, held=held)
        assert drape.report.converged
        assert_allclose(drape.nodes[held], nodes[held], atol=0.0)
        hems.append(drape.nodes[rim, 1].mean())
    growth = WOVEN.density_kg_m2 * 9.81 * 0.6**2 / (2.0 * (WOVEN.h11 - WOVEN.h01**2 / WOVEN.h00))
    assert_allclose(hems[0] - hems[1], growth, rtol=0.1)


def test_a_belt_closes_round_the_body_before_it_holds():
    """A tube of 0.8 m starts inside a body of 1.0 m: it lies on the skin, and then nothing moves its rim."""
    mesh = tube_mesh()
    drape = settle_at_rest(mesh, 0.95 * upright(mesh), cylinder(0.16), WOVEN, held="belt")
    assert drape.report.converged
    # Nodes that the repulsion throws off and on do not keep the steps going: a third of the limit would be the belt's.
    assert drape.steps < STEP_LIMIT // 2
    assert set(drape.held) == set(topmost_opening(mesh.faces, upright(mesh)))
    radius = np.hypot(drape.nodes[drape.held, 0], drape.nodes[drape.held, 2])
    assert radius.min() > 0.16 and radius.max() < 0.16 + SkinContact(FAR).gap_m + 1e-3


def slab(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The distance of a slab without end between front and back."""
    return np.abs(points[:, 2]) - 0.1, np.sign(points[:, 2:]) * [0.0, 0.0, 1.0]


def apart() -> np.ndarray:
    """The tube's placed panels, 20 cm further from each other."""
    return tube_mesh().placed() + np.where(tube_mesh().panel == 0, 0.1, -0.1)[:, None] * [0.0, 0.0, 1.0]


HIGH = tube(*(rectangle(name, translation_m=(0.0, 3.0, z)) for name, z in (("front", 0.2), ("back", -0.2))))
FACED = in_numpy(PlaneDistance((0.0, 0.0, 2.0), (0.0, 0.0, 1.0)))  # the front's right side looks at it


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: scale_pattern(tube(), 0.0), "scale"),
        (lambda: scale_pattern(tube(), 3.0), "scale"),
        (lambda: scale_pattern(tube(), float("nan")), "scale"),
        (lambda: check_placed(Pattern("heap", (rectangle("a"), rectangle("b")))), "2 panels in one place"),
        (lambda: move_clear(tube_mesh(), tube_mesh().placed(), FACED), "panel front"),
        (
            lambda: place_panels(mesh_pattern(HIGH, 0.1), load_body(), body_distance()),
            "the neck, the chest or the waist",
        ),
        (lambda: sew(tube_mesh(), tube_mesh().placed(), slab), "edges that meet round the body"),
        # 0.8 m of cloth round a body of 1.6 m.
        (lambda: sew(tube_mesh(), apart(), in_numpy(cylinder(0.255))), "Size the pattern up"),
        (lambda: settle_at_rest(tube_mesh(), sewn_tube().nodes, FAR, WOVEN, lowest_top_m=-0.5), "Give it a belt"),
    ],
)
def test_what_cannot_be_placed_sewn_or_held_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def unsettled() -> tuple[ClothModel, ClothState, Parameters, SkinContact]:
    """A snug tube on a cylinder, its nodes 1 mm off at random."""
    mesh, noise = tube_mesh(), np.random.default_rng(1)
    nodes = upright(mesh)
    contact = SkinContact(cylinder(0.16), friction=0.0)
    model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces, fixed=topmost_opening(mesh.faces, nodes))
    parameters = model.parameters(mesh.rest, WOVEN)
    rest, report = to_rest(model, model.state(nodes), parameters, contact)
    assert report.converged
    return model, model.state(rest.x.numpy() + 1e-3 * noise.normal(size=nodes.shape)), parameters, contact


def force_left(model: ClothModel, state: ClothState, parameters: Parameters, contact: SkinContact) -> float:
    """The largest force [N] on a node, evaluated anew."""
    return equilibrium(model, state, parameters, contact=contact, iteration_limit=0)[1].residual_n


def test_where_newton_does_not_arrive_implicit_steps_do():
    """Three of Newton's iterations leave more force than there was at the start; steps of three each reach rest."""
    model, start, parameters, contact = unsettled()
    alone = equilibrium(model, start, parameters, contact=contact, tolerance_n=TOLERANCE_N, iteration_limit=3)[1]
    assert not alone.converged and alone.residual_n > force_left(model, start, parameters, contact) > 1.0
    found, report = to_rest(model, start, parameters, contact, iteration_limit=3)
    assert report.converged and report.iterations > alone.iterations
    assert force_left(model, found, parameters, contact) <= TOLERANCE_N
    # It is the drape that Newton finds when it may go on.
    sure = to_rest(model, start, parameters, contact)[0]
    assert_allclose(found.x, sure.x, atol=1e-5)


@pytest.mark.parametrize("limit", [0, 1])
def test_what_does_not_come_to_rest_is_the_shape_with_the_least_force_and_says_so(limit):
    """No force is as small as 1e-30 N; without iterations the start is all there is."""
    model, start, parameters, contact = unsettled()
    alone = equilibrium(model, start, parameters, contact=contact, iteration_limit=limit)[1]
    found, report = to_rest(model, start, parameters, contact, tolerance_n=1e-30, iteration_limit=limit)
    assert not report.converged
    assert_allclose(report.residual_n, force_left(model, found, parameters, contact), rtol=1e-6)
    assert report.residual_n <= min(alone.residual_n, force_left(model, start, parameters, contact))
    assert (limit == 0) == bool((found.x == start.x).all())


def test_a_stiff_cloth_is_draped_no_stiffer_than_its_weight_asks_for():
    """A metre of satin hangs 1 % longer, its coupling and bending as they were; jersey is soft enough as it is."""
    satin, hung = MEASURED["satin"].woven, hanging("satin")
    assert hung.h00 == hung.h11 == satin.density_kg_m2 * 9.81 / 0.01 < min(satin.h00, satin.h11)
    assert_allclose(hung.h01 / np.sqrt(hung.h00 * hung.h11), satin.h01 / np.sqrt(satin.h00 * satin.h11))
    assert replace(hung, h00=satin.h00, h01=satin.h01, h11=satin.h11) == satin
    assert all(hanging(name) == FABRICS[name].woven for name in FABRICS)
