"""From a design to files: what is carried over, what is folded and doubled, what the files say, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from drape.body.assets import load_body
from drape.cloth.fabric_table import fabric
from drape.errors import NotFound
from drape.garment.cache import load_garment
from drape.garment.files.mesh import read_mesh
from drape.garment.grain import corner_uv
from drape.garment.intake import intake
from drape.garment.sewing import sewing_beside, sewn_hinges
from drape.geometry import meshes
from recovery.catalogue.__main__ import main
from recovery.catalogue.cuts import CATALOGUE
from recovery.catalogue.design_drape import QUICK, SewnGarment, body_distance, design, drape_design, write_garment
from recovery.catalogue.fall import HEM_BENDING, hinge_bending, seam_angles
from recovery.drape.output import panel_texture
from recovery.pattern.bases import skirt
from recovery.pattern.pattern_mesh import mesh_pattern, on_finer_mesh
from recovery.pattern.style import Style, add_style_lines
from recovery.sim.cloth_model import ClothModel
from tests.recovery.pattern_setup import default_measurements


@lru_cache(maxsize=1)
def quick_tank() -> SewnGarment:
    """A tank on a coarse mesh, not yet at rest."""
    body = load_body()
    return drape_design(design("tank", default_measurements()), body_distance(body, QUICK), QUICK)


@pytest.mark.parametrize("style", [{}, {"waistband": 0.04, "hemband": 0.05}])
def test_a_shape_is_carried_to_a_finer_mesh_by_place_in_the_panels(style):
    """Also where the panels of the fine one are cut along lines that are sewn again."""
    pattern = skirt(default_measurements())
    coarse, fine = mesh_pattern(pattern, 0.06), mesh_pattern(add_style_lines(pattern, Style(style)), 0.03)
    # Panels as placed are linear in their coordinates: away from seams nothing is lost.
    placed = coarse.placed()
    nodes = on_finer_mesh(coarse, coarse.nodes_from(placed), fine)
    inner = np.setdiff1d(np.arange(fine.node_count), fine.node_of_panel_vertex[fine.seam_pairs])
    far = fine.nodes_from(fine.placed())
    gap = np.linalg.norm(nodes - far, axis=1)[inner]
    assert np.quantile(gap, 0.5) < 1e-9


def test_hems_bend_twice_as_hard_and_the_collar_is_folded():
    made = CATALOGUE["shirt"](default_measurements())
    mesh = mesh_pattern(made.pattern, 0.02)
    model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces)
    cloth = fabric(made.fabric)
    plain = hinge_bending(replace(made, edge_names={}), mesh, model, cloth)
    hemmed = hinge_bending(made, mesh, model, cloth) / plain
    assert set(np.round(hemmed, 9)) == {1.0, HEM_BENDING}
    assert 0.01 < (hemmed > 1.0).mean() < 0.3
    angles = seam_angles(made, mesh, model)
    folded = np.unique(model.hinge_nodes[angles != 0.0][:, :2])
    fold = made.seam_names.index("collar_fold")
    line = np.unique(mesh.node_of_panel_vertex[mesh.seam_pairs[mesh.seam_of_pair == fold]])
    assert set(folded) == set(line)
    assert set(angles) == {0.0, made.seam_angles["collar_fold"]}


def test_a_garment_is_sewn_round_the_body_and_stays_outside_of_it(body):
    garment = quick_tank()
    assert garment.figures["seam_gap_mm"] < 5.0
    assert garment.figures["clearance_mm"] > 4.0
    assert garment.figures["stretch_median_pct"] < 10.0
    shoulders = body.joints_template[[16, 17], 1].mean()
    assert garment.nodes[:, 1].max() > shoulders - 0.02  # it hangs where it should


def test_files_hold_seams_panels_hems_and_fabric_and_intake_takes_them(tmp_path):
    garment = quick_tank()
    obj, glb, told = write_garment(garment, tmp_path, name="tank", size="M", body="anny_default")
    read = read_mesh(obj)
    assert_allclose(read.vertices, garment.nodes, atol=1e-8)
    # Texture coordinates are metres: areas there are those of the panels.
    assert_allclose(read.uv, panel_texture(garment.mesh, unit_m=1.0)[0], atol=1e-8)
    edges = read.uv[read.uv_faces[:, 1]] - read.uv[read.uv_faces[:, 0]]
    rest = garment.mesh.rest[garment.mesh.panel_faces]
    assert_allclose(edges, rest[:, 1] - rest[:, 0], atol=1e-7)
    assert len(read_mesh(glb).faces) == len(read.faces)
    record = json.loads(told.read_text())
    assert record["fabric"] == "rib" and record["hem_bending"] == 2.0 and record["uv_unit_m"] == 1.0
    sides = next(seam for seam in record["seams"] if seam["name"] == "side_left")
    assert set(sides["panels"]) == {"front", "back"} and sides["angle_rad"] == 0.0
    first, second = (read.uv[np.array(side)] for side in sides["uv"])
    assert_allclose(np.linalg.norm(np.diff(first, axis=0), axis=1), np.linalg.norm(np.diff(second, axis=0), axis=1))
    kinds = {edge["name"]: edge["kind"] for edge in record["edges"]}
    assert kinds == {"hem": "hem", **dict.fromkeys((n for n in kinds if n != "hem"), "opening")}
    for edge in record["edges"]:
        assert (garment.mesh.node_of_panel_vertex[edge["uv"]] == edge["vertices"]).all()
    taken = intake(obj, avatar="standard")
    assert taken.vertex_count == len(garment.nodes)
    assert_allclose(taken.uv, read.uv, atol=1e-6)
    # At rest it is its panels, in its fabric: flat, as long as they were cut, with the grain along v.
    assert taken.fabric == "rib" and taken.manifest["rest"]["lengths"] == "panels"
    state = taken.rest_state()
    assert not state.hinge_angle.any()
    share = len(taken.fine_faces) // len(taken.faces)  # the first of a triangle's parts has its first corner
    first = np.sqrt(share) * state.edges[::share, 0]
    assert_allclose(first[:, ::-1], edges, atol=1e-6)


def test_intake_has_the_hinges_that_were_simulated(tmp_path):
    made = CATALOGUE["shirt"](default_measurements())
    mesh = mesh_pattern(made.pattern, 0.02)
    model = ClothModel(mesh.faces, panel_faces=mesh.panel_faces)
    nodes = mesh.nodes_from(mesh.placed())
    obj = write_garment(SewnGarment(made, mesh, nodes, {}), tmp_path, name="shirt", size="M", body="b")[0]
    told, read = sewing_beside(obj), read_mesh(obj)
    on_corners = corner_uv(read.uv, read.uv_faces, len(read.faces))
    assert told is not None and on_corners is not None
    told.check(read)
    found = sewn_hinges(told, read, np.arange(len(read.vertices)), read.faces, on_corners)
    assert_array_equal(meshes.hinges(read.faces), model.hinge_nodes)
    assert_array_equal(found.angle, seam_angles(made, mesh, model))
    cloth = fabric(made.fabric)
    plain = hinge_bending(replace(made, edge_names={}), mesh, model, cloth)
    assert_allclose(found.stiffening, hinge_bending(made, mesh, model, cloth) / plain, rtol=1e-9, atol=0.0)


@pytest.mark.long
def test_the_command_writes_a_size_and_says_what_is_not_at_rest(tmp_path, capsys):
    taken = tmp_path / "garments"
    code = main(["build", "tank", "--size", "L", "--out", str(tmp_path), "--quick", "--garments", str(taken)])
    assert code == 3
    (cache,) = taken.iterdir()
    assert load_garment(cache).manifest["rest"]["lengths"] == "panels"
    assert "not at rest, the last step moved a node of tank_l by" in capsys.readouterr().err
    assert json.loads((tmp_path / "tank_l.json").read_text())["size"] == "L"


def test_the_command_lists_the_catalogue(capsys):
    assert main(["list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(CATALOGUE)


def test_unknown_garments_and_sizes_are_refused(tmp_path, capsys):
    with pytest.raises(NotFound, match="garment: expected one of tshirt"):
        design("cape", default_measurements())
    assert main(["build", "tank", "--size", "XXXL", "--out", str(tmp_path)]) == 2
    assert "Beyond the grade" in capsys.readouterr().err
