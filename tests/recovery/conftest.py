"""Set-ups that the tests of recovery share."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def pattern_files(data: Path) -> list[Path]:
    """The patterns of the data folder; the test skips where there are none."""
    files = sorted((data / "patterns").glob("*.json"))
    if not files:
        pytest.skip("No patterns/*.json in DRAPE_DATA: docs/guide/data.md says where to get them.")
    return files
