"""Grades a garment of the catalogue: the table from which the service makes its other sizes (``drape.garment.sizes``).

The panels of a size are M's mesh on control points drafted for that size, so that meshes, seams and names stay. The
cloth falls from where M lies, on the coarse mesh of sewing: what is stored is smoother than that. M falls once more
too, so that both lie as that mesh lets them. The upper edge of a waistband stays where it is, as by a belt: a larger
one would slide down the hips.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drape.body.model import BodyModel
from drape.cloth.fabric_table import fabric
from drape.cloth.waistband import waistband
from drape.errors import InputError
from drape.garment.cache import Garment
from drape.garment.size_chart import SIZES
from drape.garment.sizes import (
    GROWN_STEP_M,
    MOVED_STEP_M,
    OTHERS,
    SizeTable,
    field_in_panels,
    field_in_space,
    garment_measures,
    panels_of,
    sized,
)
from recovery.catalogue.design_drape import BuildOptions, design
from recovery.catalogue.fall import SETTLING, Fall
from recovery.pattern.coordinates import control_points
from recovery.pattern.design import Design, check_laid_flat, check_seams
from recovery.pattern.measurements import BodyMeasurements
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern, on_finer_mesh
from recovery.progress import Say
from recovery.sim.skin_contact import SignedDistance

# From points (N, D), rows (A,) of these and values (A, C) there to values (N, C) at all points.
Field = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
FULL = BuildOptions(coarse_steps=120)
FROM = {"M": "M", "S": "M", "L": "M", "XL": "L"}  # the size beside each one, from which it falls
MOVED_WITHIN_M, MOST_VERTICES = 2e-3, 400  # largest error of the moves, and most vertices that give them
GROWN_WITHIN_M, MOST_CORNERS = 2e-4, 40  # the same for the points of each panel
APART_M = {"space": 0.04, "panel": 0.02}  # least distance of rows that are added at once


class GradedSize(NamedTuple):
    """A size on the mesh of size M: ``moved`` [m] (N, 3) leads from M's nodes at rest to its own, and ``panels`` [m]
    (P, 2) are its panel vertices, each in the frame of its panel."""

    moved: np.ndarray
    panels: np.ndarray


def grade_sizes(
    name: str,
    garment: Garment,
    body: BodyModel,
    measurements: BodyMeasurements,
    skin: SignedDistance,
    *,
    report: Say,
    options: BuildOptions = FULL,
) -> SizeTable:
    """Returns the size table of the catalogue's garment ``name``.

    ``garment`` is its size M as the service has it, on ``body`` with these ``measurements``; ``skin`` is the body's
    signed distance. ``report`` gets a line on each fall. Raises ``InputError`` if ``garment`` is not what the catalogue
    sews in M.
    """
    designs = {size: design(name, measurements, size) for size in SIZES}
    for drafted in designs.values():
        check_seams(drafted)
        check_laid_flat(drafted)
    fine = mesh_pattern(designs["M"].pattern, options.fine_m)
    if not (same_triangles(fine.faces, garment.fine_faces) and same_triangles(fine.panel_faces, garment.uv_faces)):
        cure = "Sew it again: python -m recovery.catalogue build --garments."
        raise InputError(f"garment {name}", expected="the catalogue's mesh in M", got="another", cure=cure)
    graded = let_designs_fall(designs, garment, body, fine, skin, report=report, options=options)
    return table_of(garment, body, fine.rest, graded, report=report)


def same_triangles(faces: np.ndarray, others: np.ndarray) -> bool:
    """Returns whether ``faces`` (F, 3) and ``others`` (F, 3) are the same triangles, in whatever order: a triangulation
    begins elsewhere on another processor."""
    ours, theirs = (np.unique(np.sort(rows, axis=1), axis=0) for rows in (faces, others))
    return np.array_equal(ours, theirs)


def let_designs_fall(
    designs: dict[str, Design],
    garment: Garment,
    body: BodyModel,
    fine: PatternMesh,
    skin: SignedDistance,
    *,
    report: Say,
    options: BuildOptions,
) -> dict[str, GradedSize]:
    """Lets ``designs``, by the names of their sizes, fall on ``body``. Returns the ``GradedSize`` of every size but M
    by its name, on the mesh ``fine`` of M.

    ``garment`` is size M as the service has it, ``skin`` the body's signed distance. ``report`` is called with a line
    on each fall.
    """
    coarse = mesh_pattern(designs["M"].pattern, options.coarse_m)
    nodes = {"M": on_finer_mesh(fine, garment.vertices.astype(np.float64), coarse)}
    band = waistband(nodes["M"], coarse.faces, body)
    held = None if band is None else band.vertex
    graded = {}
    for size, other in FROM.items():
        controls = control_points(designs[size].pattern).positions
        mesh = replace(coarse, pattern=designs[size].pattern, rest=coarse.rest_at(controls))
        fall = Fall(designs[size], mesh, fabric(designs[size].fabric), skin, held=held)
        settled = fall.run(nodes[other], steps=options.coarse_steps, still_m=options.coarse_still_m, kept=SETTLING)
        nodes[size] = settled.nodes
        report(f"{size:9s} {settled.steps} steps, the last by {1e3 * settled.move_m:.2f} mm")
        if size != "M":
            moved = on_finer_mesh(coarse, nodes[size] - nodes["M"], fine)
            graded[size] = GradedSize(moved, fine.rest_at(controls))
    return graded


def table_of(
    garment: Garment, body: BodyModel, panels: np.ndarray, graded: dict[str, GradedSize], *, report: Say
) -> SizeTable:
    """Returns the table whose splines give back the sizes ``graded``, by name. Errors are below ``MOVED_WITHIN_M`` for
    nodes and ``GROWN_WITHIN_M`` for panels, unless that takes more than ``MOST_VERTICES`` points, or
    ``MOST_CORNERS`` in a panel.

    ``panels`` [m] (P, 2) are the panel vertices of M, in the order of the garment's uv. ``report`` gets a line on each
    size.
    """
    standing, uv = garment.vertices.astype(np.float64), garment.uv.astype(np.float64)
    moved = np.concatenate([graded[size].moved for size in OTHERS], axis=1)
    grown = np.concatenate([graded[size].panels - panels for size in OTHERS], axis=1)
    vertex = choose_points(
        standing,
        moved,
        field_in_space,
        step=MOVED_STEP_M,
        within=MOVED_WITHIN_M,
        most=MOST_VERTICES,
        apart=APART_M["space"],
    )
    panel = panels_of(uv, garment.uv_faces)
    corners = []
    for number in range(panel.max() + 1):
        mine = np.flatnonzero(panel == number)
        alone = np.zeros((len(mine), 3), dtype=np.int64)
        alone[:, 1:] = np.arange(len(mine))[:, None]  # one piece: all hang on its first row

        def plate(points: np.ndarray, rows: np.ndarray, values: np.ndarray, faces: np.ndarray = alone) -> np.ndarray:
            return field_in_panels(points, faces, rows, values)

        centres = choose_points(
            uv[mine],
            grown[mine],
            plate,
            step=GROWN_STEP_M,
            within=GROWN_WITHIN_M,
            most=MOST_CORNERS,
            apart=APART_M["panel"],
        )
        corners.append(mine[centres])
    corner = np.concatenate(corners)
    table = SizeTable(
        garment.digest,
        vertex,
        round_to(moved[vertex], MOVED_STEP_M).reshape(len(vertex), len(OTHERS), 3).swapaxes(0, 1),
        corner,
        round_to(grown[corner], GROWN_STEP_M).reshape(len(corner), len(OTHERS), 2).swapaxes(0, 1),
        {},
    )
    measures = {}
    for size in SIZES:
        resized = sized(garment, body, table, size)
        measures[size] = {name: round(value, 4) for name, value in garment_measures(resized, body).items()}
        if size != "M":
            off = np.linalg.norm(resized.vertices - standing - graded[size].moved, axis=1)
            report(f"{size:9s} kept within {1e3 * np.sqrt((off**2).mean()):.1f} mm, {measures[size]}")
    return replace(table, measures=measures)


def choose_points(
    points: np.ndarray, values: np.ndarray, field: Field, *, step: float, within: float, most: int, apart: float
) -> np.ndarray:
    """Returns numbers (A,), sorted, of rows of ``points`` (N, D). From the ``values`` (N, C) of these rows alone, in
    whole ``step``s, ``field`` gives back all values with an error below ``within``; or as well as ``most`` rows can.

    The first rows are far from each other. Then rows with the largest errors are added, a few at a time and at least
    ``apart`` from each other.
    """
    rows = [int(points[:, 1].argmax())]
    while len(rows) < min(2 * points.shape[1] + 2, len(points)):
        rows.append(int(KDTree(points[rows]).query(points)[0].argmax()))
    while True:
        centres = np.unique(rows)
        off = np.abs(field(points, centres, round_to(values[centres], step)) - values).max(axis=1)
        if off.max() < within or len(centres) >= min(most, len(points)):
            return centres
        for _ in range(min(max(4, len(centres) // 4), most - len(centres))):
            worst = int(off.argmax())
            rows.append(worst)
            off[np.linalg.norm(points - points[worst], axis=1) < apart] = 0.0


def round_to(values: np.ndarray, step: float) -> np.ndarray:
    """Returns ``values`` rounded to whole multiples of ``step``."""
    return step * np.rint(values / step)
