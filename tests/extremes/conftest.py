"""Fixtures of the extremes: the tiny service."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from service.compute.drape_runtime import Drapery
from service.settings import Settings
from tests.fixtures.serving import make_settings, tiny_folder
from tests.fixtures.tiny_model import TINY_DYNAMIC

__all__ = ["make_settings", "tiny_folder"]


@pytest.fixture(scope="session")
def drapery(make_settings: Callable[..., Settings]) -> Drapery:
    """The dynamic model, so that time matters."""
    return Drapery(make_settings(model=TINY_DYNAMIC))
