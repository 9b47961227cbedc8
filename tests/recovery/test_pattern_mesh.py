"""Triangles, mean value coordinates and the sewn mesh: quality, exact maps, closed surfaces, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.errors import InputError, MeshError
from drape.geometry import meshes
from recovery.pattern import geometry
from recovery.pattern.coordinates import (
    boundary_matrix,
    control_points,
    edge_point_matrix,
    mean_value_weights,
    with_controls,
)
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.pattern_mesh import corner_angles_deg, mesh_pattern, segment_counts, triangulate
from recovery.pattern.sewing_pattern import Edge, EdgeKind, EdgeRef, Panel, Pattern, Stitch
from recovery.sim.cloth_model import ClothModel
from tests.recovery.pattern_setup import curved, rectangle, tube
from tests.recovery.sim_setup import WOVEN

# A polygon with a deep hollow, and one that is convex; both counter-clockwise.
HOLLOW = np.array([(0, 0), (4, 0), (4, 3), (2.2, 3), (2, 0.7), (1.8, 3), (0, 3)], dtype=float)
CONVEX = np.array([(0, 0), (2, -0.5), (3, 1), (2, 2.5), (0.5, 2)], dtype=float)


def points_inside(polygon: np.ndarray, rng: np.random.Generator, count: int = 60) -> np.ndarray:
    """Random points of the triangles of ``polygon``."""
    points, faces = triangulate(polygon, 0.5)
    shares = rng.dirichlet(np.ones(3), size=count)
    return (points[faces[rng.integers(len(faces), size=count)]] * shares[..., None]).sum(axis=1)


@pytest.mark.parametrize("polygon", [HOLLOW, CONVEX])
@pytest.mark.parametrize("edge", [0.1, 0.35, 9.0])
def test_triangles_fill_the_polygon_and_keep_its_boundary(polygon, edge):
    points, faces = triangulate(polygon, edge)
    assert_allclose(points[: len(polygon)], polygon, atol=0)
    x, y = polygon.T
    area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
    areas = meshes.signed_areas(points, faces)
    assert areas.min() > 0.0
    assert_allclose(areas.sum(), area, rtol=1e-12)
    (loop,) = meshes.boundary_loops(faces)
    assert_allclose(np.sort(loop), np.arange(len(polygon)))
    assert len(np.unique(faces)) == len(points)


def test_triangles_of_an_evenly_cut_boundary_are_near_equilateral():
    for edge in (0.015, 0.03, 0.06):
        mesh = mesh_pattern(CURVED, edge)
        assert mesh.smallest_angles_deg()["curved"] > 25.0
        lengths = meshes.edge_lengths(np.pad(mesh.rest, ((0, 0), (0, 1))), meshes.unique_edges(mesh.panel_faces))
        assert 0.9 * edge < lengths.mean() < 1.15 * edge and lengths.max() < 1.7 * edge


def test_a_mirrored_panel_gets_the_mirrored_mesh():
    panel = rectangle(width=0.37, height=0.5)
    points, _ = triangulate(_cut(panel, 0.05), 0.05)
    mirrored, _ = triangulate(np.roll((_cut(panel, 0.05) * [-1.0, 1.0])[::-1], 1, axis=0), 0.05)
    order = np.lexsort(np.round(points, 6).T)
    other = np.lexsort(np.round(mirrored * [-1.0, 1.0], 6).T)
    assert_allclose(points[order], (mirrored * [-1.0, 1.0])[other], atol=1e-9)


def _cut(panel: Panel, edge: float) -> np.ndarray:
    counts = segment_counts(Pattern("one", (panel,)), edge)
    parts = [
        geometry.edge_points(panel, number, geometry.equal_parameters(side, counts[EdgeRef(panel.name, number)])[:-1])
        for number, side in enumerate(panel.edges)
    ]
    return np.concatenate(parts)


def test_angles_of_a_known_triangle():
    points = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, np.sqrt(3.0))])
    assert_allclose(corner_angles_deg(points, np.array([[0, 1, 2]])), [[90.0, 60.0, 30.0]])


@pytest.mark.parametrize("polygon", [HOLLOW, CONVEX])
def test_weights_sum_to_one_and_reproduce_linear_functions(polygon, rng):
    points = points_inside(polygon, rng)
    weights = mean_value_weights(points, polygon)
    assert_allclose(weights.sum(axis=1), 1.0, rtol=0, atol=1e-13)
    assert_allclose(weights @ polygon, points, rtol=0, atol=1e-12)
    if polygon is CONVEX:
        assert weights.min() > 0.0


def test_weights_follow_floaters_angles(rng):
    points = points_inside(CONVEX, rng, 5)
    for point, row in zip(points, mean_value_weights(points, CONVEX), strict=True):
        arms = CONVEX - point
        direction = np.arctan2(arms[:, 1], arms[:, 0])
        angle = np.mod(np.roll(direction, -1) - direction, 2.0 * np.pi)
        expected = (np.tan(np.roll(angle, 1) / 2) + np.tan(angle / 2)) / np.linalg.norm(arms, axis=1)
        assert_allclose(row, expected / expected.sum(), rtol=1e-10)


def test_a_corner_belongs_to_itself_and_a_side_to_its_ends():
    assert_allclose(mean_value_weights(HOLLOW, HOLLOW), np.eye(len(HOLLOW)), atol=0)
    assert mean_value_weights(HOLLOW[:0], HOLLOW).shape == (0, len(HOLLOW))
    for share in (0.25, 1e-9):
        points = (1 - share) * HOLLOW + share * np.roll(HOLLOW, -1, axis=0)
        expected = (1 - share) * np.eye(len(HOLLOW)) + share * np.roll(np.eye(len(HOLLOW)), 1, axis=1)
        assert_allclose(mean_value_weights(points, HOLLOW), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("distance", [1e-3, 1e-7, 1e-11, 1e-13, 1e-15])
def test_weights_stay_finite_and_continuous_near_sides_and_corners(distance):
    middle = 0.5 * (CONVEX + np.roll(CONVEX, -1, axis=0))
    towards = CONVEX.mean(axis=0)
    for targets in (middle, CONVEX):
        near = targets + distance * (towards - targets)
        weights = mean_value_weights(near, CONVEX)
        assert np.isfinite(weights).all()
        assert_allclose(weights, mean_value_weights(targets, CONVEX), rtol=0, atol=20.0 * distance + 1e-14)
        # libigl takes what is nearer than a micron for a point of the side.
        assert_allclose(weights @ CONVEX, near, rtol=0, atol=1e-12 + (2.0 * distance if distance < 1e-6 else 0.0))


def test_moved_control_points_move_the_curves_exactly(rng):
    """The matrix made before the move gives the curves of the moved pattern, and so do its own numbers."""
    pattern = Pattern("curved", (curved(), curved("other", tuple(EdgeKind)[::-1])))
    for free_curves, count in ((True, 8 + 6), (False, 8)):
        controls = control_points(pattern, free_curves=free_curves)
        assert len(controls) == count
        moved = controls.positions + 0.03 * rng.normal(size=controls.positions.shape)
        after = with_controls(pattern, controls, moved)
        assert_allclose(control_points(after, free_curves=free_curves).positions, moved, rtol=0, atol=1e-14)
    t = [np.linspace(0.0, 0.9, 6)] * 4
    for number, (before, panel) in enumerate(zip(pattern.panels, after.panels, strict=True)):
        mine = moved[controls.panel == number].reshape(-1)
        expected = np.concatenate([geometry.edge_points(panel, edge, t[edge]) for edge in range(4)])
        assert_allclose((boundary_matrix(before, t) @ mine).reshape(-1, 2), expected, rtol=0, atol=1e-14)


def test_a_curve_that_follows_turns_with_its_chord():
    edge = curved().edges[1]
    t = np.linspace(0.0, 1.0, 5)
    matrix = edge_point_matrix(edge, t)
    straight = (matrix @ np.array([0.0, 0.0, 1.0, 0.0])).reshape(-1, 2)
    upright = (matrix @ np.array([0.0, 0.0, 0.0, 1.0])).reshape(-1, 2)
    assert_allclose(upright, straight @ np.array([[0.0, 1.0], [-1.0, 0.0]]), atol=1e-15)


def test_control_points_run_round_each_panel():
    controls = control_points(Pattern("curved", (curved(),)), free_curves=True)
    assert controls.edge.tolist() == [0, 1, 1, 2, 2, 2, 3]
    assert controls.handle.tolist() == [0, 0, 1, 0, 1, 2, 0]


def test_the_mesh_is_a_linear_function_of_the_control_points(rng):
    pattern = Pattern("curved", (curved(), rectangle()))
    mesh = mesh_pattern(pattern, 0.05)
    controls = mesh.controls.positions
    assert_allclose(mesh.rest_at(controls), mesh.rest, rtol=0, atol=1e-14)
    # A similarity of all control points is one of the mesh.
    turn = 1.3 * np.array([[0.8, 0.6], [-0.6, 0.8]])
    assert_allclose(mesh.rest_at(controls @ turn + 0.1), mesh.rest @ turn + 0.1, rtol=0, atol=1e-12)
    # Boundary vertices stay on the moved curves; a panel's control points move only that panel.
    step = np.where((mesh.controls.panel == 0)[:, None], 0.01 * rng.normal(size=controls.shape), 0.0)
    moved = mesh.rest_at(controls + step)
    assert_allclose(moved[mesh.panel == 1], mesh.rest[mesh.panel == 1], rtol=0, atol=1e-15)
    after = with_controls(pattern, mesh.controls, controls + step)
    for ref, along in mesh.edge_vertices.items():
        edge = pattern.panel(ref.panel).edges[ref.edge]
        t = geometry.equal_parameters(edge, len(along) - 1)
        assert_allclose(moved[along], geometry.edge_points(after.panel(ref.panel), ref.edge, t), atol=1e-13)


def test_a_moderate_edit_folds_nothing_and_a_wild_one_is_found():
    mesh = mesh_pattern(CURVED, 0.03)
    controls = mesh.controls.positions
    middle = controls.mean(axis=0)
    for stretch in (np.array([1.2, 0.9]), np.array([0.8, 1.15])):
        assert len(mesh.folded(mesh.rest_at(middle + stretch * (controls - middle)))) == 0
    for corner in range(len(controls)):
        for step in ((0.05, 0.0), (-0.05, 0.0), (0.0, 0.05), (0.0, -0.05)):
            edited = controls.copy()
            edited[corner] += step
            assert len(mesh.folded(mesh.rest_at(edited))) == 0
    wild = controls.copy()
    wild[0] = 2.0 * middle - wild[0]
    assert len(mesh.folded(mesh.rest_at(wild))) > 0


def test_a_tube_is_sewn_into_one_orientable_surface():
    mesh = mesh_pattern(tube(), 0.05)
    assert [len(loop) for loop in meshes.boundary_loops(mesh.faces)] == [16, 16]
    edges = meshes.unique_edges(mesh.faces)
    assert mesh.node_count - len(edges) + len(mesh.faces) == 0  # Euler's number of a tube
    halves = meshes.half_edges(mesh.faces)[:, :2]
    assert len(np.unique(halves, axis=0)) == len(halves)  # neighbours agree on the outside
    assert len(mesh.rest) - mesh.node_count == 2 * 13
    assert (mesh.node_of_panel_vertex[mesh.seam_pairs[:, 0]] == mesh.node_of_panel_vertex[mesh.seam_pairs[:, 1]]).all()
    assert_allclose(np.bincount(mesh.seam_of_pair), [13, 13])
    # Sewn: sides of equal lengths, so pairs lie at equal heights, half the distance of the panels apart.
    placed = mesh.placed()
    assert_allclose(placed[mesh.seam_pairs[:, 0], 1], placed[mesh.seam_pairs[:, 1], 1], atol=1e-14)
    nodes = mesh.nodes_from(placed)
    assert_allclose(nodes[mesh.node_of_panel_vertex[mesh.seam_pairs[:, 0]], 2], 0.0, atol=1e-14)
    # Normals look away from the middle.
    normals = meshes.face_normals(placed, mesh.panel_faces)
    assert (normals[mesh.face_panel == 0, 2] > 0.99).all() and (normals[mesh.face_panel == 1, 2] < -0.99).all()


def test_a_panel_sewn_right_to_wrong_is_turned():
    plain = tube()
    back = replace(plain.panels[1], placement=replace(plain.panels[1].placement, rotation_deg=(0.0, 0.0, 0.0)))
    stitches = (
        Stitch(EdgeRef("front", 1), EdgeRef("back", 1), right_to_wrong=True),
        Stitch(EdgeRef("front", 3), EdgeRef("back", 3), right_to_wrong=True),
    )
    mesh = mesh_pattern(replace(plain, panels=(plain.panels[0], back), stitches=stitches), 0.1)
    halves = meshes.half_edges(mesh.faces)[:, :2]
    assert len(np.unique(halves, axis=0)) == len(halves)
    areas = meshes.signed_areas(mesh.rest, mesh.panel_faces)
    assert (areas[mesh.face_panel == 0] > 0).all() and (areas[mesh.face_panel == 1] < 0).all()
    assert len(mesh.folded(mesh.rest)) == 0
    normals = meshes.face_normals(mesh.placed(), mesh.panel_faces)
    assert (normals[mesh.face_panel == 1, 2] < -0.99).all()


def test_a_dart_closes_on_its_own_panel():
    corners = np.array([(0, 0), (0.4, 0), (0.4, 0.5), (0.25, 0.5), (0.2, 0.2), (0.15, 0.5), (0, 0.5)])
    panel = Panel("dart", corners, tuple(Edge(start, (start + 1) % 7) for start in range(7)))
    pattern = Pattern("dart", (panel,), (Stitch(EdgeRef("dart", 3), EdgeRef("dart", 4)),))
    mesh = mesh_pattern(pattern, 0.03)
    assert len(meshes.boundary_loops(mesh.faces)) == 1
    assert len(mesh.rest) - mesh.node_count == len(mesh.edge_vertices[EdgeRef("dart", 3)]) - 1  # the tip is one point


def test_a_panel_sewn_to_itself_is_a_tube_or_refused_as_a_band_without_outside():
    sleeve = rectangle("sleeve")
    ends = (EdgeRef("sleeve", 1), EdgeRef("sleeve", 3))
    assert len(meshes.boundary_loops(mesh_pattern(Pattern("s", (sleeve,), (Stitch(*ends),)), 0.05).faces)) == 2
    with pytest.raises(MeshError, match="one-sided"):
        mesh_pattern(Pattern("s", (sleeve,), (Stitch(*ends, right_to_wrong=True),)), 0.05)


def pointed_cone() -> Pattern:
    """A triangle with two sides sewn to each other."""
    corners = np.array([(0, 0), (0.4, 0), (0.2, 0.4)])
    triangle = Panel("cone", corners, (Edge(0, 1), Edge(1, 2), Edge(2, 0)))
    return Pattern("cone", (triangle,), (Stitch(EdgeRef("cone", 1), EdgeRef("cone", 2)),))


def test_the_tip_of_a_cone_does_not_collapse():
    mesh = mesh_pattern(pointed_cone(), 0.05)
    assert len(meshes.boundary_loops(mesh.faces)) == 1
    assert mesh.node_count - len(meshes.unique_edges(mesh.faces)) + len(mesh.faces) == 1  # a disk
    assert meshes.signed_areas(mesh.rest, mesh.panel_faces).min() > 0.0
    assert_allclose(meshes.signed_areas(mesh.rest, mesh.panel_faces).sum(), 0.08, rtol=1e-12)


def test_stitches_that_give_no_surface_are_refused():
    cone = pointed_cone()
    with pytest.raises(MeshError, match="the first in panel cone"):
        mesh_pattern(cone, 1.0)
    front, back = rectangle("front"), rectangle("back")
    pillow = [Stitch(EdgeRef("front", number), EdgeRef("back", number), right_to_wrong=True) for number in range(4)]
    for edge in (1.0, 0.1):
        closed = mesh_pattern(Pattern("pillow", (front, back), tuple(pillow)), edge)
        assert meshes.boundary_loops(closed.faces) == []
    corner = Pattern("corner", (front,), (Stitch(EdgeRef("front", 0), EdgeRef("front", 1)),))
    with pytest.raises(MeshError, match="1 edges that fall onto others"):
        mesh_pattern(corner, 1.0)
    assert mesh_pattern(corner, 0.05).node_count > 10


def polygon(*corners: tuple[float, float]) -> np.ndarray:
    return np.array(corners, dtype=float)


DOUBLED = polygon((0, 0), (1, 0), (1, 0), (0, 1))
CURVED = Pattern("curved", (curved(),))
CONTROLS = control_points(CURVED)
TURNED = Pattern("turned", (replace(rectangle(), vertices=rectangle().vertices * [-1.0, 1.0]),))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: triangulate(polygon((0, 0), (1, 1), (1, 0), (0, 1)), 0.3), "simple polygon"),
        (lambda: triangulate(DOUBLED, 0.3), "simple polygon"),
        (lambda: triangulate(polygon((0, 0), (2, 0), (2, 1), (1, 0), (0, 1)), 0.3), "simple polygon"),
        (lambda: triangulate(CONVEX, 0.0), "edge_length_m"),
        (lambda: triangulate(CONVEX, -1.0), "edge_length_m"),
        (lambda: triangulate(CONVEX, np.nan), "edge_length_m"),
        (lambda: triangulate(CONVEX, 1e-6), "edge_length_m"),
        (lambda: triangulate(CONVEX[:2], 0.1), "edge_length_m"),
        (lambda: mesh_pattern(TURNED, 0.1), "counter-clockwise"),
    ],
)
def test_what_cannot_be_meshed_is_refused(make, message):
    with pytest.raises((InputError, MeshError), match=message):
        make()


def test_the_simulator_takes_the_mesh_and_finds_the_area_of_the_pattern():
    pattern = tube()
    mesh = mesh_pattern(pattern, 0.05)
    model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces)
    assert (model.node_of_panel_vertex == mesh.node_of_panel_vertex).all()
    rest = model.rest(model.parameters(mesh.rest, WOVEN).panels)
    assert_allclose(rest.node_area.sum(), sum(geometry.area(panel) for panel in pattern.panels), rtol=1e-12)


@pytest.mark.data
def test_every_pattern_of_the_data_folder_is_sewn_into_a_garment(pattern_files):
    openings = {"tee": 4, "dress_sleeveless": 4, "pants_straight_sides": 3, "skirt_4_panels": 2}
    for path in pattern_files:
        mesh = mesh_pattern(read_pattern(path), 0.03)
        assert min(mesh.smallest_angles_deg().values()) > 24.0
        assert_allclose(mesh.rest_at(mesh.controls.positions), mesh.rest, rtol=0, atol=1e-13)
        if path.stem in openings:
            assert len(meshes.boundary_loops(mesh.faces)) == openings[path.stem]
