"""Fixtures of the extremes: the tiny service."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.serving import make_settings, tiny_folder
from tests.fixtures.tiny_model import TINY_DYNAMIC

__all__ = ["make_settings", "tiny_folder"]


@pytest.fixture(scope="session")
def runtime(make_settings: Callable[..., Settings]) -> DrapeRuntime:
    """The dynamic model, so that time matters."""
    return DrapeRuntime(make_settings(model=TINY_DYNAMIC))
