"""Fixtures of the client tests."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from service.settings import Settings
from tests.fixtures.serving import api, live, make_settings, outfit_settings, outfit_url, settings, tiny_folder

__all__ = ["api", "live", "make_settings", "outfit_settings", "outfit_url", "settings", "tiny_folder"]


@pytest.fixture(scope="session")
def live_settings(make_settings: Callable[..., Settings]) -> Settings:
    """The limits that a service has by itself: a browser on a busy machine may be seconds late."""
    return make_settings()
