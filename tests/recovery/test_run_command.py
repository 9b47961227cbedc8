"""The command from a draped mesh to pattern, garment and report; the report's words; distances and their floor."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from drape.body.assets import load_body
from drape.errors import InputError
from drape.files.atomic import write_whole
from drape.garment.cache import load_garment
from drape.garment.contours import lost_parts, lost_words
from drape.garment.files.mesh import read_mesh
from drape.geometry.drawing import draw_points
from recovery import progress
from recovery.drape.output import panel_texture, sewn_obj_text
from recovery.drape.pattern_drape import Draped, SewingOptions, drape_pattern, hanging
from recovery.fit.chamfer import SurfaceDistance, chamfer, surface_chamfer, surface_distance
from recovery.fit.starts import DrapeStart, drape_worn
from recovery.pattern.bases import BASES, tshirt
from recovery.pattern.coordinates import control_points
from recovery.pattern.garmentcode import read_pattern
from recovery.pattern.pieces import make_sheet
from recovery.pattern.style import Style, add_style_lines, finish_pattern
from recovery.pattern.symmetry import find_symmetries, free_controls
from recovery.run import __main__ as command
from recovery.run import report_text
from recovery.run.draft import own_settings
from recovery.run.identify import CAP_M, Identifiability, corner_names, from_curvature, shape_basis, weak_words
from recovery.run.job import run_job
from recovery.run.report_pieces import ReportPage, add_pieces, scaled_drawing
from recovery.run.report_text import cloth_words, cut_of, cut_words, file_words, report_summary, verdicts
from recovery.run.sew_anew import SewnAnew, anew_words, describe_worn, drape_elsewhere, sew_anew
from tests.drape.cloth.cloth_shapes import round_tube
from tests.recovery.pattern_error import pattern_error
from tests.recovery.pattern_setup import default_measurements, tube

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
HALVES, OTHER_HALVES = np.array([[0, 1, 2], [0, 2, 3]]), np.array([[0, 1, 3], [1, 2, 3]])


def test_two_meshes_of_one_surface_are_at_the_floor():
    """Of n points drawn per area the nearest lies 1 / (2 sqrt n) away on average, 1 / (pi n) squared."""
    found, floor = surface_chamfer((SQUARE, HALVES), (SQUARE, OTHER_HALVES), count=20_000)
    assert_allclose(floor.mean_mm, 1e3 * 0.5 / 20_000**0.5, rtol=0.02)
    assert_allclose(floor.squared_cm2, 1e4 * 2.0 / (np.pi * 20_000), rtol=0.03)
    assert_allclose(found, floor, rtol=0.03)
    exact = surface_distance((SQUARE, HALVES), (SQUARE, OTHER_HALVES))
    assert exact.largest_mm < 1e-6


def test_parallel_squares_are_their_distance_apart():
    near = surface_distance((SQUARE, HALVES), (SQUARE + np.array([0.0, 0.0, 0.01]), HALVES))
    assert_allclose(near, 10.0, rtol=1e-9)
    first, second = draw_points(SQUARE, HALVES, 50, 0), draw_points(SQUARE, HALVES, 50, 0) + np.array([0.0, 0.0, 0.001])
    assert_allclose(chamfer(first, second), (1e4 * 2e-6, 1.0), rtol=1e-6)


def test_what_is_hung_in_folds_is_said_to_fall_into_others_by_itself():
    near, far = SurfaceDistance(1.0, 1.5, 3.0, 5.0), SurfaceDistance(9.0, 12.0, 20.0, 40.0)
    loose = cast(Draped, SimpleNamespace(rest=SimpleNamespace(held=np.zeros(0))))
    assert "hung" not in anew_words(SewnAnew(loose, near, near, 0.0))
    assert anew_words(SewnAnew(loose, near, far, 0.0)).endswith("it falls into others, 9.0 mm away.")
    belted = cast(Draped, SimpleNamespace(rest=SimpleNamespace(held=np.zeros(3))))
    assert "hung" not in anew_words(SewnAnew(belted, near, far, 0.004))


def test_a_scan_without_a_body_may_go_farther_from_its_base():
    words = ["t.obj", "--base", "tshirt", "--out", "out"]
    for more, reach in (([], 0.045), (["--body", "fit"], 0.045), (["--reach", "0.1"], 0.1)):
        assert command.job_of(command.parse([*words, *more])).search.reach_m == reach
    with pytest.raises(InputError, match=r"--reach.*more than 0"):
        command.job_of(command.parse([*words, "--reach", "0"]))


def test_a_page_holds_its_pictures_and_escapes_its_words():
    page = ReportPage("a < b")
    page.section("Panels & seams")
    page.say("One.", "Two.")
    page.notes(["look"])
    page.notes(["fine"], good=True)
    page.table(("panel", "width"), [("<front>", 3)])
    page.picture(b"\x89PNG", "what it shows")
    text = page.text()
    assert "<h1>a &lt; b</h1>" in text and "&lt;front&gt;" in text and "One. Two." in text
    assert 'class="warn">look' in text and 'class="good">fine' in text
    assert base64.b64encode(b"\x89PNG").decode() in text
    assert "http" not in text and 'src="data:' in text


def test_a_garment_that_goes_through_the_body_is_said_to():
    assert cut_words(12.0, 0.05) == []
    (sentence,) = cut_words(19.0, 0.05)
    assert sentence.startswith("19 % of the edges") and "edges of 5 cm" in sentence and "--edge-length 0.03" in sentence


def test_the_drawing_of_the_pieces_is_to_scale_and_keeps_its_rules_to_itself():
    sheet = make_sheet(tube())
    text, caption = scaled_drawing(sheet)
    root = ElementTree.fromstring(text)
    scale = int(re.findall(r"1:(\d+);", caption)[0])
    assert_allclose(scale * float(root.attrib["width"].removesuffix("mm")), 1e3 * sheet.width_m, atol=0.1)
    assert root.attrib["viewBox"].split()[2] == f"{1e3 * sheet.width_m:.3f}"
    style = next(root.iter("{http://www.w3.org/2000/svg}style")).text or ""
    assert all(head.startswith(".pieces ") for rule in style.split("}")[:-1] for head in rule.split("{")[0].split(","))
    assert {"front", "back", "1", "2"} == {one.text for one in root.iter("{http://www.w3.org/2000/svg}text")}


def test_files_have_words():
    kinds = ("a.json", "a.svg", "a.dxf", "a.pdf", "a.obj", "a.glb", "a_rest.obj", "a-1.npz")
    assert len({file_words(name) for name in kinds}) == len(kinds) and all(map(file_words, kinds))


def test_the_report_is_drawn_under_the_watch(tmp_path, monkeypatch):
    outcome = SimpleNamespace(files=[], sewn=SimpleNamespace(anew=None))
    monkeypatch.setattr(command, "run_job", lambda *given, **more: outcome)
    monkeypatch.setattr(report_text, "page_of", lambda one: "")
    monkeypatch.setattr(report_text, "record_of", lambda one: {"stage": progress._watches[-1].stage})
    assert command.main([str(tmp_path / "t.obj"), "--out", str(tmp_path)]) == 3
    assert json.loads((tmp_path / "report.json").read_text()) == {"stage": "the report is drawn"}


COARSE = SewingOptions(edge_length_m=0.05, grid_m=0.02)
TOLD = dict.fromkeys(BASES["tshirt"].settings, 0.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The command on a T-shirt's drape; its folder, its outcome, and the pattern that the target was draped from."""
    folder = tmp_path_factory.mktemp("run")
    truth = tshirt(default_measurements(), length_m=0.70, chest_ease_m=0.15)
    draped = drape_pattern(truth, load_body(), COARSE)
    path = write_whole(folder / "target.obj", sewn_obj_text(draped.mesh, draped.nodes, panel_texture(draped.mesh)))
    coarse = ["--edge-length", "0.05", "--grid", "0.02", "--adam", "0", "--closing", "2", "--no-retarget"]
    coarse += ["--meshes", "0.05"]  # one round; tests of the pipeline have more
    outcomes = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recovery.run.report_pictures.VIEWS", (("front", 0.0),))
        patch.setattr(
            command, "run_job", lambda *given, **more: outcomes.append(run_job(*given, **more)) or outcomes[0]
        )
        # All that would be read off the target is named, so that the search has something to find.
        own = [f"{key}={value}" for key, value in own_settings("tshirt", default_measurements(), TOLD).items()]
        code = command.main([str(path), "--base", "tshirt", "--set", *own, "--out", str(folder / "out"), *coarse])
    assert code == 0 and len(outcomes[0].recovered.rounds) == 1
    return folder, outcomes[0], truth


