"""Poses, files, and the whole way from a pattern to a garment that the service can load."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from drape.body.assets import load_body
from drape.errors import MotionError
from drape.files.atomic import write_whole
from drape.garment.cache import load_garment
from drape.garment.files.mesh import read_mesh
from drape.geometry.rotations import rotvec_to_matrix
from drape.motion.samples import walk
from recovery.drape.__main__ import left_words, main
from recovery.drape.output import glb_bytes, panel_texture, sewn_obj_text
from recovery.drape.pattern_drape import SewingOptions, drape_pattern
from recovery.drape.placement import LARGEST_TURN_RAD, move_with_bones, pose_steps, read_pose
from recovery.pattern.bases import skirt
from recovery.pattern.garmentcode import read_pattern, write_pattern
from recovery.pattern.pattern_mesh import PatternMesh, mesh_pattern
from recovery.pattern.sewing_pattern import EdgeRef, Stitch
from tests.recovery.pattern_setup import default_measurements, tube


@lru_cache(maxsize=1)
def flat_tube() -> tuple[PatternMesh, np.ndarray]:
    """A tube's mesh and its nodes [m], panels flat before and behind the body."""
    mesh = mesh_pattern(tube(), 0.1)
    return mesh, mesh.nodes_from(mesh.placed())


def test_the_obj_holds_nodes_and_panels_and_which_belongs_to_which(tmp_path):
    mesh, nodes = flat_tube()
    read = read_mesh(write_whole(tmp_path / "tube.obj", sewn_obj_text(mesh, nodes, panel_texture(mesh))))
    assert_allclose(read.vertices, nodes, atol=1e-8)
    assert (read.faces == mesh.faces).all() and (read.uv_faces == mesh.panel_faces).all()
    assert read.material_names == ("front", "back")
    assert (read.face_material == mesh.face_panel).all()
    # The texture is the pattern at one scale: its sides have the panels' lengths.
    unit = panel_texture(mesh)[1]
    assert read.uv.min() >= 0.0 and read.uv.max() <= 1.0
    for corners in (mesh.panel_faces[:, :2], mesh.panel_faces[:, 1:]):
        lengths = [np.linalg.norm(np.diff(points[corners], axis=1)[:, 0], axis=1) for points in (read.uv, mesh.rest)]
        assert_allclose(unit * lengths[0], lengths[1], atol=1e-7)


def test_the_glb_shows_the_same_surface(tmp_path):
    mesh, nodes = flat_tube()
    read = read_mesh(write_whole(tmp_path / "tube.glb", glb_bytes(mesh, nodes, panel_texture(mesh))))
    assert_allclose(read.vertices[read.faces], nodes[mesh.faces], atol=1e-6)


def test_poses_are_read_from_samples_motion_and_json(tmp_path):
    clip = walk()
    assert_allclose(read_pose("walk:3"), clip.poses[3])
    assert_allclose(read_pose("walk"), clip.poses[0])
    assert_allclose(read_pose("walk:-1"), clip.poses[-1])
    plain, named = tmp_path / "a.json", tmp_path / "b.json"
    plain.write_text(json.dumps(clip.poses[5].reshape(-1).tolist()))
    named.write_text(json.dumps({"pose": clip.poses[5].tolist()}))
    assert_allclose(read_pose(str(plain)), clip.poses[5])
    assert_allclose(read_pose(str(named)), clip.poses[5])


@pytest.mark.parametrize("text", ["[1, 2, 3]", "{}", "no json", '{"pose": "standing"}', "[" + "NaN, " * 71 + "NaN]"])
def test_a_json_that_holds_no_pose_is_refused(tmp_path, text):
    path = tmp_path / "pose.json"
    path.write_text(text)
    with pytest.raises(MotionError, match=r"pose\.json"):
        read_pose(str(path))


def test_a_frame_that_a_clip_has_not_is_refused():
    with pytest.raises(MotionError, match="a frame from 0"):
        read_pose("walk:100000")


def test_the_way_to_a_pose_ends_there_in_small_even_turns(rng):
    pose = 0.8 * rng.normal(size=(24, 3))
    way = pose_steps(pose)
    assert_allclose(way[-1], pose)
    steps = np.diff(way, axis=0, prepend=np.zeros((1, 24, 3)))
    assert_allclose(steps, np.broadcast_to(steps[0], steps.shape), atol=1e-12)
    assert np.linalg.norm(steps[0][1:], axis=1).max() <= LARGEST_TURN_RAD
    assert len(pose_steps(np.zeros((24, 3)))) == 1


def test_turning_the_whole_body_turns_the_garment_rigidly():
    """x' = R (x - pelvis) + pelvis, whatever the weights are."""
    body, (mesh, nodes) = load_body(), flat_tube()
    before, after = np.zeros((2, 24, 3))
    after[0] = [0.2, 1.1, -0.4]
    pelvis = body.joints_template[0]
    expected = (nodes - pelvis) @ rotvec_to_matrix(after[0]).T + pelvis
    assert_allclose(move_with_bones(nodes, mesh.faces, body, before, after), expected, atol=1e-9)
    assert_allclose(move_with_bones(nodes, mesh.faces, body, after, after), nodes, atol=1e-9)


