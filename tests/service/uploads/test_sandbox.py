"""The process that takes in strangers' files: what reaches it, its limits, and what ended ones leave."""

from __future__ import annotations

import asyncio
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from drape.avatar import own_garments as clothes
from drape.body.assets import DEFAULT_BODY, load_body
from drape.errors import BodyError, DrapeError, MeshError, TooLarge
from drape.garment.cache import Garment
from service.settings import Settings
from service.uploads.jobs import run_sandbox
from service.uploads.sandbox import avatar_files
from tests.fixtures.characters import character
from tests.fixtures.meshes import garment_obj
from tests.fixtures.serving import served


def sandboxed(settings: Settings, content: bytes, name: str, folder: Path) -> dict:
    file = folder / name
    file.write_bytes(content)
    return asyncio.run(run_sandbox(file, "standard", folder / "out", settings))


def test_a_wearer_is_stored_before_its_clothes_are_made(
    make_settings: Callable[..., Settings], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The service makes what it can of it meanwhile."""
    (tmp_path / "me.glb").write_bytes(character(load_body(DEFAULT_BODY)))
    seen: list[Path] = []
    monkeypatch.setattr(
        clothes, "own_garments", lambda *of: seen.extend(tmp_path.glob("*.npz")) or clothes.OwnGarments((), {})
    )
    made = avatar_files(tmp_path / "me.glb", tmp_path, meaning='{"alive": true}', body=DEFAULT_BODY)
    assert made == ([path.name for path in seen], {}) and len(seen) == 1


@pytest.mark.parametrize("avatar", ['{"betas": [1e308]}', '{"trans": [1e300, 0, 0]}', '{"ä": 1}' + 9000 * " "])
def test_what_is_said_of_the_avatar_reaches_the_intake(
    make_settings: Callable[..., Settings], tube: Garment, tmp_path: Path, avatar: str
):
    file = tmp_path / "tube.obj"
    file.write_bytes(garment_obj(tube))
    with pytest.raises(BodyError, match=r"avatar betas|avatar trans|phenotype ä"):
        asyncio.run(run_sandbox(file, avatar, tmp_path / "out", make_settings()))


def test_limits_end_the_process_with_a_sentence(make_settings: Callable[..., Settings], tube: Garment, tmp_path: Path):
    content = garment_obj(tube)
    with pytest.raises(TooLarge, match=r"within 0\.2 s, got no end by then"):
        sandboxed(make_settings(intake_wall_s=0.2), content, "tube.obj", tmp_path)
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(tmp_path) not in listed, "no process outlives its upload"
    for memory_mb in (256, 304):  # at the second BLAS finds no room for its buffers, unless it has them before
        with pytest.raises(DrapeError, match=r"Simplify (the|its) mesh|Export the mesh again"):
            sandboxed(make_settings(intake_memory_mb=memory_mb), content, "tube.obj", tmp_path)
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


def test_processor_time_is_limited(make_settings: Callable[..., Settings], tmp_path: Path):
    # Many points keep the reader busy for longer than the second it gets.
    content = b"v 0.123456 0.123456 0.123456\n" * 3_000_000
    with pytest.raises((TooLarge, MeshError)):
        sandboxed(make_settings(intake_cpu_s=1), content, "points.obj", tmp_path)


def test_what_ended_services_left_behind_is_cleared(make_settings: Callable[..., Settings], tmp_path: Path):
    ended = subprocess.Popen(["true"])
    ended.wait()
    stale, running = tmp_path / f".staging-{ended.pid}", tmp_path / f".staging-{os.getppid()}"
    for folder in (stale, running):
        (folder / "job").mkdir(parents=True)
    with served(make_settings(garments_dir=tmp_path)):
        assert not stale.exists()
        assert running.exists()
