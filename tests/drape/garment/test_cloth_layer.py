"""One layer of cloth under meshes as people draw them; what is left out hangs on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.errors import MeshError
from drape.garment import cloth_layer as cloth_layer_module
from drape.garment.bound import OFF, ON, STIFF, Drawer
from drape.garment.cloth_layer import SAME_M, VERTEX_LIMIT, cloth_layer, hung, join_sheets
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.registration import posed_by
from drape.garment.sheets import with_used_vertices
from drape.garment.sleeves import sleeve_of
from drape.garment.wearer_fields import known_parameters
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid, tube
from tests.drape.garment.garment_files import shirt
from tests.drape.geometry.geometry_shapes import box

BODY = load_body()
SKIN = BODY.v_template
CLOTH = plain_mesh("shirt", *shirt(BODY, SKIN))
NORMALS = meshes.vertex_normals(CLOTH.vertices, CLOTH.faces)


def with_parts(*parts: tuple[np.ndarray, np.ndarray]) -> GarmentMesh:
    """The shirt and further pieces in one mesh."""
    vertices, faces = [CLOTH.vertices], [CLOTH.faces]
    for points, own in parts:
        faces.append(own + sum(map(len, vertices)))
        vertices.append(points)
    return plain_mesh("shirt", np.concatenate(vertices), np.concatenate(faces))


def taken(mesh: GarmentMesh) -> tuple[GarmentMesh, np.ndarray, np.ndarray]:
    """The cloth in ``mesh``, the kinds (D,) of its vertices, and how far [m] they are drawn from where they were."""
    cloth = with_used_vertices(cloth_layer(join_sheets(mesh), SKIN))
    drawn = hung(mesh, mesh.vertices, cloth, BODY.regressor @ SKIN, SKIN)
    assert_array_equal(drawn.faces, mesh.faces)
    away = np.linalg.norm(Drawer(drawn, cloth.faces).draw(cloth.vertices) - mesh.vertices, axis=1)
    return cloth, drawn.kind, away


def thick(by_m: float) -> GarmentMesh:
    """The shirt as a solid: outside, inside, and rims between them."""
    count, rims = len(CLOTH.vertices), meshes.boundary_edges(CLOTH.faces)
    inside = CLOTH.faces[:, ::-1] + count
    first, second = rims.T
    rim = np.concatenate(
        [np.stack([first, second, second + count], 1), np.stack([first, second + count, first + count], 1)]
    )
    vertices = np.concatenate([CLOTH.vertices + by_m * NORMALS, CLOTH.vertices])
    return plain_mesh("shirt", vertices, np.concatenate([CLOTH.faces, inside, rim]))


def test_single_layer_is_left_as_it_is():
    assert join_sheets(CLOTH) is CLOTH


def test_a_vertex_of_no_face_may_lie_anywhere():
    """Lengths were shares of the box of all vertices, and the cloth was welded into a point."""
    far = plain_mesh("shirt", np.concatenate([CLOTH.vertices, [[1e6, 0.0, 0.0]]]), CLOTH.faces)
    assert join_sheets(far) is far
    assert cloth_layer(CLOTH, SKIN) is CLOTH


def test_faces_that_share_no_vertices_are_sewn():
    apart = plain_mesh("shirt", CLOTH.vertices[CLOTH.faces.reshape(-1)], np.arange(CLOTH.faces.size).reshape(-1, 3))
    cloth, kind, away = taken(apart)
    assert len(cloth.vertices) == len(CLOTH.vertices)
    assert len(meshes.boundary_loops(cloth.faces)) == len(meshes.boundary_loops(CLOTH.faces))
    assert (kind == ON).all()
    assert away.max() < SAME_M


def closed(points: np.ndarray, faces: np.ndarray, ends: slice, depth_m: float) -> GarmentMesh:
    """The mesh with some of its openings closed by fans, whose middles lie ``depth_m`` within."""
    middle = points[np.unique(faces)].mean(axis=0)
    vertices, fans = [points], [faces]
    for loop in meshes.boundary_loops(faces)[ends]:
        hub = points[loop].mean(axis=0)
        way = middle - hub
        number = sum(map(len, vertices))
        vertices.append((hub + depth_m * way / np.linalg.norm(way))[None])
        fans.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), number)], axis=1))
    return plain_mesh("closed", np.concatenate(vertices), np.concatenate(fans))


def test_closed_ends_of_tubes_are_no_cloth_and_are_drawn():
    points, faces = tube(32, 12, radius_m=0.15, height_m=0.8)
    for depth_m in (0.0, 0.05):
        game = closed(points, faces, slice(None), depth_m)
        assert not len(meshes.boundary_edges(game.faces))
        cloth, kind, away = taken(game)
        assert (len(cloth.vertices), len(cloth.faces)) == (len(points), len(faces))
        assert (kind != ON).sum() == 2 and away.max() < SAME_M


def test_a_crown_and_a_sole_stay():
    points, faces = tube(32, 12, radius_m=0.1, height_m=0.12)
    hat = closed(points, faces, slice(0, 1), 0.02)
    assert join_sheets(hat) is hat


def test_a_collar_hangs_on_its_shirt():
    loop = max(meshes.boundary_loops(CLOTH.faces), key=lambda one: CLOTH.vertices[one, 1].mean())
    rim, count = CLOTH.vertices[loop] + [0.0, 0.001, 0.0], len(loop)
    rise = np.concatenate([rim + step * np.array([0.0, 0.02, 0.0]) for step in range(5)])
    low = np.arange(4 * count)
    beside = count * (low // count) + (low + 1) % count
    cells = [np.stack([low, beside, low + count], axis=1), np.stack([beside, beside + count, low + count], axis=1)]
    cloth, _, _ = taken(with_parts((rise, np.concatenate(cells))))
    assert len(cloth.vertices) == len(CLOTH.vertices)
    assert "hang on them" in cloth.notes[-1]


def test_bad_faces_and_fins_hang_on_the_cloth():
    edge = CLOTH.faces[200, :2]
    tip = CLOTH.vertices[edge].mean(axis=0) + 0.02 * NORMALS[edge[0]]
    count = len(CLOTH.vertices)
    extra = [[*edge, count], CLOTH.faces[10], CLOTH.faces[11][::-1], [3, 3, 5]]
    mesh = plain_mesh("shirt", np.concatenate([CLOTH.vertices, tip[None]]), np.concatenate([CLOTH.faces, extra]))
    cloth, kind, away = taken(mesh)
    assert (len(cloth.vertices), len(cloth.faces)) == (count, len(CLOTH.faces))
    assert (kind[:count] == ON).all()
    assert kind[count] != ON
    assert away.max() < 6e-4


def test_of_thick_cloth_the_outside_is_simulated():
    for by_m in (0.002, 0.006, 0.02):
        cloth, _, away = taken(thick(by_m))
        assert abs(len(cloth.faces) - len(CLOTH.faces)) < 0.02 * len(CLOTH.faces)
        height = np.linalg.norm(cloth.vertices[:, None] - CLOTH.vertices[None, ::7], axis=2).min(axis=1)
        assert np.median(height) > 0.5 * by_m, "the inside was kept"
        assert away.max() < 6e-4


def test_buttons_turn_as_a_whole_and_a_belt_bends():
    at = len(CLOTH.vertices) // 2
    points, faces = box((0.008, 0.008, 0.003))
    button = points + CLOTH.vertices[at] + 0.004 * NORMALS[at]
    lifted = CLOTH.vertices + 0.005 * NORMALS
    waist = np.abs(CLOTH.vertices[:, 1] - CLOTH.vertices[:, 1].min() - 0.12) < 0.04
    used, own = meshes.in_use(CLOTH.faces[waist[CLOTH.faces].all(axis=1)])
    mesh = with_parts((button, faces), (lifted[used], own))
    cloth, kind, away = taken(mesh)
    count = len(CLOTH.vertices)
    assert len(cloth.vertices) == count
    assert (kind[count : count + 8] == STIFF).all()
    assert (kind[count + 8 :] == OFF).mean() > 0.3
    assert away.max() < 6e-4


def test_deep_folds_are_not_the_sides_of_a_wall():
    around, faces = tube(240, 30, radius_m=1.0, height_m=0.5)
    angle = np.arctan2(around[:, 2], around[:, 0])
    radius = 0.26 + 0.02 * np.sin(40 * angle)
    folded = np.column_stack([radius * np.cos(angle), around[:, 1] - 0.6, radius * np.sin(angle)])
    mesh = plain_mesh("skirt", folded, faces)
    assert cloth_layer(join_sheets(mesh), SKIN) is mesh


def test_dense_cloth_is_thinned():
    vertices, faces = CLOTH.vertices, CLOTH.faces
    while len(vertices) < 2 * VERTEX_LIMIT:
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    cloth, kind, away = taken(plain_mesh("shirt", vertices, faces))
    assert len(cloth.vertices) <= VERTEX_LIMIT
    assert len(cloth.face_material) == len(cloth.faces)
    assert len(meshes.boundary_loops(cloth.faces)) == len(meshes.boundary_loops(CLOTH.faces))
    assert np.isin([ON, OFF], kind).all()
    assert away.max() < 6e-4


def test_dense_cloth_with_wrinkles_is_thinned_where_it_touches_itself_in_a_vertex():
    """Quadrics were refused there, and wrinkles let no edge collapse: 28,049 of 29,298 vertices stayed."""
    vertices, faces = CLOTH.vertices, CLOTH.faces
    while len(vertices) < 2 * VERTEX_LIMIT:
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(vertices))
    wrinkled = vertices + noise[:, None] * meshes.vertex_normals(vertices, faces)
    fan = np.flatnonzero((faces == faces[len(faces) // 2, 0]).any(axis=1))
    other = next(face for face in fan if len(np.intersect1d(faces[face], faces[fan[0]])) == 1)
    cloth = cloth_layer(plain_mesh("shirt", wrinkled, np.delete(faces, [fan[0], other], axis=0)), SKIN)
    assert len(np.unique(cloth.faces)) <= VERTEX_LIMIT


def test_cloth_that_cannot_be_thinned_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cloth_layer_module, "VERTEX_LIMIT", 20)
    with pytest.raises(MeshError, match="Simplify the mesh"):
        cloth_layer(CLOTH, SKIN)


def test_panels_that_were_rounded_each_by_itself_have_no_cracks():
    """A hoodie of a shop had 1,948 pieces."""
    front = CLOTH.vertices[CLOTH.faces][:, :, 2].mean(axis=1) > 0.0
    vertices = np.concatenate([CLOTH.vertices, CLOTH.vertices + 2e-4])
    faces = np.concatenate([CLOTH.faces[front], CLOTH.faces[~front] + len(CLOTH.vertices)])
    sheets = join_sheets(plain_mesh("shirt", vertices, faces))
    assert len(meshes.boundary_loops(sheets.faces)) == len(meshes.boundary_loops(CLOTH.faces))


def test_materials_and_texture_stay_with_the_faces():
    uv = CLOTH.vertices[:, :2]
    named = replace(
        CLOTH, uv=uv, uv_faces=CLOTH.faces, material_names=("a", "b"), face_material=np.arange(len(CLOTH.faces)) % 2
    )
    faces = np.concatenate([named.faces, named.faces[:1]])
    twice = replace(named, faces=faces, uv_faces=faces, face_material=np.append(named.face_material, 1))
    cloth = cloth_layer(join_sheets(twice), SKIN)
    assert_array_equal(cloth.face_material, named.face_material)
    assert_allclose(cloth.uv[cloth.uv_faces], uv[named.faces], rtol=0, atol=0)


def test_a_belt_that_arms_hang_by_hangs_on_the_trunk_and_a_cuff_on_its_sleeve():
    """Half of it hung on the sleeves, and was torn as the arms went up."""
    skin = posed_by(BODY, known_parameters(BODY, "standard", 1.4, 0.0))
    joints, points = BODY.regressor @ skin, shirt(BODY, skin)[0]
    cloth = plain_mesh("shirt", points, CLOTH.faces)
    sleeve = sleeve_of(points, cloth.faces, joints, skin)
    arms = points[np.isin(sleeve, (1, 2))]
    unit, faces = tube(48, 2, radius_m=1.0, height_m=1.0)
    middle = np.median(arms, axis=0) * [0.0, 1.0, 1.0]
    belt = unit * [np.abs(arms[:, 0]).min() - 0.005, 0.03, 0.13] + middle
    cuff_at = arms[sleeve[np.isin(sleeve, (1, 2))] == 1].mean(axis=0)
    cuff = unit * [0.08, 0.03, 0.08] + cuff_at
    for piece, trunk in ((belt, True), (cuff, False)):
        mesh = plain_mesh("both", np.concatenate([points, piece]), np.concatenate([cloth.faces, faces + len(points)]))
        corner = hung(mesh, mesh.vertices, cloth, joints, skin).corner[len(points) :]
        assert np.isin(sleeve[corner], (1, 2)).any() != trunk


def test_the_inner_side_of_a_wall_hangs_on_its_own_cloth_not_on_what_it_is_nearer_to():
    """The inner side of a coat's sleeves hung on the trunk beside them: webs spread when the arms went up."""
    thick_m, beside_m = 0.006, 0.01
    points, sheet = tube(24, 12, radius_m=0.1, height_m=0.4)
    inner, near = (points * [1.0 - gap / 0.1, 1.0, 1.0 - gap / 0.1] for gap in (thick_m, beside_m))
    border, count = meshes.boundary_edges(sheet), len(points)
    rims = np.concatenate([np.stack([border[:, 0], border[:, 1], border[:, 0] + count], axis=1),
                           np.stack([border[:, 1], border[:, 1] + count, border[:, 0] + count], axis=1)])  # fmt: skip
    wall = np.concatenate([sheet, sheet[:, ::-1] + count, rims])
    mesh = plain_mesh("walls", np.concatenate([points, inner, near]), np.concatenate([wall, sheet + 2 * count]))
    cloth = plain_mesh("cloth", np.concatenate([points, near]), np.concatenate([sheet, sheet + count]))
    drawn = hung(mesh, mesh.vertices, cloth, BODY.regressor @ SKIN, SKIN)
    assert (drawn.corner[count : 2 * count] < count).all()
    assert_allclose(Drawer(drawn, cloth.faces).draw(cloth.vertices), mesh.vertices, rtol=0, atol=1e-3)


def test_of_sheets_that_face_each_other_each_vertex_hangs_on_its_own():
    """Thinned cloth cuts off waves that are deeper than the gap: what it left out of a sleeve hung on the trunk."""

    def sheets(step: int) -> tuple[GarmentMesh, np.ndarray]:
        unit, faces = grid(48 // step, 240 // step, cell_m=float(step))
        along, side = unit[:, 0], unit[:, 1] - 120.0
        wave, gap = 0.004 * np.sin(np.pi * along / 6.0), 0.001 + 0.004 * np.maximum(np.abs(side) - 6.0, 0.0)
        points = np.stack([0.0025 * along, 0.005 * np.abs(side), gap * np.sign(side) + wave], axis=1)
        return plain_mesh("sheets", points, faces), np.sign(side)

    (mesh, side), (cloth, cloth_side) = sheets(1), sheets(6)
    bound = hung(mesh, mesh.vertices, cloth, np.zeros((24, 3)), np.zeros((1, 3)))
    assert (cloth_side[bound.corner] * side[:, None] * (bound.weight > 1e-6) >= 0.0).all()
