"""The loss of a fit against closed forms and differences, and a search that is exact, bounded and resumable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import cast

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from drape.errors import ArtifactError, InputError
from drape.garment.contours import Contour, ContourPlace, Match, open_contours
from recovery.fit.forward import RestDrape, belt_on
from recovery.fit.objective import (
    Objective,
    TargetSurface,
    fold_weights,
    gauss_newton_matrix,
    mean_curvature,
    nearest_on_line,
    polyline_chamfer,
)
from recovery.fit.optimise import Evaluation, FitOptions, PatternSearch
from recovery.pattern.bases import tshirt
from recovery.pattern.coordinates import control_points, with_controls
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.sewing_pattern import Pattern
from recovery.pattern.symmetry import find_symmetries, free_controls
from recovery.sim.skin_contact import Sphere
from tests.drape.geometry.geometry_shapes import icosphere
from tests.recovery.pattern_error import pattern_error
from tests.recovery.pattern_setup import default_measurements, rectangle, tube
from tests.recovery.sim_setup import WOVEN as CLOTH

NOWHERE = Sphere((0.0, -10.0, 0.0), 0.1)


def cone_mesh() -> PatternMesh:
    """A short tube of two panels, wider below."""
    front = rectangle("front", 0.3, 0.2, translation_m=(0.0, 0.0, 0.1))
    wide = front.vertices * [1.0, 1.0] + np.where(front.vertices[:, 1:] < 0, front.vertices * [0.2, 0.0], 0.0)
    front = replace(front, vertices=wide)
    back = replace(
        rectangle("back", rotation_deg=(0.0, 180.0, 0.0), translation_m=(0.0, 0.0, -0.1)), vertices=wide.copy()
    )
    return mesh_pattern(tube(front, back), 0.05)


def paired(targets: Sequence[int]) -> list[Match]:
    """Matches of contours 0, 1, ... with these of the target."""
    return [Match(i, j, ContourPlace("trunk", 0.0, np.zeros(3)), 1.0, 0.0) for i, j in enumerate(targets)]


def slope(finder: PatternSearch, at: Evaluation, direction: np.ndarray) -> float:
    """The derivative of the loss along ``direction`` by differences through the drape."""
    step = 2e-6
    ends = [finder.evaluate(at.values + sign * step * direction, at.nodes) for sign in (1.0, -1.0)]
    assert ends[0] is not None and ends[1] is not None
    return (ends[0].terms[0] - ends[1].terms[0]) / (2.0 * step)


def wider_below(mesh: PatternMesh) -> np.ndarray:
    """Control points [m] (K, 2) of a pattern that is 6 % wider and 5 % longer below its middle."""
    corners = mesh.controls.positions
    return corners + np.where(corners[:, 1:] < 0.0, corners * [0.06, 0.05], 0.0)


@lru_cache(maxsize=1)
def scene() -> tuple[PatternMesh, RestDrape, np.ndarray, TargetSurface, list[Contour], list[Match]]:
    """A tube held at its upper border, its drape, and a target: the drape of a pattern that is 6 % wider below."""
    mesh = cone_mesh()
    flat = mesh.nodes_from(mesh.placed())
    # Round the upper border so that the cloth hangs from a ring.
    top = flat[:, 1] > 0.0999
    reach = np.abs(flat[top, 0]).max()
    angle = 0.5 * np.pi * flat[top, 0] / reach
    flat[top, 0], flat[top, 2] = 0.095 * np.sin(angle), np.sign(flat[top, 2] + 1e-12) * 0.095 * np.cos(angle)
    forward = RestDrape(mesh, NOWHERE, CLOTH, held=np.flatnonzero(top), tolerance_n=1e-10, iteration_limit=300)
    x, report = forward(torch.from_numpy(mesh.rest), flat)
    assert report.converged
    nodes = x.numpy()
    there, report = forward(torch.from_numpy(mesh.rest_at(wider_below(mesh))), nodes)
    assert report.converged
    contours = open_contours(nodes, mesh.faces)
    target = TargetSurface.from_mesh(there.numpy(), mesh.faces)
    heights = np.array([other.centre[1] for other in target.contours])
    matches = paired([int(np.abs(heights - contour.centre[1]).argmin()) for contour in contours])
    return mesh, forward, nodes, target, contours, matches


def belted() -> RestDrape:
    """The tube of the scene hung from a ring along which its nodes go as the pattern says."""
    mesh, forward, nodes = scene()[:3]
    angle = 2.0 * np.pi * (np.arange(50) + 0.3) / 50
    ring = np.stack([0.095 * np.sin(angle), np.full(50, 0.1), 0.095 * np.cos(angle)], axis=1)
    belt = belt_on(mesh, nodes, np.flatnonzero(forward.model.fixed), ring)
    assert belt is not None
    return RestDrape(mesh, NOWHERE, CLOTH, belt=belt, tolerance_n=1e-10, iteration_limit=300)


def search(*, belt: bool = False) -> tuple[PatternSearch, np.ndarray]:
    """A search in the scene, and the nodes to start from."""
    mesh, forward, nodes, target, contours, matches = scene()
    forward = belted() if belt else forward
    # Equal weights, so that the loss is smooth: that of the nearest point is held while differentiating.
    even = replace(target, weights=np.ones(len(target.weights)))
    free = free_controls(mesh.pattern, find_symmetries(mesh.pattern))
    return PatternSearch(mesh, free, forward, Objective(mesh, even, contours, matches)), nodes


def test_mean_curvature_of_sphere_cylinder_and_plane():
    vertices, faces = icosphere(4, radius_m=0.1)
    assert_allclose(np.median(mean_curvature(vertices, faces)), 10.0, rtol=0.01)
    mesh = mesh_pattern(tube(), 0.02)
    angle = np.pi * mesh.rest[:, 0] / 0.4  # half a circle each
    front = mesh.panel == 0
    radius = 0.4 / np.pi
    world = np.stack([radius * np.sin(angle), mesh.rest[:, 1], radius * np.cos(angle)], axis=1)
    world[~front] *= [-1.0, 1.0, -1.0]
    nodes = mesh.nodes_from(world)
    inner = np.abs(nodes[:, 1]) < 0.27
    assert_allclose(np.median(mean_curvature(nodes, mesh.faces)[inner]), 0.5 / radius, rtol=0.02)
    assert (mean_curvature(nodes, mesh.faces)[open_contours(nodes, mesh.faces)[0].loop] == 0.0).all()
    flat = np.column_stack([mesh.rest[front], np.zeros(front.sum())])
    assert mean_curvature(flat, mesh.panel_faces[mesh.face_panel == 0]).max() < 1e-9
    assert_allclose(fold_weights(np.array([0.0, 50.0, 1000.0])), [1.0, 1.5, 5.0])


def test_the_distance_to_itself_is_zero_however_it_is_triangulated():
    coarse, fine = (mesh_pattern(tube(), length) for length in (0.12, 0.05))
    nodes = coarse.nodes_from(coarse.placed())
    flat = np.column_stack([fine.rest, np.zeros(len(fine.rest))])
    same = TargetSurface.from_mesh(nodes, coarse.faces)
    x = torch.from_numpy(nodes)
    terms = Objective(coarse, same, same.contours, paired((0, 1)))(x)
    assert float(terms.total) < 1e-20
    # One panel alone in another triangulation, and lifted by d: d^2 in both directions.
    front = coarse.panel_faces[coarse.face_panel == 0]
    other = TargetSurface.from_mesh(flat, fine.panel_faces[fine.face_panel == 0])
    only = replace(coarse, faces=front, panel_faces=front)
    for lift in (0.0, 0.01):
        world = np.column_stack([coarse.rest, np.full(len(coarse.rest), lift)])
        loss = Objective(only, other, [], []).surface(torch.from_numpy(world))
        assert_allclose(float(loss), 2.0 * lift**2, atol=1e-16)


def test_polylines_at_a_distance():
    angle = 2.0 * np.pi * np.arange(40) / 40
    first = torch.from_numpy(np.stack([np.cos(angle), np.zeros(40), np.sin(angle)], axis=1))
    lifted = first + torch.tensor([0.0, 0.3, 0.0], dtype=torch.float64)
    assert_allclose(float(polyline_chamfer(first, lifted)), 2.0 * 0.09, rtol=1e-12)
    # Corners inserted into straight sides change nothing.
    finer = torch.stack([first, 0.5 * (first + torch.roll(first, -1, dims=0))], dim=1).reshape(-1, 3)
    assert float(polyline_chamfer(finer, first)) < 1e-24
    assert_allclose(float(polyline_chamfer(finer, lifted)), 2.0 * 0.09, rtol=1e-12)


def test_the_nearest_point_of_a_closed_line_is_on_its_last_segment_too():
    square = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]], dtype=torch.float64)
    points = torch.tensor([[-0.1, 0.25, 0.3], [0.6, -0.2, 0.0], [2.0, 2.0, 0.0]], dtype=torch.float64)
    best, t = nearest_on_line(points, square)
    found = square[best] + t[:, None] * (torch.roll(square, -1, dims=0) - square)[best]
    assert_allclose(found, [[0.0, 0.25, 0.0], [0.6, 0.0, 0.0], [1.0, 1.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize("belt", [False, True])
def test_the_gradient_agrees_with_differences_through_the_drape(belt):
    """Free control points to nodes at rest to the loss."""
    finder, nodes = search(belt=belt)
    rng = np.random.default_rng(0)
    values = 0.002 * rng.normal(size=finder.free.count)
    finder.likely = 0.002 * rng.normal(size=finder.free.count)
    at = finder.evaluate(values, nodes)
    assert at is not None and at.terms[0] > 0.0
    direction = rng.normal(size=finder.free.count) + 2.0 * np.sign(at.gradient)
    assert_allclose(at.gradient @ direction, slope(finder, at, direction), rtol=2e-5)


@pytest.mark.parametrize("belt", [False, True])
def test_the_drape_moves_as_its_sensitivity_says(belt):
    finder, nodes = search(belt=belt)
    mesh, forward = finder.mesh, finder.forward
    rng = np.random.default_rng(2)
    moves = np.stack([mesh.rest_at(c) for c in rng.normal(size=(2, *mesh.controls.positions.shape))], axis=2)
    at, _ = forward(torch.from_numpy(mesh.rest), nodes)
    found = forward.sensitivity(torch.from_numpy(mesh.rest), at.numpy(), moves)
    step = 1e-5
    for k in range(2):
        ends = [forward(torch.from_numpy(mesh.rest + sign * step * moves[:, :, k]), nodes)[0] for sign in (1.0, -1.0)]
        numeric = (ends[0] - ends[1]).numpy() / (2.0 * step)
        assert_allclose(found[:, :, k], numeric, atol=2e-4 * np.abs(numeric).max())


@pytest.mark.parametrize("pairs", [(), (0, 1)])
def test_where_the_fit_is_exact_the_matrix_is_the_second_derivative(pairs):
    """The loss a small way from its zero is half the square of that way in the matrix, with contours and without."""
    mesh, forward, nodes, _, contours, _ = scene()
    own = TargetSurface.from_mesh(nodes, mesh.faces)
    objective = Objective(mesh, own, contours, paired(pairs))
    rng = np.random.default_rng(5)
    directions = np.stack([mesh.rest_at(c) for c in rng.normal(size=(3, *mesh.controls.positions.shape))], axis=2)
    moves = forward.sensitivity(torch.from_numpy(mesh.rest), nodes, directions)
    matrix = gauss_newton_matrix(objective, nodes, moves)
    assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())
    for way in rng.normal(size=(4, 3)):
        step = 1e-5 * way
        loss = objective(torch.from_numpy(nodes + moves @ step)).total
        assert_allclose(float(loss), 0.5 * step @ matrix @ step, rtol=0.05)


def test_pieces_take_their_share_of_the_belt():
    """A front that is wider at the waist has as much more of the ring, its middle where it was, either way round."""
    mesh, forward, nodes = scene()[:3]
    belt = belted().belt
    assert belt is not None
    held = np.flatnonzero(forward.model.fixed)
    front = np.isin(belt.held, mesh.node_of_panel_vertex[mesh.panel == 0])
    wider = torch.from_numpy(mesh.rest * np.where(mesh.panel == 0, 1.2, 1.0)[:, None])
    for one in (belt, belt_on(mesh, nodes, held, belt.line.numpy()[::-1].copy())):
        assert one is not None and set(one.held) == set(held)
        places = one.places(wider).numpy()
        assert np.abs(np.linalg.norm(places[:, [0, 2]], axis=1) - 0.095).max() < 2.1e-4  # a chord's height
        angle = np.degrees(np.arctan2(places[front, 0], places[front, 2]))
        assert_allclose(np.ptp(angle), 360.0 * 1.2 / 2.2, atol=0.2)
        assert_allclose(angle.max() + angle.min(), 0.0, atol=2.0)
    assert belt_on(mesh, nodes, held[1:], belt.line.numpy()) is None
    assert belt_on(mesh, nodes, held, belt.line.numpy() + np.array([1.0, 0.0, 0.0])) is None


def test_a_search_finds_the_pattern_back():
    """The hem's corners end where the target's are; control points within 1 mm, area within half a percent."""
    finder, nodes = search()
    mesh = finder.mesh
    found = finder.run(nodes, FitOptions(iterations=8, closing=6, rate_m=2e-3))
    truth = with_controls(mesh.pattern, mesh.controls, wider_below(mesh))
    before, after = (pattern_error(pattern, truth) for pattern in (mesh.pattern, found.pattern))
    assert before.controls_m.max() > 0.005 and np.abs(before.areas).max() > 0.05
    assert after.controls_m.max() < 1e-4 and np.abs(after.areas).max() < 0.001
    assert found.history[:, 0].min() < 1e-6 * found.history[0, 0]
    assert len(find_symmetries(found.pattern, tolerance_m=1e-9).between) == 1
    assert_allclose(control_points(found.pattern).positions, found.positions, atol=1e-15)


def test_errors_of_a_pattern_leave_out_where_its_panels_lie():
    truth = cone_mesh().pattern
    controls = control_points(truth)
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    same = with_controls(truth, controls, controls.positions @ turn + [0.3, -0.2])
    error = pattern_error(same, truth)
    assert error.controls_m.max() < 1e-12 and np.abs(error.areas).max() < 1e-12
    larger = pattern_error(with_controls(truth, controls, 1.01 * controls.positions), truth)
    assert_allclose(larger.areas, 1.01**2 - 1.0, rtol=1e-9)
    offsets = controls.positions - np.array([p.vertices.mean(axis=0) for p in truth.panels])[controls.panel]
    assert_allclose(larger.controls_m, 0.01 * np.linalg.norm(offsets, axis=1), rtol=1e-9)
    with pytest.raises(InputError, match="patterns"):
        pattern_error(truth, Pattern("one", truth.panels[:1]))


def test_a_search_goes_on_bit_for_bit(tmp_path):
    finder, nodes = search()
    options = FitOptions(iterations=3, closing=2, rate_m=2e-3)
    whole = finder.run(nodes, options)
    again = finder.run(nodes, options)
    assert (whole.history == again.history).all() and (whole.nodes == again.nodes).all()
    path = tmp_path / "state.npz"
    part = finder.run(nodes, options, state_file=path, limit=2)
    assert len(part.history) == 3 and path.exists()
    rest = finder.run(np.zeros_like(nodes), options, state_file=path)  # the start is not asked for again
    assert (rest.history == whole.history).all() and (rest.positions == whole.positions).all()
    with pytest.raises(ArtifactError, match="another pattern, target or other options"):
        finder.run(nodes, FitOptions(iterations=7), state_file=path)
    path.write_bytes(b"not a state")
    with pytest.raises(ArtifactError, match="state of a search"):
        finder.run(nodes, options, state_file=path)


def test_what_folds_or_does_not_rest_is_never_accepted(monkeypatch):
    """A step is halved while the pattern folds or the drape fails, and the search ends where nothing is left."""
    finder, nodes = search()
    squeezed = np.where(finder.free.origin[:, 1:] < 0.0, finder.free.origin * [-0.5, 1.0], finder.free.origin)
    assert len(finder.mesh.folded(finder.mesh.rest_at(squeezed))) > 0
    assert finder.evaluate(finder.free.values(squeezed), nodes) is None
    evaluate = finder.evaluate
    calls = []

    def fails_far_out(values, near):
        calls.append(float(np.abs(values).max()))
        return evaluate(values, near) if calls[-1] < 6e-4 else None

    monkeypatch.setattr(finder, "evaluate", fails_far_out)
    found = finder.run(nodes, FitOptions(iterations=1, closing=0, rate_m=2e-3))
    assert found.history[1, 3] == 2.0 and found.finished  # 2 mm and 1 mm refused, half a millimetre taken
    monkeypatch.setattr(finder, "evaluate", lambda values, near: evaluate(values, near) if not values.any() else None)
    stuck = finder.run(nodes, FitOptions(iterations=3, rate_m=2e-3))
    assert not stuck.finished and len(stuck.history) == 1
    monkeypatch.setattr(finder, "evaluate", lambda values, near: None)
    with pytest.raises(InputError, match="start of the search"):
        finder.run(nodes, FitOptions(iterations=1, closing=0))


def test_what_cannot_be_cut_is_never_accepted():
    """A neckline that crosses itself between nodes of a coarse mesh, none of whose triangles is folded."""
    mesh = mesh_pattern(tshirt(default_measurements()), 0.05)
    free = free_controls(mesh.pattern, find_symmetries(mesh.pattern))
    finder = PatternSearch(mesh, free, cast(RestDrape, None), cast(Objective, None))
    values = -0.14 * np.eye(free.count)[6]
    positions = free.positions(values)
    assert len(mesh.folded(mesh.rest_at(positions))) == 0
    with pytest.raises(InputError, match="does not cross itself"):
        mesh_pattern(with_controls(mesh.pattern, mesh.controls, positions), 0.05)
    assert finder.evaluate(values, np.zeros((mesh.node_count, 3))) is None


def test_options_that_search_nothing_are_refused():
    for wrong in (("closing", -1), ("rate_m", 0.5), ("last_rate_m", 0.0)):
        with pytest.raises(InputError, match="fit options"):
            replace(FitOptions(), **dict([wrong]))
    with pytest.raises(InputError, match="fit options"):
        FitOptions(iterations=0, closing=0)
    options = FitOptions(iterations=11, rate_m=1e-3, last_rate_m=1e-4)
    assert_allclose([options.rate(k) for k in (0, 5, 10)], [1e-3, 5.5e-4, 1e-4])
