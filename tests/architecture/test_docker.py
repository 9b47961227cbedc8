"""The image cannot be built in every test run; what it copies and promises can be read."""

from __future__ import annotations

import re

from tests.architecture.repository import ROOT

DOCKERFILE = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")


def instructions(name: str) -> list[str]:
    """The arguments of every instruction ``name``."""
    return re.findall(rf"^{name} +(.+)$", DOCKERFILE, re.MULTILINE)


def test_every_copied_source_exists():
    sources = []
    for arguments in instructions("COPY"):
        if "--from=" in arguments:
            continue
        words = [word for word in arguments.split() if not word.startswith("--")]
        sources += words[:-1]
    assert sources
    assert [source for source in sources if not (ROOT / source).exists()] == []


def test_build_fails_where_torch_can_be_imported():
    assert any("find_spec" in run and "torch" in run for run in instructions("RUN"))


def test_image_runs_the_service_as_an_ordinary_user_with_a_health_check():
    assert instructions("USER")[-1] not in {"root", "0"}
    assert instructions("HEALTHCHECK")
    assert '"service"' in instructions("CMD")[-1]


def test_nothing_that_the_image_copies_is_ignored():
    ignored = {line.strip().rstrip("/") for line in (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()}
    copied = {word.rstrip("/") for line in instructions("COPY") if "--from=" not in line for word in line.split()[:-1]}
    assert copied & ignored == set()
