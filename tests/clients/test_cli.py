"""The command line writes a whole file or none, and says why."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from clients.calls import get_call
from clients.cli import _progress, main
from clients.client import DrapeClient
from clients.job_steps import upload_steps
from drape.garment.files.obj_mesh import read_obj
from drape.motion.readers import read_motion
from tests.architecture.repository import ROOT
from tests.drape.motion.node_files import T_POSE, glb, moved
from tests.fixtures.exports import read_mdd, read_pc2, read_usda


def test_a_clip_becomes_a_glb(live: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out.glb"
    assert main(f"--url {live} drape --garment tube --motion walk --fps 10 --body --out {out}".split()) == 0
    content = out.read_bytes()
    assert content[:4] == b"glTF" and len(content) == int.from_bytes(content[8:12], "little")
    document = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
    assert len(document["skins"]) == 1
    assert "44 frames at 10 per second" in capsys.readouterr().out


def test_a_file_of_motion_becomes_vertices(live: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "out.npy"
    clip = ROOT / "drape/assets/motions/squat.npz"
    base = f"drape --url {live} --garment tube --motion {clip} --fps 5 --betas -0.5,0 --out {out}".split()
    assert main(base) == 0
    placed = np.load(out)
    assert placed.shape == (25, 216, 3)
    assert main([*base, "--as-recorded", "--no-push-out"]) == 0
    recorded = read_motion(clip).resampled(5.0)
    with DrapeClient(live) as client:
        expected = client.drape("tube", recorded, betas=np.array([-0.5, 0.0]), push_out=False)
    np.testing.assert_array_equal(np.load(out), expected)
    assert main([*base, "--as-recorded", "--advanced", "push_out=false", "inertia=network"]) == 0
    np.testing.assert_array_equal(np.load(out), expected)
    assert np.abs(placed - expected).max() > 0.01
    for option in (["--knob", "3"], ["--passes", "2"]):  # the model of the tests has one
        assert main([*base, *option]) == 2
    assert main([*base, "--advanced", "passes=2", "--passes", "1"]) == 2
    assert "passes: expected the value of advanced.passes, or one of the two left out, got 1" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*base, "--advanced", "passes"])
    assert "expected NAME=VALUE, as folds=3, got passes" in capsys.readouterr().err


def test_a_clip_of_a_file_is_chosen(live: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    moves, out = tmp_path / "moves.glb", tmp_path / "out.npy"
    moves.write_bytes(glb(*moved("mixamo", T_POSE), clips=("walk", "stroll")))
    base = f"drape --url {live} --garment tube --motion {moves} --fps 5 --out {out}".split()
    assert main([*base, "--clip", "stroll"]) == 0 and np.load(out).shape[1:] == (216, 3)
    assert main([*base, "--clip", "run"]) == 2
    assert "expected one of 'walk', 'stroll', got 'run'" in capsys.readouterr().err


def test_cloth_lies_on_colliders_of_a_file(live: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    floor, out = tmp_path / "floor.json", tmp_path / "out.npy"
    base = f"drape --url {live} --garment tube --motion walk --fps 5 --out {out} --colliders {floor}".split()
    with pytest.raises(SystemExit):
        main(base)
    assert "cannot read" in capsys.readouterr().err
    floor.write_text("[{")
    with pytest.raises(SystemExit):
        main(base)
    floor.write_text(json.dumps([{"kind": "plane", "offset_m": 1.0}]))
    assert main([*base, "--no-push-out"]) == 0
    assert np.load(out)[..., 1].min() > 1.0 - 1e-3


def test_point_caches_and_scenes_hold_what_arrays_do(live: str, tmp_path: Path):
    base = ["drape", "--url", live, "--garment", "tube", "--motion", "squat", "--fps", "5", "--out"]
    for name in ("out.npy", "out.pc2", "out.mdd", "out.usda"):
        assert main([*base, str(tmp_path / name)]) == 0
    expected = np.load(tmp_path / "out.npy")
    assert_allclose(read_pc2(tmp_path / "out.pc2"), expected, rtol=0, atol=0)
    times, points = read_mdd((tmp_path / "out.mdd").read_bytes())
    assert_allclose(points, expected, rtol=0, atol=0)
    assert times[1] == np.float32(0.2)
    scene = read_usda((tmp_path / "out.usda").read_text())
    assert scene.stage.GetTimeCodesPerSecond() == 5.0
    assert_allclose(scene.meshes["tube"].points, expected, rtol=0, atol=0.52e-5)
    mesh = read_obj((tmp_path / "out.obj").read_bytes(), name="out", vertex_limit=1000)
    assert_allclose(mesh.vertices, expected[0], rtol=0, atol=1e-6)
    assert len(mesh.uv_faces) == len(mesh.faces) == len(scene.meshes["tube"].faces)
    assert mesh.material_names == ("cotton", "trim")


def test_what_is_there_is_listed(live: str, capsys: pytest.CaptureFixture[str]):
    assert main(["--url", live, "garments"]) == 0
    assert "tube" in capsys.readouterr().out
    assert main(["health", "--url", live]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == "tiny"


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"--garment": "cape"}, "garment: expected one of: tube"),
        ({"--motion": "swim"}, "motion: expected one of"),
        ({"--motion": "absent.bvh"}, "--motion: expected a file"),
        ({"--clip": "stroll"}, "--clip: expected none with a sample clip"),
        ({"--out": "out.fbx"}, "--out: expected a name ending in .glb, .npy, .pc2, .mdd, .usda"),
        ({"--out": "absent/out.glb"}, "--out: expected an existing folder"),
        ({"--betas": "1,x"}, "--betas: expected comma-separated numbers"),
        ({"--fps": "0"}, "fps: expected a positive frame rate"),
        ({"--body": "--rig", "--out": "out.npy"}, "--body: expected a .glb"),
        ({"--rig": "--float32", "--out": "out.usda"}, "--rig: expected a .glb"),
        ({"--joints": "8", "--tier": "exact"}, "--joints: expected a .glb, and no tier exact"),
        ({"--garment": "absent.obj"}, "expected a file that can be read"),
        ({"--url": "http://127.0.0.1:9"}, "make serve"),
    ],
)
def test_a_refusal_is_one_sentence_and_leaves_no_file(
    live: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    changes: dict,
    word: str,
):
    monkeypatch.chdir(tmp_path)
    options = {"--url": live, "--garment": "tube", "--motion": "walk", "--out": "out.glb"} | changes
    assert main(["drape", *(part for pair in options.items() for part in pair)]) == 2
    said = capsys.readouterr().err.strip()
    assert said.startswith("drape: ") and word in said
    assert len(said.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_an_upload_that_fails_says_why(live: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    noise = tmp_path / "noise.obj"
    noise.write_bytes(b"nothing\n")
    assert main(["upload", str(noise), "--url", live, "--avatar", "standard"]) == 2
    *progress, refusal = capsys.readouterr().err.splitlines()
    assert refusal.startswith("drape: ") and all(line.startswith("noise: ") for line in progress)


def test_notes_of_an_upload_are_said_at_its_end(capsys: pytest.CaptureFixture[str]):
    job = {"id": "j", "name": "shirt", "state": "running", "stage": "rest", "share": 0.5, "garment": None, "notes": []}
    steps = upload_steps(get_call("jobs", "j"), "garment", 60.0, _progress())
    next(steps)
    steps.send(job)
    next(steps)
    with pytest.raises(StopIteration):
        steps.send(job | {"state": "done", "stage": None, "share": 1.0, "garment": "shirt", "notes": ["turn it"]})
    assert capsys.readouterr().err.splitlines() == ["shirt: rest, 50 %", "shirt: done, 100 %", "shirt: turn it"]


def test_it_runs_as_a_module():
    run = subprocess.run([sys.executable, "-m", "clients.cli", "--help"], cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0
    assert "--motion walk" in run.stdout
