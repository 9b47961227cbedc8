"""The image cannot be built in every test run (``make image`` does); what it copies and promises can be read."""

from __future__ import annotations

import fnmatch
import re
import subprocess
import tomllib

import pytest

from tests.architecture.repository import ROOT, repository_files

DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
# What the wheels of core and service, and the page in the latter, are made from.
PACKED = ("pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "drape", "service", "clients/web")
SCRIPTS = ("scripts/release.py", "scripts/build_page")


def instructions(name: str) -> list[str]:
    """The arguments of every instruction ``name``."""
    return re.findall(rf"^{name} +(.+)$", DOCKERFILE, re.MULTILINE)


def arguments() -> dict[str, str]:
    """The build arguments with their defaults."""
    return dict(re.findall(r"^ARG ([A-Z]+)=(\S+)$", DOCKERFILE, re.MULTILINE))


def is_ignored(path: str) -> bool:
    """Whether .dockerignore keeps ``path`` from the build: the last pattern that fits it or a folder above decides."""
    ignored, parts = False, path.split("/")
    for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines():
        pattern = line.removeprefix("!").removeprefix("**/")
        beginnings = ["/".join(parts[: count + 1]) for count in range(len(parts))]
        if any(fnmatch.fnmatch(one, pattern) for one in (parts if "**/" in line else beginnings)):
            ignored = not line.startswith("!")
    return ignored


def test_what_the_wheels_are_made_from_reaches_the_build():
    paths = [str(path.relative_to(ROOT)) for path in repository_files()]
    packed = [path for path in paths if path.startswith(tuple(f"{one}/" for one in PACKED)) or path in PACKED]
    assert len(packed) > 300 and set(SCRIPTS) <= set(paths)
    assert [path for path in (*packed, *SCRIPTS) if is_ignored(path)] == []


@pytest.mark.parametrize("path", [".git/HEAD", "clients/web/node_modules/three/x.js", "clients/web/dist/a", "runs/a"])
def test_what_is_large_or_private_does_not(path: str):
    assert is_ignored(path)


def test_the_wheels_of_a_release_reach_the_build_where_they_are_asked_for():
    assert not is_ignored("dist/patchdrape-0.1.0-py3-none-manylinux2014_x86_64.whl")
    stages = {words.split()[-1] for words in instructions("FROM") if " AS " in words}
    assert arguments()["WHEELS"] == "made" and {"wheels-made", "wheels-dist"} <= stages
    told = (ROOT / "scripts" / "build_image").read_text(encoding="utf-8")
    assert 'WHEELS="${WHEELS:-made}"' in told and "WHEELS=dist" in (ROOT / "Makefile").read_text(encoding="utf-8")


def test_its_extras_are_those_of_the_core():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert set(arguments()["EXTRAS"].split(",")) <= set(extras)


def test_build_fails_where_torch_can_be_imported():
    assert any("find_spec" in run and "torch" in run for run in instructions("RUN"))


def test_image_runs_the_service_as_an_ordinary_user_with_a_health_check():
    assert instructions("USER")[-1] not in {"root", "0"}
    assert instructions("HEALTHCHECK")
    assert '"service"' in instructions("CMD")[-1]


def test_a_machine_without_containers_is_told_so():
    command, environment = [str(ROOT / "scripts" / "build_image")], {"CONTAINERS": "no-such-command", "PATH": "/bin"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 1 and "expected podman or docker" in done.stderr
