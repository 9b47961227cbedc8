"""Set-ups that the tests of benchmarks share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture(scope="module", autouse=True)
def threads() -> Iterator[None]:
    """A command says how many threads torch has; the next module finds as many as there were."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)