@pytest.mark.slow
def test_a_draped_mesh_becomes_a_pattern_and_a_garment(run):
    folder, outcome, truth = run
    out = folder / "out"
    names = {file.name for file in out.iterdir()}
    assert {f"target.{kind}" for kind in ("json", "svg", "dxf", "pdf", "obj", "glb", "search.npz")} <= names
    found = read_pattern(out / "target.json")
    base = tshirt(default_measurements())
    assert pattern_error(found, truth).controls_m.mean() < 0.5 * pattern_error(base, truth).controls_m.mean()
    assert outcome.sewn.anew is not None and outcome.sewn.anew.draped.at_rest
    assert found.material == "jersey 200 g/m²"
    simulated, there = read_mesh(out / "target.obj"), read_mesh(folder / "target.obj")
    apart = surface_distance((simulated.vertices, simulated.faces), (there.vertices, there.faces))
    assert_allclose(apart.mean_mm, outcome.near.distance.mean_mm, rtol=0.05)
    garment = load_garment(next(out.glob("target-*.npz")))
    assert garment.body_digest == load_body().digest
    assert garment.vertex_count == len(read_mesh(out / "target_rest.obj").vertices)


@pytest.mark.slow
def test_the_cloth_has_words(run):
    _, outcome, _ = run
    given = cloth_words(outcome.recovered)
    assert "jersey, a cloth of the simulator's" in given and "200 g/m²" in given and "not recovered" in given