def short_skirt(folder: Path) -> list[str]:
    """Arguments of the command: a skirt on a coarse mesh and a coarse grid."""
    source = write_pattern(skirt(default_measurements(), length_m=0.35), folder / "skirt.json")
    return [str(source), "--out", str(folder / "out"), "--edge-length", "0.07", "--grid", "0.05"]


def test_a_pattern_becomes_a_garment_in_one_command(tmp_path, capsys):
    """Files are there, the report says it is at rest, and the cache loads."""
    assert main([*short_skirt(tmp_path), "--fabric", "stiff"]) == 0
    out = tmp_path / "out"
    record = json.loads((out / "skirt.json").read_text())
    assert record["rest"]["converged"] and record["rest"]["clearance_mm"] > 0.0
    assert record["hangs_from"] == "waist" and record["belt_nodes"] > 10 and record["repaired"] == []
    garment = load_garment(next(out.glob("skirt-*.npz")))
    assert garment.fabric == "denim" and record["fabric"] == "stiff"
    draped = read_mesh(out / "skirt.obj")
    assert garment.vertex_count == len(draped.vertices) == record["nodes"]
    assert (garment.faces == draped.faces).all() and garment.body_digest == load_body().digest
    assert_allclose(garment.vertices[: garment.vertex_count], draped.vertices, atol=0.02)
    # Its cloth has the panels' lengths, not those of the drape, which weight has stretched.
    unit = float((out / "skirt.obj").read_text().splitlines()[0].split("vt is ")[1].split()[0])
    panels = draped.uv[draped.uv_faces]
    (a, b), (c, d) = ((panels[:, k] - panels[:, 0]).T for k in (1, 2))
    cut = 0.5 * unit**2 * np.abs(a * d - b * c)
    assert garment.manifest["rest"]["lengths"] == "panels"
    assert_allclose(garment.rest_state().face_area.reshape(len(cut), -1).sum(axis=1), cut, rtol=1e-3)
    assert "at rest" in capsys.readouterr().out


def test_a_garment_that_is_not_at_rest_is_written_and_flagged(tmp_path, capsys):
    """No Newton, so no rest: exit code 3, the force that is left, and false in the report."""
    assert main([*short_skirt(tmp_path), "--no-garment", "--iterations", "0"]) == 3
    record = json.loads((tmp_path / "out" / "skirt.json").read_text())
    assert record["rest"]["converged"] is False and record["rest"]["newton_iterations"] == 0
    printed = capsys.readouterr()
    assert "NOT at rest" in printed.out
    assert f"{record['rest']['force_left_n']:.1e} N in the T-pose" in printed.err and "--edge-length" in printed.err
    assert (tmp_path / "out" / "skirt.glb").exists() and not list((tmp_path / "out").glob("*.npz"))


def test_a_limb_through_cloth_is_refused_and_cloth_in_the_body_told(tmp_path, capsys):
    """A skirt whose hem is sewn shut below the thighs; the same cloth, open, with a node in the body."""
    source = read_pattern(Path(short_skirt(tmp_path)[0]))
    front, back = (
        min(range(len(panel.edges)), key=lambda n, p=panel: p.vertices[[p.edges[n].start, p.edges[n].end], 1].sum())
        for panel in source.panels
    )
    shut = Stitch(EdgeRef("front", front), EdgeRef("back", back))
    bag = write_pattern(replace(source, stitches=(*source.stitches, shut)), tmp_path / "bag.json")
    assert main([str(bag), *short_skirt(tmp_path)[1:], "--iterations", "0", "--no-garment"]) == 2
    assert "left leg and the right leg" in capsys.readouterr().err and not (tmp_path / "out").exists()
    draped = drape_pattern(source, load_body(), SewingOptions(edge_length_m=0.1, grid_m=0.05, iteration_limit=0))
    assert "below the skin" not in left_words(draped)
    sunk = {**draped.figures, "posed": {**draped.figures["rest"], "clearance_mm": -7.2}}
    assert "7.2 mm below the skin" in left_words(replace(draped, figures=sunk))


def test_the_command_refuses_with_one_sentence(tmp_path, capsys):
    source = write_pattern(tube(), tmp_path / "tube.json")
    refused = (
        ([str(tmp_path / "none.json")], "Check the path"),
        ([str(source), "--scale", "9"], "Draft a new size"),
        ([str(source), "--pose", "nobody:3"], "Check the path"),
        ([str(source), "--iterations", "-1"], "Leave it at its default"),
    )
    for words, cure in refused:
        assert main([*words, "--out", str(tmp_path), "--grid", "0.05"]) == 2
        assert cure in capsys.readouterr().err
