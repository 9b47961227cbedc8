"""Scans as they come: what is cut, thinned, closed and refused, and that holes move neither openings nor grading."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.garment.contours import borders, match_contours, open_contours, plainly_hole
from drape.garment.files.mesh import GarmentMesh, plain_mesh
from drape.garment.inside import tube_ends
from drape.garment.sheets import agreeing, branch_edges, cut_branches, main_sheet
from drape.geometry import meshes
from recovery import progress
from recovery.fit.grading import grade
from recovery.fit.objective import TargetSurface
from recovery.fit.optimise import FitOptions
from recovery.pattern.symmetry import find_symmetries
from recovery.run.__main__ import main
from recovery.run.refusal import on_body
from recovery.run.target import OPENINGS, close_but_openings, long_contours
from recovery.scan.holes import bites_of, known_faces
from recovery.scan.repair import (
    ScanFault,
    in_box,
    mend_sheet,
    orient_faces,
    read_target,
    roughness,
    smooth_noise,
    thin_to_spacing,
)
from tests.drape.cloth.cloth_shapes import grid, round_tube
from tests.fixtures.patience import wait_until
from tests.recovery.test_fit_contours import joints, sandwich, sizes
from tests.recovery.test_fit_optimise import search
from tests.recovery.test_run_cut import worn
from tests.recovery.test_run_target import both, skirt_tube, write_obj


def fine_tube(around: int = 120, along: int = 60) -> GarmentMesh:
    """A skirt of the shipped body with edges of about a centimetre."""
    return plain_mesh("skirt", *round_tube([0.24] * (along + 1), np.linspace(-0.45, 0.05, along + 1), around))


def punched(mesh: GarmentMesh, centres: np.ndarray, radius: float) -> GarmentMesh:
    """``mesh`` without the faces that lie within ``radius`` [m] of one of ``centres`` (C, 3)."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    gone = (np.linalg.norm(middles[:, None] - centres[None], axis=2) < radius).any(axis=1)
    return mesh.take_faces(~gone)