@pytest.mark.slow
def test_the_report_says_what_was_found(run):
    folder, outcome, truth = run
    record = json.loads((folder / "out" / "report.json").read_text())
    top = ["distance_mean_mm", "chamfer_cm2", "seam_max_pct", "sewn_anew_mm", "sewn_from_target_mm", "cut", "minutes"]
    assert list(record)[: len(top)] == top
    assert record["seam_max_pct"] <= 0.5 and record["sewn_anew_mm"] <= 3.0 and record["minutes"] > 0.0
    assert record["sewn_from_target_mm"] < record["distance_mean_mm"] + 3.0
    assert record["cut"] == "tshirt: 6 panels, 12 seams"
    assert record["distance"]["mean_mm"] < 0.5 * record["base_distance"]["mean_mm"]
    assert record["chamfer_floor"]["mean_mm"] < record["chamfer"]["mean_mm"]
    assert record["fabric"]["name"] == "jersey"
    assert record["search"]["steps"] <= 2
    assert len(record["identifiability"]["slack_m"]) == sum(len(panel.edges) for panel in truth.panels)
    assert np.diff(record["identifiability"]["seen"]).min() >= 0.0
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) == 4
    for payload in pictures:
        assert np.asarray(Image.open(io.BytesIO(base64.b64decode(payload))).convert("RGB")).std() > 10.0
    for words in ("Before you cut", "What the target cannot tell", "floor", "jersey", "over the base"):
        assert words in page
    for words in ("Seams in pairs", "mirror of sleeve_left_front", "hem, turned up", "Checked by", "seams have ease"):
        assert words in page
    style = Style({"cuffs": 0.05, "collar": 0.06})
    made = finish_pattern(add_style_lines(outcome.pattern, style), style)
    with_lines = replace(outcome, written=outcome.written._replace(style=style, finished=made))
    assert cut_of(with_lines) == f"{record['cut']}; with cuffs 5 cm, collar 6 cm: 11 pieces, 24 seams"
    assert "With cuffs 5 cm, collar 6 cm it has 11 pieces and 24 seams" in report_summary(with_lines)[0]
    lines = ReportPage("lines")
    add_pieces(lines, with_lines.written.finished)
    assert "cut twice: sewn to its facing" in lines.text() and "sleeve_left_front_cuff" in lines.text()
    anew = outcome.sewn.anew
    for share, said in ((0.0, False), (19.0, True)):
        draped = anew.draped
        figures = draped.figures | {"rest": draped.figures["rest"] | {"edges_in_body_pct": share}}
        other = outcome.sewn._replace(anew=anew._replace(draped=replace(draped, figures=figures)))
        look = verdicts(replace(outcome, sewn=other))[1]
        assert any("cut the body" in sentence for sentence in look) == said
    dropped = replace(outcome, recovered=replace(outcome.recovered, left="round 2 of 3: no drape at rest"))
    assert "A part of the search was left out: round 2 of 3: no drape at rest." in verdicts(dropped)[1]
    moved = anew._replace(distance=anew.distance._replace(mean_mm=7.0), belt_moved_m=-0.02)
    far = replace(outcome, sewn=outcome.sewn._replace(anew=moved))
    (words,) = [sentence for sentence in verdicts(far)[1] if sentence.startswith("Sewn anew it lies 7.0 mm")]
    assert "2.0 cm below where it would close by itself" in words and "other folds" in words


