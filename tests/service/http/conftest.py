"""Fixtures of the tests of REST: a character in the service, and a second service with its folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import httpx
import pytest

from drape.body.model import BodyModel
from service.compute.drape_runtime import DrapeRuntime
from service.settings import Settings
from tests.fixtures.avatar_calls import me_sent


@pytest.fixture(scope="module")
def avatar(api: httpx.Client, body: BodyModel) -> Iterator[str]:
    """The id of the character of ``me_sent``, which goes after the file's last test."""
    found = me_sent(api, body)
    yield found
    api.delete(f"/avatars/{found}")


@pytest.fixture(scope="module")
def runtime_of_api(api: httpx.Client, settings: Settings, make_runtime: Callable[..., DrapeRuntime]) -> DrapeRuntime:
    """A second service with the folder of the first, as after a new start."""
    return make_runtime(garments_dir=settings.garments_dir)
