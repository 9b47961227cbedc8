"""Whether what browsers run is built, and from the sources that are here: a sentence with the cure where it is not."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import pytest

from drape.engine.build import LIBRARIES, WEB, is_made_from, sources_hash
from tests.architecture.repository import ROOT

ENGINE = LIBRARIES / f"{WEB.name}{WEB.suffix}"


@cache
def why_not_the_page() -> str:
    """What ``scripts/build_page`` says of the page and of @drape/client: nothing where both are up to date."""
    words = ["scripts/build_page", "clients/web", "--check"]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False).stderr.strip()


def engine_for_browsers() -> Path:
    """The file of the engine for browsers. The test skips where it is not built, and fails where it is another one."""
    if not ENGINE.is_file():
        pytest.skip("The engine for browsers is not built: `make page`.")
    if not is_made_from(ENGINE, sources_hash(WEB)):
        pytest.fail(f"{ENGINE.name} was made from other sources than those here: `make page`.", pytrace=False)
    return ENGINE
