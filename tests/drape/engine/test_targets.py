"""The engine of every system has the same functions, and arm64 gives the same bits as this processor."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from drape.engine.build import TARGETS, build, cache_folder, compiler
from drape.engine.library import load
from tests.drape.engine.symbols import exported

pytestmark = pytest.mark.long
LAWS = Path(__file__).parents[1] / "live"
ARM_LIBRARIES = Path("/usr/aarch64-linux-gnu")


def functions(library: Path) -> set[str]:
    return {name for name in exported(library.read_bytes()) if name.startswith("drape_")}


def test_every_system_has_the_functions_of_this_one(tmp_path: Path):
    here = functions(Path(load()._name))
    assert {"drape_records_hash", "drape_swing_f32"} < here
    for system, targets in TARGETS.items():
        for target in targets:
            assert functions(build(target, tmp_path / system)) == here, target


@pytest.mark.skipif(shutil.which("qemu-aarch64") is None, reason="needs qemu-user")
@pytest.mark.skipif(not ARM_LIBRARIES.is_dir(), reason="needs the package libc6-arm64-cross")
@pytest.mark.skipif("x86" not in platform.machine(), reason="compares arm64 with x86-64")
def test_arm64_gives_the_same_bits(tmp_path: Path):
    tape, (target,) = tmp_path / "tape", TARGETS["linux-aarch64"]
    laws = [str(path) for path in LAWS.glob("test_swing_*.py")]
    recorded = [sys.executable, "-m", "pytest", "-q", "-p", "tests.drape.engine.tape", "-p", "no:cacheprovider", *laws]
    subprocess.run(recorded, env=os.environ | {"DRAPE_TAPE": str(tape)}, check=True)
    libraries = [build(target, tmp_path, tests=tests) for tests in (False, True)]
    replay, source = tmp_path / "replay", Path(__file__).with_name("replay.cpp")
    cache = {f"ZIG_{kind}_CACHE_DIR": str(cache_folder() / "compiled") for kind in ("GLOBAL", "LOCAL")}
    command = [*compiler(), "c++", "-O1", "-target", target.triple, str(source), "-ldl", "-o", str(replay)]
    subprocess.run(command, env=os.environ | cache, check=True)
    arm = ["qemu-aarch64", "-L", str(ARM_LIBRARIES), str(replay), *map(str, libraries), str(tape)]
    done = subprocess.run(arm, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