@pytest.mark.long
@pytest.mark.slow
def test_lines_that_are_sewn_again_move_no_cloth(run):
    """The pattern with bands and a yoke, sewn from its pieces, lies where the garment of the report does."""
    _, outcome, _ = run
    pattern = add_style_lines(outcome.pattern, Style({"cuffs": 0.06, "hemband": 0.06, "yoke": 0.09}))
    start = DrapeStart(load_body(), COARSE, None, None, ("left_arm", "right_arm"))
    anew = sew_anew(outcome.recovered, start, pattern)
    assert len(anew.draped.mesh.pattern.panels) == 13
    assert anew.draped.at_rest and anew.distance.mean_mm < 3.0


@pytest.mark.slow
def test_what_the_target_shows_is_what_a_changed_pattern_changes(run):
    """A step along the best seen shape, draped: the loss rises as its singular value says."""
    _, outcome, _ = run
    found, told, search = outcome.recovered, outcome.near.identifiability, outcome.recovered.search
    assert (
        len(told.seen) == len(told.cloth) == search.free.count - 8
    )  # rigid: 3 of each half sleeve, and both bodices rise
    across, back = shape_basis(search.free.basis, search.free.controls.panel, found.fitted.positions)
    values = search.free.values(found.fitted.positions)
    step = back @ (across.T @ told.modes[-1].reshape(-1))
    ends = [search.evaluate(values + way * step, found.fitted.nodes) for way in (-2e-3, 0.0, 2e-3)]
    below, here, above = (end.terms[1] + end.terms[2] for end in ends if end is not None)
    # L(z + h) + L(z - h) - 2 L(z) = h^2 L'', and L'' = 4 seen^2.
    assert_allclose(np.sqrt((below + above - 2.0 * here) / 4.0) / 2e-3, told.seen[-1], rtol=0.1)


@pytest.mark.slow
@pytest.mark.long
def test_the_garment_is_taken_to_other_bodies_and_poses(run, monkeypatch):
    folder, outcome, truth = run
    pose = np.zeros((24, 3))
    pose[0, 1] = 0.3
    write_whole(folder / "turned.json", json.dumps(pose.tolist()))
    monkeypatch.setattr("recovery.run.sew_anew.BODIES", {"taller": (0.3,)})
    monkeypatch.setattr("recovery.run.sew_anew.POSES", (str(folder / "turned.json"),))
    draped, body = outcome.sewn.anew.draped, load_body()
    parts = ["trunk", "trunk", "left_arm", "right_arm"]
    taller, posed = drape_elsewhere(truth, draped, body, body, COARSE, parts, cloth=outcome.recovered.fitted.cloth)
    assert taller.lost == posed.lost == ()
    for worn in (taller, posed):
        assert worn.figures["converged"] and worn.figures["clearance_mm"] > 0.0 and not worn.refusal
        assert "at rest" in describe_worn(worn)
    assert taller.nodes[:, 1].max() > draped.rest.nodes[:, 1].max() + 0.005


