"""``drape``: the command."""

from __future__ import annotations

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drape.command import ELSEWHERE, main
from drape.garment.cache import GARMENTS_DIR, load_garment, save_garment


@pytest.fixture
def stop(tmp_path: Path) -> Path:
    """A clip of three frames at rest."""
    path = tmp_path / "stop.npz"
    np.savez(path, poses=np.zeros((3, 24, 3)), trans=np.zeros((3, 3)), mocap_framerate=30.0, up="y")
    return path


def test_without_a_command_it_helps(capsys: pytest.CaptureFixture[str]):
    assert main([]) == 0
    told = capsys.readouterr().out
    assert all(name in told for name in ("wear", "garments", "avatars", "tiers", "doctor", *ELSEWHERE))


def test_a_size_is_worn_and_one_that_there_is_not_is_refused(stop: Path, tmp_path: Path, capsys):
    out = [tmp_path / f"{size}.npy" for size in ("M", "XL")]
    for size, path in zip(("M", "XL"), out, strict=True):
        words = ["wear", "tank", str(stop), "--betas", "-0.5,0", "--tier", "instant", "--size", size]
        assert main([*words, "--out", str(path)]) == 0
    medium, large = (np.load(path)[0] for path in out)
    assert np.ptp(large[:, 0]) > 1.02 * np.ptp(medium[:, 0])
    with pytest.raises(SystemExit):
        main(["wear", "tank", str(stop), "--out", str(out[0]), "--size", "XXL"])
    assert "invalid choice: 'XXL'" in capsys.readouterr().err


def test_a_bar_on_a_terminal_says_how_long_it_takes(stop: Path, tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    assert main(["wear", "tank", str(stop), "--out", str(tmp_path / "a.npy"), "--tier", "instant"]) == 0
    told = capsys.readouterr().err
    assert "1 of 3 frames" in told and told.endswith(f"[{'#' * 30}] 3 of 3 frames, 0 s left \n")


@pytest.mark.skipif(shutil.which("bash") is None, reason="No bash: it reads the completion.")
def test_a_shell_completes_commands_and_options(capsys: pytest.CaptureFixture[str]):
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    asked = 'COMP_WORDS=(drape wear --si) COMP_CWORD=2; _shtab_drape; echo "${COMPREPLY[@]}"'
    done = subprocess.run(["bash", "-c", f"{script}\n{asked}"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["--size"]


@pytest.mark.parametrize("suffix", [".glb", ".usda", ".usdc", "_vat.exr", ".pc2", ".mdd", ".npy"])
def test_a_garment_is_worn_into_a_file(suffix: str, stop: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / f"worn{suffix}"
    assert main(["wear", "tank", str(stop), "--out", str(out), "--tier", "instant", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["frames"] == 3 and told["bytes"] == out.stat().st_size > 1000
    if suffix == ".npy":
        assert np.load(out).shape == (3, told["vertices"], 3)
    beside = {".pc2": ["worn.obj"], ".mdd": ["worn.obj"], "_vat.exr": ["worn-remap_info.json", "worn.glb"]}
    assert sorted(Path(one).name for one in told["beside"]) == beside.get(suffix, [])
    assert all(Path(one).is_file() for one in told["beside"])


def test_warnings_of_a_garments_intake_are_said(stop: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    tank = load_garment(next(GARMENTS_DIR.glob("tank-*.npz")))
    doubted = replace(tank, manifest=tank.manifest | {"notes": ["4 openings", "warning: it may be worn back to front"]})
    path = save_garment(doubted, tmp_path)
    assert main(["wear", str(path), str(stop), "--out", str(tmp_path / "worn.npy"), "--tier", "instant"]) == 0
    assert capsys.readouterr().err.splitlines() == ["tank: it may be worn back to front"]


@pytest.mark.parametrize(
    ("words", "match"),
    [
        (["wear", "tank", "walk", "--out", "worn.doc"], "a name ending in"),
        (["wear", "tank", "walk", "--out", "nowhere/worn.glb"], "an existing folder"),
        (["wear", "tnk", "walk", "--out", "worn.glb"], "Did you mean tank"),
        (["wear", "tank", "wlk", "--out", "worn.glb"], "Did you mean walk"),
        (["wear", "tank", "walk", "--out", "worn.vrm"], "a name ending in .glb, .npy"),
        (["wear", "tank", "walk", "--joints", "8", "--out", "worn.usda", "--on", "me.vrm"], "ending in .glb, .vrm"),
        (["wear", "tank", "walk", "--joints", "8", "--out", "worn.glb"], "a character, which has a rig"),
        (["wear", "walk", "--alive", "--out", "worn.glb"], "--alive: expected a character"),
        (["wear", "tank", "walk", "--rig", "--out", "worn.glb"], "--rig: expected a character"),
        (["wear", "tank", "walk", "--rig", "--out", "worn.npy", "--on", "me.vrm"], "ending in .glb"),
        (["avatars", "nobody.vrm"], "GLB or VRM"),
    ],
)
def test_what_cannot_be_done_is_refused_in_a_sentence(words, match: str, capsys: pytest.CaptureFixture[str]):
    assert main(words) == 2
    assert match in capsys.readouterr().err


@pytest.mark.parametrize(("name", "key"), [("garments", "vertices"), ("tiers", "gain")])
def test_tables_come_as_text_and_as_json(name: str, key: str, capsys: pytest.CaptureFixture[str]):
    assert main([name]) == 0
    assert key in capsys.readouterr().out.splitlines()[0]
    assert main([name, "--json"]) == 0
    assert all(key in row for row in json.loads(capsys.readouterr().out))


def test_a_command_of_a_part_that_is_not_installed_names_it(monkeypatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setitem(ELSEWHERE, "serve", ("nothing_of_the_kind", (), "run the service"))
    assert main(["serve"]) == 2
    told = capsys.readouterr().err
    assert "expected the package that can run the service, got no package nothing_of_the_kind." in told
    page = Path(__file__).parents[2] / told.split("nothing_of_the_kind. ")[1].split()[0]
    assert "patchdrape_recovery" in page.read_text(encoding="utf-8")
