"""The import order, read from the source and seen in a running process."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.architecture.repository import ROOT, repository_files

HEAVY = ("torch", "vtk", "vtkmodules", "pyvista", "pyacvd", "anny", "warp", "onnx", "onnxscript", "ray")

# Imports a module, or every module of a package of ours, and prints which top-level packages came along.
PROBE = """
import importlib, json, pkgutil, sys
name, whole = sys.argv[1], sys.argv[2] == "whole"
module = importlib.import_module(name)
for found in pkgutil.walk_packages(module.__path__, name + ".") if whole else ():
    if not found.name.endswith("__main__"):
        importlib.import_module(found.name)
print(json.dumps(sorted({loaded.partition(".")[0] for loaded in sys.modules})))
"""


def loaded_with(name: str, *, whole: bool = False) -> set[str]:
    """The top-level packages that a fresh process holds after importing ``name``, with its submodules if ``whole``."""
    command = [sys.executable, "-c", PROBE, name, "whole" if whole else "alone"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_probe_sees_a_heavy_package_when_there_is_one():
    pytest.importorskip("torch")
    assert "torch" in loaded_with("torch")


def test_service_app_loads_no_training_or_rendering_package():
    loaded = loaded_with("service.app")
    assert "fastapi" in loaded
    assert not loaded & set(HEAVY)


@pytest.mark.parametrize("package", ["drape", "service", "clients"])
def test_no_module_of_a_light_package_loads_a_heavy_one(package: str):
    assert not loaded_with(package, whole=True) & set(HEAVY)


def test_core_loads_no_inference_engine_or_web_framework():
    assert not loaded_with("drape", whole=True) & {"onnxruntime", "fastapi", "starlette"}


def test_ray_is_known_to_its_own_modules_alone():
    own = {f"service/{name}.py" for name in ("ray_app", "replicas/ray_deployment", "replicas/ray_router")}
    own.add("tests/service/replicas/test_ray_deployment.py")
    imports = re.compile(r"^\s*(?:import|from) ray\b", re.MULTILINE)
    sources = {path.relative_to(ROOT).as_posix(): path for path in repository_files() if path.suffix == ".py"}
    assert {name for name, path in sources.items() if imports.search(path.read_text(encoding="utf-8"))} == own


def test_import_contracts_hold():
    command = Path(sys.executable).with_name("lint-imports")
    if not command.exists():
        pytest.skip("import-linter is not installed: `make setup`.")
    run = subprocess.run([str(command), "--no-cache"], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr
