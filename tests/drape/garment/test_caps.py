"""Pits by which closed cloth ends where limbs come out."""

from __future__ import annotations

import numpy as np

from drape.body.assets import load_body
from drape.body.skeleton import JOINT_NAMES
from drape.garment.caps import without_pits
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.intake_options import IntakeOptions
from drape.garment.modelled_on import modelled_on
from drape.garment.reading_hints import ReadingHints
from drape.garment.wearer_search import the_wearer
from drape.geometry import meshes
from tests.drape.cloth.cloth_shapes import grid
from tests.drape.garment.garment_files import shirt

BODY = load_body()
# Radius over that of the opening, and depth [m] below it, from a rim that is round.
PIT = (
    (1.005, -0.004),
    (0.99, -0.006),
    (0.97, -0.004),
    (0.95, 0.004),
    (0.94, 0.015),
    (0.9, 0.025),
    (0.6, 0.03),
    (0.2, 0.032),
)


def with_pit(points: np.ndarray, faces: np.ndarray, loop: np.ndarray, inward: np.ndarray) -> GarmentMesh:
    """A mesh whose opening ``loop`` is closed by a pit that goes ``inward`` (3,)."""
    middle = points[loop].mean(axis=0)
    count, rows, last = len(loop), [points], loop
    added = [faces]
    for share, depth_m in PIT:
        row = len(np.concatenate(rows)) + np.arange(count)
        rows.append(middle + share * (points[loop] - middle) + depth_m * inward)
        following, beside = np.roll(last, -1), np.roll(row, -1)
        added += [np.stack([last, row, following], 1), np.stack([following, row, beside], 1)]
        last = row
    rows.append((middle + 0.033 * inward)[None])
    added.append(np.stack([last, np.full(count, len(np.concatenate(rows)) - 1), np.roll(last, -1)], axis=1))
    return plain_mesh("closed", np.concatenate(rows), np.concatenate(added))


def closed_at_the_neck() -> tuple[GarmentMesh, int]:
    """The shirt of the standard body with a pit for a neck, and how many of its faces are the shirt's."""
    points, faces = shirt(BODY, BODY.v_template)
    neck = max(meshes.boundary_loops(faces), key=lambda loop: points[loop, 1].mean())
    return with_pit(points, faces, neck, np.array([0.0, -1.0, 0.0])), len(faces)


def test_a_pit_across_a_bone_is_told_with_its_walls():
    mesh, cloth = closed_at_the_neck()
    keep = without_pits(mesh.vertices, mesh.faces, BODY.joints_template)
    assert keep[:cloth].all() and keep[cloth:].mean() < 0.4  # the rim stays, turned in
    assert len(meshes.boundary_loops(mesh.faces[keep])) == len(meshes.boundary_loops(shirt(BODY, BODY.v_template)[1]))


def test_cloth_that_a_bone_goes_through_aslant_is_no_pit():
    points, faces = grid(24, 24, cell_m=0.02)
    elbow = BODY.joints_template[JOINT_NAMES.index("left_elbow")]
    points = points - points.mean(axis=0)
    normal = np.linalg.svd(points)[2][2]
    helper = np.linalg.svd(points)[2][:2]
    aslant = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
    across = np.array([[-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) / np.array([[np.sqrt(2.0)], [1.0]])
    placed = points @ helper.T @ across + (points @ normal)[:, None] * aslant + elbow + [0.1, 0.0, 0.0]
    assert without_pits(placed, faces, BODY.joints_template).all()
    assert without_pits(*shirt(BODY, BODY.v_template), BODY.joints_template).all()


def test_a_shirt_that_is_closed_at_the_neck_is_found_where_it_is_worn():
    """The body was found 8 cm lower, its neck beside the pit."""
    mesh, _ = closed_at_the_neck()
    moved = plain_mesh("shirt", mesh.vertices + np.array([0.4, 0.2, -0.1]), mesh.faces)
    found = the_wearer(moved, BODY, ReadingHints(("m", 1.0), "+y", "+z"))
    np.testing.assert_allclose(found.trans, [0.4, 0.2, -0.1], rtol=0, atol=0.015)
    placed, _, _ = modelled_on(mesh, BODY, IntakeOptions())
    assert len(placed.faces) < len(mesh.faces) and "in pits" in placed.notes[-1]
    count = len(mesh.vertices)  # of the delivered mesh, which hangs on that
    np.testing.assert_array_equal(placed.vertices[:count], mesh.vertices)
    assert placed.faces.min() >= count