def with_placket(mesh: GarmentMesh) -> GarmentMesh:
    """``mesh`` with a strip of its front doubled 4 mm outside it and glued on along the strip's rim."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    strip = mesh.faces[(np.abs(middles[:, 0]) < 0.03) & (middles[:, 2] > 0.1) & (np.abs(middles[:, 1] + 0.2) < 0.15)]
    rim = meshes.boundary_vertices(strip)
    inner = np.setdiff1d(strip, rim)
    copy = np.arange(len(mesh.vertices))
    copy[inner] = len(mesh.vertices) + np.arange(len(inner))
    vertices = np.concatenate([mesh.vertices, mesh.vertices[inner] + [0.0, 0.0, 0.004]])
    return plain_mesh("placket", vertices, np.concatenate([mesh.faces, copy[strip]]))


def test_a_glued_placket_is_cut_off_and_the_garment_stays_whole():
    tube = fine_tube()
    glued = with_placket(tube)
    assert branch_edges(glued.faces) > 0
    kept = mend_sheet(glued)
    assert branch_edges(kept.faces) == 0 and len(meshes.boundary_loops(kept.faces)) == 2
    area = [meshes.face_areas(one.vertices, one.faces).sum() for one in (kept, tube)]
    assert_allclose(area[0], area[1], rtol=2e-3)
    assert "more than two faces" in " ".join(kept.notes)


def test_sheets_that_touch_in_a_vertex_and_faces_that_cannot_be_told_apart_are_cut():
    """Two squares that share one corner come apart; a pillow of two equal triangles loses one pair."""
    square = np.array([[0, 1, 2], [0, 2, 3]])
    corner = plain_mesh("corner", np.random.default_rng(0).normal(size=(7, 3)), [*square, [2, 4, 5], [2, 5, 6]])
    assert len(cut_branches(corner).vertices) == 8
    vertices, faces = grid(4, 4)
    pillow = plain_mesh("pillow", np.concatenate([vertices, [[0.015, 0.015, 0.01]]]), faces)
    a, b = faces[10, :2]
    roofed = replace(pillow, faces=np.concatenate([faces, [[a, b, 25], [b, a, 25]]]), face_material=np.zeros(34, int))
    assert branch_edges(roofed.faces) == 1
    assert branch_edges(cut_branches(roofed).faces) == 0


def moebius(count: int) -> GarmentMesh:
    """A strip of ``count`` squares that closes with a half turn."""
    angle = 2.0 * np.pi * np.arange(count) / count
    way = np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)
    across = np.cos(0.5 * angle)[:, None] * way + np.sin(0.5 * angle)[:, None] * [0.0, 1.0, 0.0]
    vertices = np.concatenate([way + 0.2 * across, way - 0.2 * across])
    a, b = np.arange(count), count + np.arange(count)
    c, d = np.roll(a, -1), np.roll(b, -1)
    c[-1], d[-1] = count, 0
    return plain_mesh("strip", vertices, np.concatenate([np.stack([a, c, b], axis=1), np.stack([c, d, b], axis=1)]))


def test_a_moebius_strip_is_cut_open_once_and_refused_where_that_is_much_of_it():
    flat, cuts = agreeing(moebius(30))
    assert len(cuts) == 1
    halves, first, second = meshes.edge_pairs(flat.faces)
    assert (halves[first, 0] != halves[second, 0]).all() and len(flat.vertices) == 2 * 30 + 2
    with pytest.raises(ScanFault, match=r"cloth with two sides, got 1 edges at which it turns") as fault:
        orient_faces(moebius(12))
    assert len(fault.value.points) == 1


def test_a_second_garment_is_refused_with_its_place_and_a_picture(tmp_path, capsys):
    other = skirt_tube(radius=0.2)
    mesh, _ = both(skirt_tube(), replace(other, vertices=other.vertices + np.array([0.6, 0.1, 0.0])))
    path = write_obj(tmp_path / "t.obj", mesh)
    with pytest.raises(ScanFault, match=r"another one is .*left, .*% of the height.*of the file") as fault:
        read_target(path)
    assert fault.value.mesh is not None and fault.value.points[0, 0] > 0.5
    words = [str(path), "--base", "skirt", "--body", "fit", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert (tmp_path / "out" / "t.refused.png").read_bytes().startswith(b"\x89PNG")
    assert "of the file" in capsys.readouterr().err
    assert main([*words[:3], "--out", str(tmp_path / "on_body")]) == 2
    assert "2 pieces of cloth" in (said := capsys.readouterr().err) and "; near the" in said


def test_places_are_told_by_joint_and_opening():
    tube, at = fine_tube(), joints()
    words = on_body(np.array([0.1, -0.35, 0.22]), tube, at)
    assert "near the left" in words and "10 cm from the hem at (0.1, -0.35, 0.22) m" in words
    assert "right" in in_box(np.array([-0.24, -0.2, 0.0]), tube.vertices)


def test_holes_and_bites_are_closed_marked_and_leave_the_openings():
    tube = fine_tube()
    spots = np.array([[0.24, -0.2, 0.0], [0.0, -0.2, -0.24], [0.0, -0.45, 0.24], [-0.24, 0.05, 0.0]])
    holed = punched(tube, spots, 0.04)
    found = mend_sheet(holed)
    known = known_faces(found)
    assert known.sum() == len(holed.faces) < len(known)
    before, after = borders(tube), borders(found)
    assert len(after) == 2
    assert_allclose([one.length for one in after], [one.length for one in before], rtol=0.01)
    area = [meshes.face_areas(one.vertices, one.faces).sum() for one in (tube, found)]
    assert_allclose(area[1], area[0], rtol=0.01)
    # A patch follows the cloth about it: it is round, not flat.
    inside = np.setdiff1d(found.faces[~known], meshes.boundary_vertices(found.faces))
    off = np.abs(np.hypot(*found.vertices[inside][:, [0, 2]].T) - 0.24)
    assert off.max() < 3.3e-3 and off.mean() < 1e-3  # a flat one would be 3.3 mm off in its middle
    assert "2 holes and 2 bites" in " ".join(found.notes)


def test_a_clean_hem_with_folds_and_a_round_neckline_have_no_bites():
    around, along = 180, 40
    angle = 2.0 * np.pi * np.arange(around) / around
    vertices, faces = round_tube([0.24] * (along + 1), np.linspace(-0.45, 0.05, along + 1), around)
    wavy = vertices * (1.0 + 0.1 * np.tile(np.cos(9.0 * angle), along + 1))[:, None] ** [1.0, 0.0, 1.0]
    neck = plain_mesh("cape", *round_tube(list(np.linspace(0.4, 0.09, 30)), np.linspace(0.0, 0.1, 30), 80))
    for mesh in (plain_mesh("wavy", wavy, faces), neck):
        assert known_faces(mend_sheet(mesh)).all()


@pytest.mark.parametrize(
    ("around", "noise_m", "bites"), [(120, 4e-3, 0), (180, 4e-3, 0), (300, 4e-3, 0), (120, 4e-3, 1), (180, 2e-3, 1)]
)
def test_noise_along_a_border_is_no_bite_and_a_bite_with_noise_is_one(around, noise_m, bites):
    mesh = fine_tube(around=around, along=around // 2)
    if bites:
        mesh = punched(mesh, np.array([[0.0, -0.45, 0.24]]), 0.04)
    rim = meshes.boundary_vertices(mesh.faces)
    for seed in range(3):
        vertices = mesh.vertices.copy()
        vertices[rim] += noise_m * np.random.default_rng(seed).normal(size=(len(rim), 3))
        noisy = replace(mesh, vertices=vertices)
        assert sum(len(bites_of(noisy, border)) for border in borders(noisy)) == bites


@pytest.mark.parametrize(
    ("name", "opening", "across", "rings"),
    [
        ("tshirt", "cuffs", 80.0, 1),
        ("tshirt", "hem", 90.0, 4),
        ("longsleeve", "cuffs", 90.0, 1),
        ("longsleeve", "cuffs", 110.0, 4),
    ],
)
def test_a_hem_that_is_turned_in_is_cut_off_at_its_fold(name, opening, across, rings):
    """Its edge lies across the opening, as the rim of a hole in the cloth; the fold is what the garment ends at."""
    shirt = worn(name)
    before = [one.length_m for one in long_contours(mend_sheet(shirt))]
    mesh = shirt
    for one in borders(shirt)[2:] if opening == "cuffs" else borders(shirt)[:1]:
        points = shirt.vertices[one.loop]
        middle = points.mean(axis=0)
        out = one.axis * np.sign((middle - shirt.vertices.mean(axis=0)) @ one.axis)
        inward = middle - points
        inward = inward - np.outer(inward @ out, out)
        inward /= np.linalg.norm(inward, axis=1, keepdims=True)
        way = np.cos(np.radians(across)) * out + np.sin(np.radians(across)) * inward
        ring = one.loop
        for number in range(rings):
            new = len(mesh.vertices) + np.arange(len(ring))
            strip = [np.roll(ring, -1), ring, new, np.roll(ring, -1), new, np.roll(new, -1)]
            vertices = np.concatenate([mesh.vertices, points + 0.015 * (number + 1) / rings * way])
            faces = np.concatenate([mesh.faces, np.stack(strip, axis=1).reshape(-1, 3)])
            mesh, ring = plain_mesh(name, vertices, faces), new
    found = mend_sheet(mesh)
    assert "hems that are turned in" in " ".join(found.notes)
    assert_allclose([one.length_m for one in long_contours(found)], before, rtol=0.02)


def test_a_hole_is_told_from_a_cuff_by_the_cloth_at_its_rim():
    holed = punched(fine_tube(), np.array([[0.0, -0.2, 0.24]]), 0.035)
    loops = borders(holed)
    assert [plainly_hole(one, holed) for one in loops] == [False, False, True]
    assert len(tube_ends(holed)) == 2  # no leg is pulled to the middle of a hole


@pytest.mark.parametrize("border", [False, True])
def test_six_percent_of_holes_change_the_grading_by_less_than_one_percent(border):
    mesh, nodes = sandwich("skirt")
    pelvis = joints()[0]
    vertices, faces = pelvis + np.array([1.12, 1.2, 1.12]) * (nodes - pelvis), mesh.faces
    for _ in range(3):
        vertices, faces, _ = meshes.subdivide(vertices, faces)
    whole = plain_mesh("target", vertices, faces)
    rng = np.random.default_rng(3)
    middles = whole.vertices[whole.faces].mean(axis=1)
    rim = whole.vertices[meshes.boundary_vertices(whole.faces)]
    holed = whole
    while len(holed.faces) > 0.944 * len(whole.faces):
        spots = rim if border and rng.random() < 0.3 else middles
        holed = punched(holed, spots[rng.integers(len(spots))][None], 0.03)
    target, there = close_but_openings(mend_sheet(holed), joints(), OPENINGS["skirt"])
    assert there == OPENINGS["skirt"]

    def graded(one: GarmentMesh) -> np.ndarray:
        source = open_contours(nodes, mesh.faces)
        matches, left = match_contours(source, open_contours(one.vertices, one.faces), joints())
        assert left == []
        return sizes(grade(mesh, nodes, source, matches, find_symmetries(mesh.pattern)).pattern, mesh.pattern)

    assert_allclose(graded(target), graded(whole), rtol=0.01)


def test_what_closes_a_hole_has_no_weight():
    found = mend_sheet(punched(fine_tube(), np.array([[0.24, -0.2, 0.0]]), 0.05))
    known = known_faces(found)
    target = TargetSurface.from_mesh(found.vertices, found.faces, known=known)
    assert (target.shares.reshape(-1, 3)[~known] == 0.0).all()
    assert_allclose(target.shares.sum(), 1.0, atol=0.3)
    whole = TargetSurface.from_mesh(found.vertices, found.faces)
    assert (whole.shares.reshape(-1, 3)[~known] > 0.0).all()


def test_thinning_keeps_area_borders_and_a_strap_and_averages_noise():
    tube = fine_tube(around=300, along=120)
    rng = np.random.default_rng(0)
    noisy = replace(tube, vertices=tube.vertices + 5e-4 * rng.normal(size=tube.vertices.shape))
    thin = thin_to_spacing(noisy, 0.015)
    assert len(thin.faces) < 0.2 * len(tube.faces)
    assert branch_edges(cut_branches(thin).faces) == 0
    assert_allclose(meshes.face_areas(thin.vertices, thin.faces).sum(), 0.5 * 2.0 * np.pi * 0.24, rtol=0.02)
    loops = borders(thin)
    assert len(loops) == 2
    assert_allclose([one.length for one in loops], 2.0 * np.pi * 0.24, rtol=0.02)
    inner = np.setdiff1d(np.arange(len(thin.vertices)), meshes.boundary_vertices(thin.faces))
    assert np.abs(np.hypot(*thin.vertices[inner][:, [0, 2]].T) - 0.24).mean() < 3e-4
    vertices, faces = grid(200, 8, cell_m=0.002)
    strap = thin_to_spacing(plain_mesh("strap", vertices, faces), 0.015)
    assert len(meshes.boundary_loops(strap.faces)) == 1
    assert_allclose(meshes.face_areas(strap.vertices, strap.faces).sum(), 0.4 * 0.016, rtol=0.1)


def test_noise_is_smoothed_and_a_clean_scan_left_alone():
    tube = fine_tube()
    assert smooth_noise(tube) is tube
    noisy = replace(tube, vertices=tube.vertices + 2e-3 * np.random.default_rng(0).normal(size=tube.vertices.shape))
    calm = smooth_noise(noisy)
    assert roughness(calm) < 0.3 * roughness(noisy)
    off = [np.abs(np.hypot(*one.vertices[:, [0, 2]].T) - 0.24).mean() for one in (noisy, calm)]
    assert off[1] < 0.6 * off[0]


def test_only_the_largest_sheet_is_kept_and_pieces_that_hang_on_nothing_are_named():
    tube = fine_tube()
    scrap = plain_mesh("scrap", *grid(6, 6, cell_m=0.04))
    mesh, _ = both(tube, replace(scrap, vertices=scrap.vertices + np.array([0.5, 0.2, 0.0])))
    kept, rivals = main_sheet(mesh)
    assert len(kept.faces) == len(tube.faces) and rivals == []
    assert "hangs on nothing" in " ".join(kept.notes)


# --- progress --------------------------------------------------------------------------------------------------------


def test_nothing_is_silent_for_longer_than_it_may_be():
    lines: list[str] = []
    with progress.watched(write=lines.append, every_s=0.05), progress.stage("long"):
        progress.tick("round 3")
        wait_until(lambda: len(lines) >= 3)  # a loop that does not tick
    assert "long: round 3" in lines[-1]
    assert not progress.over()
    progress.tick("nobody listens")


def test_time_ends_within_a_share_of_the_limit_and_says_where():
    with progress.watched(write=lambda line: None, limit_s=3600.0) as clock:
        with progress.limit_share(0.25), progress.stage("search"):
            clock.started -= 1000.0
            assert progress.over() and clock.stopped_in == "search"
        assert not progress.over()
        clock.started -= 3000.0
        assert progress.over() and clock.stopped_in == "search"


def test_a_search_whose_time_is_up_gives_the_best_so_far(monkeypatch):
    """The clock runs out during the third step: between two of Newton's, as a clock does."""
    finder, nodes = search()
    asked = 0

    def over() -> bool:
        nonlocal asked
        asked += 1
        return asked > 60

    monkeypatch.setattr(progress, "over", over)
    found = finder.run(nodes, FitOptions(iterations=40, closing=10))
    assert found.finished and 2 <= len(found.history) < 20
    assert found.history[:, 0].min() < found.history[0, 0]


def test_a_command_that_runs_out_of_time_says_during_what(tmp_path, capsys):
    path: Path = write_obj(tmp_path / "t.obj", skirt_tube())
    coarse = ["--edge-length", "0.12", "--grid", "0.04", "--minutes", "1e-6"]
    assert main([str(path), "--base", "skirt", "--out", str(tmp_path), *coarse]) == 2
    said = capsys.readouterr().err
    assert "--minutes: expected time for a first drape" in said and "over during: " in said
