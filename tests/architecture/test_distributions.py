"""The members of the workspace: one version, and extras that name them."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from typing import Any

import pytest
import yaml

import drape
from drape.engine import build
from tests.architecture.repository import PACKAGES, ROOT, text_files


def project(folder: str = ".") -> dict[str, Any]:
    return tomllib.loads((ROOT / folder / "pyproject.toml").read_text(encoding="utf-8"))


CORE = project()
MEMBERS = CORE["tool"]["uv"]["workspace"]["members"]
KERNELS = "deploy/cuda"  # a wheel of data, which only a machine with nvcc can build


def test_every_package_but_the_judge_is_a_member():
    assert {*MEMBERS, "drape", "benchmarks"} == set(PACKAGES)
    assert CORE["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["drape"]


def test_they_have_one_version_and_ask_for_it():
    for folder in (*MEMBERS, KERNELS):
        described = project(folder)["project"]
        assert described["version"] == drape.__version__, folder
        pinned = [one for one in described["dependencies"] if one.startswith("patchdrape")]
        assert pinned and all(one.endswith(f"=={drape.__version__}") for one in pinned), folder


def test_extras_name_every_member():
    named = {project(folder)["project"]["name"] for folder in (*MEMBERS, KERNELS)}
    extras = CORE["project"]["optional-dependencies"].values()
    assert {one for extra in extras for one in extra if one.startswith("patchdrape")} == named
    assert set(CORE["tool"]["uv"]["sources"]) == {*named, CORE["project"]["name"]}


def test_nothing_tells_to_install_by_a_name_that_another_has():
    told = re.compile(r"pip install\s+(-\S+\s+)*'?drape\b")
    assert [str(path) for path, text in text_files() if told.search(text)] == []


def test_each_wheel_is_tried_on_its_system_by_every_python_that_it_is_for():
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))["jobs"]
    tried = jobs["wheels"]["strategy"]["matrix"]
    tags = re.findall(r'^    "[\w-]+": "(\w+)",$', (ROOT / "hatch_build.py").read_text(encoding="utf-8"), re.MULTILINE)
    assert {system["tag"] for system in tried["system"]} == set(tags) and len(tags) == len(build.TARGETS)
    least = CORE["project"]["requires-python"].removeprefix(">=")
    assert tried["python"][0] == jobs["test"]["strategy"]["matrix"]["python"][0] == least
    minors = [int(version.partition(".")[2]) for version in tried["python"]]
    assert minors == list(range(minors[0], minors[-1] + 1))


@pytest.mark.parametrize("begin", [build.build_here, build.host], ids=["clone", "sdist"])
def test_another_c_library_is_refused(monkeypatch: pytest.MonkeyPatch, begin: Callable[[], object]):
    monkeypatch.setattr(build.platform, "system", lambda: "Linux")
    monkeypatch.setattr(build.platform, "libc_ver", lambda: ("", ""))
    with pytest.raises(SystemExit, match=r"expected Linux with glibc 2\.17 or later, got another C library"):
        begin()
