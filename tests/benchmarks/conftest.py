"""Set-ups that the tests of benchmarks share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests.fixtures.garments import ship


@pytest.fixture(scope="module", autouse=True)
def threads() -> Iterator[None]:
    """A command says how many threads torch has; the next module finds as many as there were."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture
def few_garments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """Services and runtimes of the test ship these garments alone: all of them take several times as long to load."""
    names = ("tank", "shorts")
    monkeypatch.setenv("DRAPE_SHIPPED_GARMENTS_DIR", str(ship(tmp_path / "shipped", *names)))
    return names
