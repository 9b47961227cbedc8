"""Fixtures of the service tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import pytest

from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.serving import (
    api,
    client,
    live,
    live_settings,
    make_settings,
    outfit_settings,
    outfit_url,
    settings,
    tiny_folder,
)

__all__ = [
    "api",
    "client",
    "live",
    "live_settings",
    "make_settings",
    "outfit_settings",
    "outfit_url",
    "settings",
    "tiny_folder",
]


@pytest.fixture(scope="module")
def make_runtime(make_settings: Callable[..., Settings]) -> Iterator[Callable[..., DrapeRuntime]]:
    """Runtimes with the settings of ``make_settings``, which are closed after the file's last test."""
    with ExitStack() as opened:
        yield lambda **settings: opened.enter_context(closing(DrapeRuntime(make_settings(**settings))))