def test_what_fell_into_other_folds_is_hung_in_the_reports(run, monkeypatch: pytest.MonkeyPatch):
    """The garment sewn anew, shaken by centimetres in waves, comes to rest where the report shows it."""
    _, outcome, _ = run
    draped, wearer = outcome.sewn.anew.draped, outcome.task.wearer
    aside = 0.04 * np.sin(20.0 * draped.nodes[:, 1:2]) * np.array([0.0, 0.0, 1.0])
    shaken = replace(draped, rest=draped.rest._replace(nodes=draped.nodes + aside))
    monkeypatch.setattr("recovery.fit.starts.drape_pattern", lambda *given, **more: shaken)
    start = DrapeStart(wearer.shaped, COARSE, wearer.pose, None, ("trunk",))
    again = sew_anew(replace(outcome.recovered, sewn=None), start)
    assert again.by_itself.mean_mm > 3.0 >= again.distance.mean_mm and again.draped.at_rest
    assert "hung in this garment's folds" in anew_words(again)


def test_an_arm_beside_its_sleeve_is_noticed():
    """A tube round the trunk, and one that hangs beside the arm."""
    trunk, tube_faces = round_tube((0.25, 0.25), (0.1, 0.3))
    joints = load_body().joints_template
    assert lost_parts(trunk, tube_faces, joints, ["trunk", "trunk"]) == ()
    assert lost_parts(trunk, tube_faces, joints, ["trunk", "trunk", "right_arm"]) == ("right_arm",)
    assert lost_parts(trunk + np.array([0.7, 0.0, 0.0]), tube_faces, joints, ["trunk"]) == ("trunk",)
    assert lost_words(["right_arm"]) == "the right arm is not in the garment's opening"
    assert lost_words(["left_arm", "right_arm"]).startswith("the left arm and the right arm are")


@pytest.mark.parametrize(("lost_on", "taken", "tries"), [((1,), 3, 3), ((1, 3, 4, 5), 1, 5)])
def test_a_pattern_whose_sleeve_misses_its_arm_is_sewn_on_another_mesh(lost_on, taken, tries, body, monkeypatch):
    """The first mesh loses the arm, the second cannot be sewn, the third is worn; if all lose it the first is taken."""
    trunk, faces = round_tube((0.25, 0.25), (0.1, 0.3))
    lengths: list[float] = []

    def drape(pattern, body, options, **given):
        lengths.append(options.edge_length_m)
        if len(lengths) == 2:
            raise InputError("stitch", expected="edges that meet", got="none", cure="Check it.")
        surface = trunk + np.array([0.7 if len(lengths) in lost_on else 0.0, 0.0, 0.0]), faces
        return SimpleNamespace(surface=surface, at_rest=True, number=len(lengths))

    monkeypatch.setattr("recovery.fit.starts.drape_pattern", drape)
    found = drape_worn(tube(), DrapeStart(body, COARSE, None, None, ("trunk",)))
    assert cast(Any, found).number == taken
    assert len(lengths) == tries and len(set(lengths)) == tries


def test_a_place_that_refuses_the_garment_says_so(body, monkeypatch):
    def refuse(*given, **more):
        raise InputError("pattern", expected="cloth", got="none", cure="Size it up.")

    monkeypatch.setattr("recovery.run.sew_anew.drape_pattern", refuse)
    never_sewn = cast(Draped, None)  # bodies come before poses, which alone need it
    worn = next(drape_elsewhere(tube(), never_sewn, body, body, COARSE, ["trunk"], cloth=hanging("jersey")))
    assert worn.refusal.endswith("Size it up.") and len(worn.nodes) == len(worn.faces) == 0 and worn.figures == {}


def test_the_command_refuses_with_one_sentence(tmp_path, capsys):
    refused = (
        ([str(tmp_path / "none.obj"), "--base", "skirt"], "Check the path"),
        ([str(tmp_path / "none.obj"), "--base", "skirt", "--betas", "a,b"], "For example --betas"),
        ([str(tmp_path / "none.obj"), "--base", "skirt", "--pose", "nobody:3"], "Check the path"),
    )
    for more, cure in refused:
        assert command.main([*more, "--out", str(tmp_path)]) == 2
        assert cure in capsys.readouterr().err


def test_shapes_are_what_is_left_without_rigid_moves():
    """Two free quadrilaterals have 8 coordinates each and 3 rigid moves each; no shape contains one of them."""
    pattern = tube()
    controls = control_points(pattern)
    across, back = shape_basis(np.eye(16), controls.panel, controls.positions)
    assert across.shape == (16, 10) and back.shape == (16, 10)
    assert_allclose(across.T @ across, np.eye(10), atol=1e-12)
    for panel in (0, 1):
        mine = controls.panel == panel
        arm = controls.positions - controls.positions[mine].mean(axis=0)
        for way in (np.array([1.0, 0.0]) + 0.0 * arm, np.stack([-arm[:, 1], arm[:, 0]], axis=1)):
            assert_allclose(across.T @ np.where(mine[:, None], way, 0.0).reshape(-1), 0.0, atol=1e-12)


def test_free_values_of_a_shape_move_the_corners_by_it_up_to_rigid_moves():
    pattern = tube()
    free = free_controls(pattern, find_symmetries(pattern))
    across, back = shape_basis(free.basis, free.controls.panel, free.origin)
    left = free.basis @ back - across
    again, _ = shape_basis(np.concatenate([left, np.eye(16)], axis=1), free.controls.panel, free.origin)
    assert_allclose(again.T @ left, 0.0, atol=1e-10)


def test_slack_is_the_farthest_move_within_the_tolerance(rng):
    """Sampled moves y with y^T C y / 4 = tolerance^2 never go beyond it, and come near."""
    across = np.linalg.qr(rng.normal(size=(8, 3)))[0]
    root = rng.normal(size=(3, 3))
    found = from_curvature(np.ones(3), root @ root.T, across, 1e-4)
    y = rng.normal(size=(20000, 3))
    y *= 2e-4 / np.sqrt(np.einsum("ni,ij,nj->n", y, root @ root.T, y))[:, None]
    far = np.linalg.norm((y @ across.T).reshape(-1, 4, 2), axis=2).max(axis=0)
    assert (far <= found.slack_m + 1e-12).all()
    assert_allclose(far, found.slack_m, rtol=0.02)
    assert_allclose(found.seen, 0.5 * np.sqrt(np.linalg.eigvalsh(root @ root.T)))


def test_what_nothing_tells_is_capped():
    found = from_curvature(np.ones(2), np.diag([0.0, 1.0]), np.eye(4)[:, :2], 1e-3)
    assert_allclose(found.slack_m, [CAP_M, 0.0], atol=1e-12)
    assert found.seen[0] < 1e-3 * found.seen[1]


def test_corners_and_weak_shapes_have_names():
    names = corner_names(tube())
    assert len(names) == 8 and len(set(names)) == 8
    assert names[0] == "front, bottom left (seam to back, open edge)"
    modes = np.zeros((2, 8, 2))
    modes[0, 2, 0] = 1.0
    modes[1, :, 1] = 8.0**-0.5
    told = Identifiability(np.ones(2), np.array([0.02, 0.5]), modes, np.zeros(8), 1e-3)
    first, second = weak_words(told, tube())
    assert first.startswith("10 mm at front, top right") and "by 0.20 mm" in first
    assert "7 other corners" in second
